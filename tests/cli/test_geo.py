"""Verbs take and return world coordinates of geo-referenced scenes."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from scenes import tiny_cameras
from splat_io.formats.handmade import some_splats
from splat_io.formats.test_origin import ECEF, UTM, geo_ply
from splatwire.bitstream import read_stream, write_stream
from splatwire.bitstream.sections import sections_of
from splatwire.codec import with_section
from splatwire.data import load_cameras, save_cameras
from splatwire.io.formats import read_content, write_splats
from splatwire.types.origin import NO_ORIGIN
from splatwire.view.page import page_of_stream

pytestmark = pytest.mark.slow

SHIFT = np.array(UTM) + np.array([0.25, 0.5, 0.125])


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The same scene and cameras in world coordinates and around 0."""
    folder = tmp_path_factory.mktemp("geo")
    splats = some_splats(400, 1)
    write_splats([splats], folder / "local.ply")
    geo_ply(splats, SHIFT, folder / "world.ply")
    cameras = tiny_cameras(3, 64, 48, distance=5.0)
    save_cameras(cameras, folder / "local.json")
    poses = cameras.viewmats.astype(np.float64)
    poses[:, :3, 3] -= poses[:, :3, :3] @ SHIFT
    save_cameras(replace(cameras, viewmats=poses), folder / "world.json")
    return folder


def places(path) -> np.ndarray:
    """World coordinates of a file's Gaussians, float64, sorted by x."""
    content = read_content(path)
    means = content.splats.means.astype(np.float64) + np.array(content.origin)
    return means[means[:, 0].argsort()]


def psnr(one, other) -> float:
    first, second = (np.asarray(Image.open(path), float) for path in (one, other))
    return float(10 * np.log10(255**2 / max(((first - second) ** 2).mean(), 1e-9)))


def test_cameras_far_away_keep_their_precision(files, tmp_path):
    world, local = load_cameras(files / "world.json"), load_cameras(files / "local.json")
    assert world.origin != NO_ORIGIN
    centers = world.centers.astype(np.float64) + np.array(world.origin)
    assert centers == pytest.approx(local.centers.astype(np.float64) + SHIFT, abs=1e-5)
    save_cameras(world, tmp_path / "again.json")
    again = load_cameras(tmp_path / "again.json")
    assert np.array_equal(again.viewmats, world.viewmats)
    there = world.relative_to(ECEF).relative_to(world.origin)
    assert np.allclose(there.viewmats, world.viewmats, atol=1)


@pytest.mark.parametrize("options", [(), ("--quality", "near-lossless"), ("--levels", "auto", "--block-size", "60")])
def test_streams_keep_world_coordinates_to_codec_precision(options, files, run, tmp_path):
    errors = {}
    for name, shift in (("world", SHIFT), ("local", np.zeros(3))):
        stream, back = tmp_path / f"{name}.swz", tmp_path / f"{name}.ply"
        cameras = ("--cameras", files / f"{name}.json")
        assert run("encode", files / f"{name}.ply", "-o", stream, *cameras, *options).status == 0
        assert run("decode", stream, "-o", back).status == 0
        found = places(back)
        errors[name] = np.abs(found - (places(files / "local.ply") + shift)).max()
        out = tmp_path / f"{name}_pictures"
        assert run("render", stream, "--cameras", files / f"{name}.json", "-o", out).status == 0
    assert errors["world"] < 1.2 * errors["local"] + 1e-6
    for view in range(3):
        pictures = [tmp_path / f"{name}_pictures" / f"view_{view:02d}.png" for name in errors]
        assert psnr(*pictures) > 50
    assert run("inspect", tmp_path / "world.swz", "--json").json["origin"] == list(UTM)
    assert "origin" not in sections_of(read_stream(tmp_path / "local.swz")[0])


def test_a_decoded_scene_is_encoded_to_the_same_integers_again(files, run, tmp_path):
    run("encode", files / "world.ply", "-o", tmp_path / "a.swz")
    run("decode", tmp_path / "a.swz", "-o", tmp_path / "a.ply")
    run("encode", tmp_path / "a.ply", "-o", tmp_path / "b.swz")
    first, second = (run("inspect", tmp_path / f"{name}.swz", "--json").json for name in "ab")
    assert first["symbols_digest"] == second["symbols_digest"]
    assert first["origin"] == second["origin"]


def test_evaluate_compares_in_world_coordinates(files, run, tmp_path):
    run("encode", files / "world.ply", "-o", tmp_path / "a.swz")
    done = run(
        "evaluate", tmp_path / "a.swz", "--reference", files / "world.ply", "--cameras", files / "world.json", "--json"
    )
    assert done.status == 0
    assert done.json["rows"][0]["psnr"] > 30


@pytest.mark.parametrize("kind", ["ply", "compressed-ply", "spz", "sog", "splat", "glb"])
def test_exports_use_world_coordinates_or_report_their_origin(kind, files, run, tmp_path, caplog):
    path = tmp_path / f"a.{kind.replace('-', '.')}"
    done = run("export", kind, files / "world.ply", "-o", path, "--cameras", files / "world.json", "--json")
    assert done.status == 0
    assert done.json["measured"]["psnr_to_scene"] > 25
    shift = SHIFT - np.array(UTM) if kind == "splat" else SHIFT
    assert np.abs(places(path) - (places(files / "local.ply") + shift)).max() < 0.01
    warned = kind not in ("ply", "glb")
    assert (f"{UTM[0]:.0f}, {UTM[1]:.0f}, {UTM[2]:.0f}" in caplog.text) == warned


def test_cameras_of_another_coordinate_system_give_a_warning(files, run, tmp_path):
    words = ("--cameras", files / "local.json")
    text = "splatwire: warning: no Gaussian of the scene is in the pictures: it is around (451234, 5.41188e+06, 118"
    assert run("encode", files / "world.ply", "-o", tmp_path / "a.swz").status == 0
    (tmp_path / "clip").mkdir()
    for number in range(2):
        (tmp_path / "clip" / f"{number}.ply").write_bytes((files / "world.ply").read_bytes())
    assert run("encode", tmp_path / "clip", "-o", tmp_path / "clip.swz").status == 0
    for done in (
        run("render", tmp_path / "clip.swz", "-o", tmp_path / "clip.webp", *words),
        run("evaluate", tmp_path / "clip.swz", "--reference", tmp_path / "clip", *words),
        run("render", files / "world.ply", "-o", tmp_path / "out", *words),
        run("export", "spz", files / "world.ply", "-o", tmp_path / "a.spz", *words),
        run("evaluate", tmp_path / "a.swz", "--reference", files / "world.ply", "--lpips-views", "1", *words),
        run("compare", files / "world.ply", tmp_path / "a.swz", *words),
    ):
        assert done.status == 0, done.err
        assert done.err.count(text) == 1, done.err


def test_import_keeps_float64(files, run, tmp_path):
    done = run("import", "splats", files / "world.ply", "-o", tmp_path / "a.ply", "--json")
    assert done.json["origin"] == list(UTM)
    assert np.abs(places(tmp_path / "a.ply") - places(files / "world.ply")).max() < 1e-6
    facts = run("inspect", tmp_path / "a.ply", "--json").json
    assert facts["bounds"]["y"][0] == pytest.approx(places(tmp_path / "a.ply")[:, 1].min(), abs=1e-6)


def test_views_around_a_scene_are_saved_in_world_coordinates(files, run, tmp_path):
    run("render", files / "world.ply", "-o", tmp_path / "out")
    cameras = load_cameras(tmp_path / "out" / "cameras.json")
    away = cameras.centers.astype(np.float64) + np.array(cameras.origin) - SHIFT
    assert 1 < np.linalg.norm(away, axis=1).max() < 20


def test_a_clip_has_one_origin(run, tmp_path):
    (tmp_path / "frames").mkdir()
    splats = some_splats(300, 0)
    for number in range(3):
        geo_ply(splats, SHIFT + np.array([0.6 * number, 0, 0]), tmp_path / "frames" / f"{number}.ply")
    assert run("encode", tmp_path / "frames", "-o", tmp_path / "clip.swz").status == 0
    assert run("decode", tmp_path / "clip.swz", "-o", tmp_path / "out").status == 0
    for number in range(3):
        found = places(tmp_path / "out" / f"frame_{number}.ply")
        middle = np.median(places(tmp_path / "frames" / f"{number}.ply"), axis=0)
        assert np.median(found, axis=0) == pytest.approx(middle, abs=0.05)


def test_clip_far_from_zero_renders_like_one_near_zero(run, tmp_path):
    splats = some_splats(300, 0)
    for name, shift in (("world", np.array(UTM)), ("local", np.zeros(3))):
        (tmp_path / name).mkdir()
        for number in range(2):
            geo_ply(splats, shift, tmp_path / name / f"{number}.ply")
        assert run("encode", tmp_path / name, "-o", tmp_path / f"{name}.swz").status == 0
        assert run("render", tmp_path / f"{name}.swz", "-o", tmp_path / f"{name}.webp").status == 0
    assert psnr(*(tmp_path / f"{name}.webp" for name in ("world", "local"))) > 35


def test_a_damaged_origin_is_refused(files, run, tmp_path):
    run("encode", files / "local.ply", "-o", tmp_path / "a.swz")
    stream = read_stream(tmp_path / "a.swz")[0]
    for values in ((1.0, 2.0), (np.nan, 0.0, 0.0), (np.inf, 0.0, 0.0), (2e12, 0.0, 0.0)):
        write_stream(with_section(stream, "origin", np.array(values, "<f8").tobytes()), tmp_path / "b.swz")
        refused = run("decode", tmp_path / "b.swz", "-o", tmp_path / "b.ply")
        assert refused.status == 2
        assert "origin" in refused.err


def test_page_starts_at_a_camera_in_world_coordinates(files, run, tmp_path):
    words = {}
    for name in ("world", "local"):
        run("encode", files / f"{name}.ply", "-o", tmp_path / f"{name}.swz")
        cameras, stream = load_cameras(files / f"{name}.json"), read_stream(tmp_path / f"{name}.swz")[0]
        text = page_of_stream("a", stream, cameras, "127.0.0.1").attributes["viewpoint"]
        words[name] = np.array([float(word) for word in text.split()])
    eye = words["world"][:3] - words["local"][:3]
    assert eye == pytest.approx(SHIFT - np.array(UTM), abs=1e-3)


def test_outliers_option_exists_for_verbs_that_write_such_formats(files, run, tmp_path, caplog):
    splats = some_splats(400, 0)
    splats.means[7], splats.scales[7] = (1e6, 0, 0), 1e4
    source, stream = tmp_path / "floater.ply", tmp_path / "floater.swz"
    write_splats([splats], source)
    for treatment, count in (("keep", 400), ("clamp", 400), ("prune", 399)):
        written = tmp_path / f"{treatment}.spz"
        done = run("export", "spz", source, "-o", written, "--outliers", treatment, "--json")
        assert done.json["num_gaussians"] == count
        assert read_content(written).splats.num_gaussians == count
    assert caplog.text.count("1 of 400 Gaussians have outlying positions") == 3
    run("encode", source, "-o", stream)
    assert run("decode", stream, "-o", tmp_path / "d.spz", "--outliers", "prune").status == 0
    refused = run("export", "ply", source, "-o", tmp_path / "a.ply", "--outliers", "prune")
    assert (refused.status, "--outliers is for" in refused.err) == (2, True)
    refused = run("decode", stream, "-o", tmp_path / "a.ply", "--outliers", "prune")
    assert (refused.status, "--outliers is for" in refused.err) == (2, True)
