"""Rows of other codecs (decoded scenes or pictures, with a number of bytes) and rate-distortion curves."""

import csv
import dataclasses
import io

import numpy as np
import pytest
from PIL import Image

from explicit import ball_of_gaussians
from scenes import tiny_cameras, tiny_scene
from splatwire.data import save_cameras
from splatwire.errors import DatasetError, InvalidValueError, UnknownNameError
from splatwire.evaluation.pixels import to_pixels
from splatwire.evaluation.rate_distortion import RatePoint, bd_quality, bd_rate
from splatwire.evaluation.study import InProcess, Store, input_files, load_study, run_study, summarize, write_outputs
from splatwire.evaluation.study.summary import dataset_means
from splatwire.io import open_scene, save_scene
from splatwire.render import render_scene
from splatwire.types import SplatScene
from splatwire.types.background import WHITE

NAMES = tiny_cameras(2, 48, 36).names
HEAD = """
[protocol]
name = "codecs"
title = "Codecs"
metrics = ["psnr"]

[[scene]]
name = "made up"
scene = "{folder}/scene.ply"
cameras = "{folder}/cameras.json"

[[loss]]
model = "none"
"""


def row(key: str, source: object, num_bytes: int | None = None, curve: str = "") -> str:
    """Table row of another codec with one result."""
    size = "" if num_bytes is None else f"num_bytes = {num_bytes}"
    return f"""
[[row]]
key = "{key}"
label = "{key}"
curve = "{curve}"

[[row.decoded]]
scene = "made up"
source = "{source}"
{size}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """`scene.ply`, results of a codec at three rates (`fine`, `middle`, `coarse`), and pictures of the scene."""
    folder, splats, cameras = tmp_path_factory.mktemp("codecs"), ball_of_gaussians(), tiny_cameras(2, 48, 36)
    save_cameras(cameras, folder / "cameras.json")
    save_scene(splats, folder / "scene.ply")
    for name, step in (("fine", 0.1), ("middle", 0.4), ("coarse", 1.2)):
        rounded = dataclasses.replace(splats, sh=np.round(splats.sh / step).astype(np.float32) * np.float32(step))
        save_scene(rounded, folder / f"{name}.ply")
    pixels = [to_pixels(image) for image in render_scene(open_scene(folder / "scene.ply"), cameras)]
    for kind, names in (("named", NAMES), ("numbered", ("00000", "00001"))):
        (folder / kind).mkdir()
        for name, image in zip(names, pixels, strict=True):
            Image.fromarray(image).save(folder / kind / f"{name}.png")
    return folder


def study_of(folder, tmp_path, *rows):
    path = tmp_path / "protocol.toml"
    path.write_text(HEAD.format(folder=folder) + "".join(rows))
    return load_study(path)


def results(folder, tmp_path, *rows):
    store = Store(tmp_path / "store")
    result = run_study(study_of(folder, tmp_path, *rows), store, InProcess(), lambda task, share: None)
    return result, store


def test_decoded_scene_is_compared_with_the_scene_and_has_the_size_of_its_file(folder, tmp_path):
    result, _ = results(folder, tmp_path, row("same", folder / "scene.ply"), row("fine", folder / "fine.ply"))
    same, fine = summarize(result)
    assert same.exact
    assert same.num_bytes == (folder / "scene.ply").stat().st_size
    assert 20 < fine.figures["psnr"].mean < 80
    assert fine.lost_anchors == 0


def test_given_number_of_bytes_counts_instead_of_the_size_of_the_file(folder, tmp_path):
    result, store = results(folder, tmp_path, row("fine", folder / "fine.ply", 1234))
    assert summarize(result)[0].num_bytes == 1234
    write_outputs(result, store, tmp_path / "out")
    line = next(csv.DictReader(io.StringIO((tmp_path / "out/leaderboard/made_up.csv").read_text())))
    assert (line["Submethod"], line["Size [Bytes]"]) == ("fine", "1234")


def test_pictures_belong_to_views_by_name_or_by_number(folder, tmp_path):
    rows = [row(kind, folder / kind, 99) for kind in ("named", "numbered")]
    result, _ = results(folder, tmp_path, *rows)
    named, numbered = summarize(result)
    assert named.by_view == numbered.by_view
    assert named.figures["psnr"].mean > 48  # rounded to 8 bits
    assert named.num_bytes == 99


@pytest.mark.parametrize("reference", [False, True])
def test_results_that_lost_the_antialiasing_of_the_scene_give_a_warning(folder, tmp_path, caplog, reference):
    save_scene(SplatScene(ball_of_gaussians(), antialiased=True), tmp_path / "mip.ply")
    study = study_of(folder, tmp_path, row("fine", folder / "fine.ply"))
    change = {"reference": tmp_path / "mip.ply"} if reference else {"source": tmp_path / "mip.ply"}
    mip = dataclasses.replace(study, scenes=(dataclasses.replace(study.scenes[0], **change),))
    run_study(mip, Store(tmp_path / "store"), InProcess(), lambda task, share: None)
    other = "scene.ply" if reference else "fine.ply"
    assert f"mip.ply is drawn antialiased (Mip-Splatting) and {folder / other} is not" in caplog.text


def test_transparent_pixels_of_pictures_show_the_background_of_the_scene(folder, tmp_path):
    (tmp_path / "clear").mkdir()
    for name in NAMES:
        Image.new("RGBA", (48, 36), (0, 0, 0, 0)).save(tmp_path / "clear" / f"{name}.png")
        (tmp_path / "white").mkdir(exist_ok=True)
        Image.new("RGB", (48, 36), (255, 255, 255)).save(tmp_path / "white" / f"{name}.png")
    study = study_of(folder, tmp_path, row("clear", tmp_path / "clear", 9), row("white", tmp_path / "white", 9))
    on_white = dataclasses.replace(study, scenes=(dataclasses.replace(study.scenes[0], background=WHITE),))
    result = run_study(on_white, Store(tmp_path / "store"), InProcess(), lambda task, share: None)
    clear, white = summarize(result)
    assert clear.by_view == white.by_view


def test_results_of_a_model_folder_need_no_row_that_encodes_it(folder, tmp_path, monkeypatch):
    """The model gives only the background; the cameras, the views."""
    iteration = tmp_path / "model" / "point_cloud" / "iteration_1"
    iteration.mkdir(parents=True)
    for name in ("point_cloud.ply", "checkpoint.pth"):
        (iteration / name).write_bytes(b"not read")
    scene = dataclasses.replace(tiny_scene(num_anchors=60), background=WHITE)
    monkeypatch.setattr(input_files, "import_model", lambda kind, path: scene)
    study = study_of(folder, tmp_path, row("named", folder / "named", 9))
    model = dataclasses.replace(study.scenes[0], source=tmp_path / "model", kind="model")
    as_it_is = dataclasses.replace(study.rows[0], key="model", label="model", decoded=(), packetization=None)
    of_model = dataclasses.replace(study, scenes=(model,), rows=(*study.rows, as_it_is))
    result = run_study(of_model, Store(tmp_path / "store"), InProcess(), lambda task, share: None)
    named, as_it_is = summarize(result)
    assert (named.num_bytes, as_it_is.num_bytes) == (9, 16)
    assert result.scenes["made up"].references.background == WHITE


def test_means_over_scenes_have_no_number_of_gaussians_if_that_of_one_is_unknown(folder, tmp_path):
    study = study_of(folder, tmp_path, row("fine", folder / "fine.ply"), row("named", folder / "named", 9))
    other = dataclasses.replace(study.scenes[0], name="other")
    rows = tuple(
        dataclasses.replace(each, decoded=(*each.decoded, dataclasses.replace(each.decoded[0], scene="other")))
        for each in study.rows
    )
    two = dataclasses.replace(study, scenes=(*study.scenes, other), rows=rows)
    result = run_study(two, Store(tmp_path / "store"), InProcess(), lambda task, share: None)
    numbers = {mean.row.key: mean.num_gaussians for mean in dataset_means(result, summarize(result))}
    assert numbers == {"fine": open_scene(folder / "fine.ply").num_gaussians, "named": None}


def test_rows_of_other_codecs_are_listed_with_encoded_rows(folder, tmp_path):
    own = '\n[[row]]\nkey = "own"\nlabel = "own"\npreset = "datagram"\nlossless = true\n'
    result, store = results(folder, tmp_path, own, row("fine", folder / "fine.ply"), row("named", folder / "named", 7))
    sizes = {s.row.key: s.num_bytes for s in summarize(result)}
    sent = store.root / result.scenes["made up"].streams[result.study.row("own").variant].path
    assert sizes == {"own": sent.stat().st_size, "fine": (folder / "fine.ply").stat().st_size, "named": 7}
    files = write_outputs(result, store, tmp_path / "out")
    assert "| named | " in files["markdown"].read_text()
    assert "Gaussians hit" in files["markdown"].read_text()


@pytest.mark.slow
def test_curves_are_compared_in_tables_csv_and_plots(folder, tmp_path):
    fine, middle, coarse = (folder / f"{name}.ply" for name in ("fine", "middle", "coarse"))
    one = [row("a1", fine, 900, "one"), row("a2", middle, 500, "one"), row("a3", coarse, 200, "one")]
    two = [row("b1", fine, 450, "two"), row("b2", middle, 250, "two"), row("b3", coarse, 100, "two")]
    result, store = results(folder, tmp_path, *one, *two)
    files = write_outputs(result, store, tmp_path / "out")
    assert "| two | -50.0 % |" in files["markdown"].read_text()
    lines = list(csv.DictReader(io.StringIO(files["curves"].read_text())))
    assert [(line["curve"], line["num_bytes"]) for line in lines] == [
        ("one", "200"), ("one", "500"), ("one", "900"), ("two", "100"), ("two", "250"), ("two", "450"),
    ]  # fmt: skip
    points = [RatePoint(int(line["num_bytes"]), float(line["psnr"])) for line in lines]
    assert bd_rate(points[:3], points[3:]) == pytest.approx(-0.5, abs=1e-9)
    gain = bd_quality(points[:3], points[3:])
    assert gain is not None
    assert f"| {gain:+.2f} |" in files["markdown"].read_text()
    (plot,) = (tmp_path / "out/curves").glob("*.svg")
    assert plot.read_text().startswith("<svg")
    assert "Bytes at equal quality" in files["report"].read_text()


def test_reused_result_follows_the_content_of_the_file(folder, tmp_path):
    """A changed picture is scored again; another number of bytes alone is not."""
    (tmp_path / "named").mkdir()
    for file in (folder / "named").iterdir():
        (tmp_path / "named" / file.name).write_bytes(file.read_bytes())
    first, _ = results(folder, tmp_path, row("x", tmp_path / "named", 9))
    again, _ = results(folder, tmp_path, row("x", tmp_path / "named", 8))
    assert (first.num_computed, again.num_computed) == (1, 0)
    Image.new("RGB", (48, 36)).save(tmp_path / "named" / f"{NAMES[0]}.png")
    changed, _ = results(folder, tmp_path, row("x", tmp_path / "named", 8))
    assert changed.num_computed == 1
    assert summarize(changed)[0].figures["psnr"].mean < summarize(first)[0].figures["psnr"].mean


def test_results_that_do_not_fit_are_refused(folder, tmp_path):
    with pytest.raises(InvalidValueError, match="pictures need 'num_bytes'"):
        results(folder, tmp_path, row("x", folder / "named"))
    (tmp_path / "few").mkdir()
    Image.new("RGB", (48, 36)).save(tmp_path / "few/a.png")
    with pytest.raises(DatasetError, match=f"has 1 pictures and none of view '{NAMES[0]}'"):
        results(folder, tmp_path, row("x", tmp_path / "few", 9))
    Image.new("RGB", (24, 18)).save(tmp_path / "few/b.png")
    with pytest.raises(DatasetError, match="pixels, and the views have 48 x 36"):
        results(folder, tmp_path, row("x", tmp_path / "few", 9))
    for name in ("a", "b"):
        Image.fromarray(np.zeros((36, 48), np.uint16)).save(tmp_path / f"few/{name}.png")
    steps = []
    with pytest.raises(DatasetError, match="mode I;16 are not read"):
        run_study(
            study_of(folder, tmp_path, row("x", tmp_path / "few", 9)), Store(tmp_path / "new"), InProcess(),
            lambda task, share: steps.append(task),
        )  # fmt: skip
    assert not any("units of work" in step for step in steps)
    (tmp_path / "few/a.png").write_bytes(b"no picture")
    with pytest.raises(DatasetError, match=r"a\.png"):
        results(folder, tmp_path, row("x", tmp_path / "few", 9))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('curve = ""', 'preset = "paper"', "unknown key 'preset'"),
        ('scene = "made up"\nsource', 'scene = "other"\nsource', "other"),
        ("num_bytes = 9", "num_bytes = 0", "num_bytes must be at least 1"),
        ("num_bytes = 9", "bytes = 9", "unknown key 'bytes'; did you mean 'num_bytes'"),
        ("num_bytes = 9", 'num_bytes = "9"', "num_bytes must be an integer"),
        ("fine.ply", "nowhere.ply", "does not exist"),
        ("[[row.decoded]]", "[row.decoded]", r"decoded has single brackets: write \[\[row.decoded\]\]"),
    ],
)
def test_mistakes_in_results_are_named(folder, tmp_path, old, new, message):
    text = row("x", folder / "fine.ply", 9)
    assert old in text
    with pytest.raises((InvalidValueError, UnknownNameError, DatasetError), match=message):
        study_of(folder, tmp_path, text.replace(old, new))


def test_scene_without_a_result_skips_the_row_with_the_reason(folder, tmp_path):
    """The other scene has the same files and another name."""
    second = f'\n[[scene]]\nname = "second"\nscene = "{folder}/scene.ply"\ncameras = "{folder}/cameras.json"\n'
    own = '\n[[row]]\nkey = "own"\nlabel = "own"\npreset = "datagram"\nlossless = true\n'
    result, _ = results(folder, tmp_path, second, own, row("fine", folder / "fine.ply"))
    assert result.skipped == ("Row 'fine' did not run on second: no result of this codec is given.",)
    found = [(s.scene, s.row.key) for s in summarize(result)]
    assert found == [("made up", "own"), ("made up", "fine"), ("second", "own")]
