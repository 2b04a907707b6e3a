"""Every verb renders, scores and calibrates a scene on the background that it was trained with."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.scene_file import save_scene
from splatwire.data import load_cameras, save_cameras
from splatwire.evaluation.study import InProcess
from splatwire.render import iterate_views
from splatwire.types.background import WHITE

pytestmark = pytest.mark.slow

PROTOCOL = """
[protocol]
seeds = [1]
metrics = ["psnr"]

[[scene]]
name = "tiny"
stream = "{folder}/white.swz"
photos = "{folder}/photos"

[[loss]]
model = "bernoulli:0.3"

[[row]]
key = "reference"
label = "no loss"
block_size = 60
lossless = true
"""


@pytest.fixture(scope="module")
def white(tmp_path_factory):
    """A scene on white, its cameras, and transparent photos of it in the Blender layout."""
    folder = tmp_path_factory.mktemp("white")
    scene, cameras = tiny_scene(seed=3, num_anchors=240), tiny_cameras(num_views=2, width=64, height=48)
    save_scene(replace(scene, background=WHITE), folder / "white.scene")
    save_cameras(cameras, folder / "cameras.json")
    for split in ("train", "test"):
        (folder / "photos" / split).mkdir(parents=True)
    poses = []
    pairs = zip(iterate_views(scene, cameras), iterate_views(replace(scene, background=WHITE), cameras), strict=True)
    for view, (on_black, on_white) in enumerate(pairs):
        alpha = (1 - (on_white - on_black).mean(axis=2, keepdims=True)).clip(1e-6, 1)
        pixels = np.concatenate([(on_black / alpha).clip(0, 1), alpha], axis=2)
        for split in ("train", "test"):
            Image.fromarray((pixels * 255).round().astype(np.uint8)).save(folder / "photos" / split / f"{view}.png")
        pose = np.linalg.inv(cameras.viewmats[view]) @ np.diag([1.0, -1.0, -1.0, 1.0])
        poses.append(pose.tolist())
    angle = 2 * math.atan(0.5 * cameras.width / float(cameras.Ks[0, 0, 0]))
    for split in ("train", "test"):
        frames = [{"file_path": f"./{split}/{view}", "transform_matrix": pose} for view, pose in enumerate(poses)]
        content = json.dumps({"camera_angle_x": angle, "frames": frames})
        (folder / "photos" / f"transforms_{split}.json").write_text(content)
    return folder


@pytest.fixture(scope="module")
def stream(white):
    from splatwire.cli.main import main

    with pytest.raises(SystemExit):
        main(["encode", str(white / "white.scene"), "-o", str(white / "white.swz"), "--block-size", "60"])
    return white / "white.swz"


def corner(path):
    return np.asarray(Image.open(path))[0, 0].tolist()


def rendered(run, source, folder, output, *words):
    outcome = run("render", source, "--cameras", folder / "cameras.json", "-o", output, *words)
    assert outcome.status == 0, outcome.err
    return corner(output / f"{load_cameras(folder / 'cameras.json').names[0]}.png")


def test_background_defaults_to_the_colour_of_the_scene(run, white, stream, tmp_path):
    assert run("transmit", stream, "-o", tmp_path / "lossy.swz", "--loss", "bernoulli:0.3").status == 0
    assert run("decode", tmp_path / "lossy.swz", "-o", tmp_path / "gaps.scene").status == 0
    assert run("decode", tmp_path / "lossy.swz", "-o", tmp_path / "grown.scene", "--conceal", "grow").status == 0
    sources = (white / "white.scene", stream, tmp_path / "lossy.swz", tmp_path / "gaps.scene", tmp_path / "grown.scene")
    for number, source in enumerate(sources):
        assert rendered(run, source, white, tmp_path / str(number)) == [255, 255, 255]


def test_background_option_overrides_the_scene(run, white, stream, tmp_path):
    assert rendered(run, stream, white, tmp_path / "red", "--background", 1, 0, 0) == [255, 0, 0]
    assert run("encode", white / "white.scene", "-o", tmp_path / "b.swz", "--background", 0, 0, 1).status == 0
    assert rendered(run, tmp_path / "b.swz", white, tmp_path / "blue") == [0, 0, 255]
    outcome = run("render", stream, "--cameras", white / "cameras.json", "-o", tmp_path, "--background", 2, 0, 0)
    assert outcome.status == 2
    assert "a background is three numbers from 0 to 1" in outcome.err


@pytest.mark.parametrize("name", ["white.scene", "white.swz"])
def test_transparent_photos_are_composed_on_the_background(run, white, stream, name):
    words = ("evaluate", white / name, "-s", white / "photos", "--json")
    own, black = (run(*words, *more).json["rows"][0]["psnr"] for more in ((), ("--background", 0, 0, 0)))
    assert min(own, black) > 35  # photos and renders have the same background
    assert own != black
    assert run(*words, "--loss", "none", "--conceal", "drop").json["rows"][0]["psnr"] > 35


def test_reference_and_decoded_renders_share_one_background(run, white, stream):
    words = ("--reference", white / "white.scene", "--cameras", white / "cameras.json", "--json")
    own, grey = (run("evaluate", stream, *words, *m).json["rows"][0]["psnr"] for m in ((), ("--background", 0, 0.5, 0)))
    assert min(own, grey) > 40


def test_protocol_composes_photos_on_the_background(run, white, stream, tmp_path, monkeypatch):
    monkeypatch.setattr("splatwire.cli._run_study.create_engine", lambda *_: InProcess())
    path, words = tmp_path / "mine.toml", ("--views", 1, "-o", tmp_path / "out", "--json")
    path.write_text(PROTOCOL.format(folder=white))
    first = run("study", path, *words)
    assert first.status == 0, first.err
    path.write_text(path.read_text().replace("[[scene]]", "[[scene]]\nbackground = [1.0, 0.0, 0.0]"))
    red = run("study", path, *words).json
    assert red["num_computed"] == 1  # another background gives another unit of work
    assert min(content["rows"][0]["figures"]["psnr"]["mean"] for content in (first.json, red)) > 35


def test_sketch_is_calibrated_on_the_background(run, white, stream, tmp_path, monkeypatch):
    from splatwire.calibration import sketch, views

    seen = []

    def noted(scene, *words, **options):
        seen.append(scene.background)
        return iterate_views(scene, *words, **options)

    for module in (sketch, views):
        monkeypatch.setattr(module, "iterate_views", noted)
    words = ("calibrate", "sketch", stream, "-o", tmp_path / "a.swz", "--share", 0.2, "--json")
    outcome = run(*words, "--cameras", white / "cameras.json")
    assert outcome.status == 0, outcome.err
    assert set(seen) == {WHITE}
