"""Verbs for Gaussians accept a 3DGS model folder with its cameras.json."""

import io
import json
from pathlib import Path

import pytest

from splat_io.formats.handmade import some_splats
from splatwire.anchors.appearance import antialiased
from splatwire.io import open_scene
from splatwire.io.formats import is_antialiased, write_splats
from splatwire.io.formats.dispatch import read_content
from splatwire.types.background import BLACK, WHITE


@pytest.fixture
def model(tmp_path):
    """Model folder that 3DGS writes after two saved iterations."""
    for iteration, count in ((7000, 20), (30000, 60)):
        folder = tmp_path / "model" / "point_cloud" / f"iteration_{iteration}"
        folder.mkdir(parents=True)
        write_splats([some_splats(count, 0)], folder / "point_cloud.ply")
    (tmp_path / "model" / "cfg_args").write_text("Namespace(sh_degree=3, model_path='model', white_background=False)")
    write_splats([some_splats(5, 0)], tmp_path / "model" / "input.ply")
    camera = {"id": 0, "img_name": "one", "width": 32, "height": 24, "position": [0, 0, -4], "fx": 30, "fy": 30,
              "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}  # fmt: skip
    (tmp_path / "model" / "cameras.json").write_text(json.dumps([camera]))
    return tmp_path / "model"


def test_verbs_accept_a_model_folder_and_its_cameras(run, model, tmp_path):
    found = run("inspect", model, "--json").json
    ply = model / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    assert (found["num_gaussians"], found["num_bytes"]) == (60, ply.stat().st_size)
    encoded = run("encode", model, "-o", tmp_path / "a.swz", "--cameras", model / "cameras.json", "--json")
    assert encoded.json["num_elements"] == 60
    drawn = run("render", model, "-o", tmp_path / "out", "--cameras", model / "cameras.json", "--json")
    assert drawn.json["pictures"] == ["one.png"]
    assert run("import", "splats", model, "-o", tmp_path / "b.ply", "--json").json["num_gaussians"] == 60


def test_a_model_folder_has_the_background_of_its_training(model, run, tmp_path, caplog, monkeypatch):
    folder = model / "point_cloud" / "iteration_7000"
    places = (model, model / "point_cloud", folder, folder / "point_cloud.ply")
    assert [open_scene(place).background for place in places] == [BLACK] * 4
    (model / "cfg_args").write_text("Namespace(sh_degree=3, white_background=True, eval=True)")
    assert [open_scene(place).background for place in places] == [WHITE] * 4
    assert run("encode", model, "-o", tmp_path / "a.swz").status == 0
    assert open_scene(tmp_path / "a.swz").background == WHITE
    assert "background" not in caplog.text
    for place in places:
        run("import", "splats", place, "-o", tmp_path / "a.ply")
    assert caplog.text.count("a.ply: such files have no background colour") == len(places)
    caplog.clear()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(io.BytesIO()))
    run("import", "splats", model, "-o", "-")
    assert [record.getMessage()[:10] for record in caplog.records] == ["-: such fi"]


def test_the_model_folder_is_found_from_inside(model, monkeypatch):
    (model / "cfg_args").write_text("Namespace(white_background=True)")
    monkeypatch.chdir(model / "point_cloud" / "iteration_30000")
    assert [open_scene(place).background for place in ("..", "../..", "point_cloud.ply")] == [WHITE] * 3


def test_unreadable_arguments_give_a_warning_and_black(model, caplog):
    (model / "cfg_args").write_bytes(b" " * (1 << 20) + b"white_background=True")
    assert open_scene(model).background == BLACK
    assert "cfg_args" in caplog.text
    assert "the background is black" in caplog.text


@pytest.mark.parametrize("argument", ["antialiasing=True", "rasterize_mode='antialiased'"])
def test_a_model_folder_has_the_antialiasing_of_its_training(model, run, tmp_path, argument):
    assert not antialiased(open_scene(model))
    (model / "cfg_args").write_text(f"Namespace(sh_degree=3, source_path='/data/mip', {argument}, eval=True)")
    assert antialiased(open_scene(model / "point_cloud"))
    assert run("import", "splats", model, "-o", tmp_path / "b.ply").status == 0
    assert is_antialiased(tmp_path / "b.ply")


def test_a_ply_in_a_model_folder_has_the_antialiasing_of_its_training(model, monkeypatch):
    (model / "cfg_args").write_text("Namespace(antialiasing=True)")
    ply = model / "point_cloud" / "iteration_7000" / "point_cloud.ply"
    assert antialiased(open_scene(ply))
    monkeypatch.chdir(ply.parent)
    assert antialiased(open_scene("point_cloud.ply"))
    ply.rename(ply.with_name("other.ply"))
    assert not antialiased(open_scene("other.ply"))


@pytest.mark.parametrize(
    ("text", "expected"), [("antialiased: true\nport: 1\n", True), ("antialiased: false\n", False)]
)
def test_a_ply_of_gsplat_has_the_antialiasing_of_its_training(tmp_path, text, expected):
    (tmp_path / "results" / "ply").mkdir(parents=True)
    ply = tmp_path / "results" / "ply" / "point_cloud_29999.ply"
    write_splats([some_splats(20, 0)], ply)
    assert not antialiased(open_scene(ply))
    (tmp_path / "results" / "cfg.yml").write_text(f"data_dir: /data/mip\n{text}")
    assert antialiased(open_scene(ply)) is expected


@pytest.mark.parametrize("setting", [True, False])
def test_a_ply_of_lichtfeld_studio_has_the_antialiasing_of_its_training(tmp_path, caplog, setting):
    write_splats([some_splats(20, 0)], tmp_path / "splat_30000.ply")
    config = {"dataset": {"images": "images"}, "optimization": {"antialiasing": setting, "render_mode": "RGB"}}
    (tmp_path / "training_config.json").write_text(json.dumps(config, indent=4))
    assert antialiased(open_scene(tmp_path / "splat_30000.ply")) is setting
    assert not caplog.messages


@pytest.mark.parametrize("name", ["point_cloud/iteration_30000/deformation.pth", "deform/iteration_30000/deform.pth"])
def test_networks_that_move_the_gaussians_give_a_warning(model, caplog, monkeypatch, name):
    open_scene(model)
    assert not caplog.text
    (model / name).parent.mkdir(parents=True, exist_ok=True)
    (model / name).touch()
    open_scene(model)
    assert "moves the Gaussians in the course of time and is not read" in caplog.text
    caplog.clear()
    monkeypatch.chdir(model / "point_cloud" / "iteration_30000")
    read_content(Path("point_cloud.ply"))
    assert "moves the Gaussians in the course of time and is not read" in caplog.text


def test_unclear_antialiasing_of_a_training_gives_a_warning(model, caplog):
    (model / "cfg_args").write_text("Namespace(sh_degree=3, kernel_size=0.1, white_background=False)")
    assert not antialiased(open_scene(model))
    assert "argument 'kernel_size: 0.1' is not understood: the scene is drawn without antialiasing" in caplog.text


PROTOCOL = """
[protocol]
name = "one"
title = "One row"
seeds = [0]
metrics = ["psnr"]

[[scene]]
name = "absent"
stream = "absent.swz"
cameras = "absent.json"

[[loss]]
model = "bernoulli:0.3"

[[row]]
key = "complete"
label = "no loss"
lossless = true
"""


@pytest.mark.slow
def test_study_reads_the_gaussians_of_a_model_folder(model, run, tmp_path):
    (tmp_path / "one.toml").write_text(PROTOCOL)
    words = ("study", tmp_path / "one.toml", "-o", tmp_path / "out", "--scene", model)
    done = run(*words, "--cameras", model / "cameras.json", "--workers", "1", "--json")
    assert done.status == 0, done.err
    assert done.json["num_computed"] == 1


@pytest.mark.parametrize(
    ("files", "message"),
    [((), "looks like a model folder without Gaussians"), (("opacity_mlp.pt",), "splatwire import scaffold")],
)
def test_study_names_the_kind_of_a_model_folder_that_it_cannot_use(run, tmp_path, files, message):
    folder = tmp_path / "model" / "point_cloud" / "iteration_7000"
    folder.mkdir(parents=True)
    for name in files:
        (folder / name).touch()
    (tmp_path / "one.toml").write_text(PROTOCOL)
    done = run("study", tmp_path / "one.toml", "-o", tmp_path / "out", "--scene", tmp_path / "model")
    assert done.status == 2
    assert message in done.err
    assert not (tmp_path / "out" / "store").exists()


def test_study_refuses_a_model_whose_last_iteration_lacks_its_networks(run, tmp_path):
    for iteration, name in ((7000, "checkpoint.pth"), (30000, "point_cloud.ply.xz")):
        folder = tmp_path / "model" / "point_cloud" / f"iteration_{iteration}"
        folder.mkdir(parents=True)
        (folder / name).touch()
    (tmp_path / "one.toml").write_text(PROTOCOL)
    done = run("study", tmp_path / "one.toml", "-o", tmp_path / "out", "--scene", tmp_path / "model")
    assert done.status == 2
    assert "iteration_30000: has no checkpoint.pth" in done.err


@pytest.mark.needs_torch
@pytest.mark.parametrize("kind", ["hacpp", "scaffold"])
def test_neural_importers_name_the_kind_of_the_folder(run, model, tmp_path, kind):
    done = run("import", kind, model, "-o", tmp_path / "b.scene")
    assert done.status == 2
    assert "a model folder of 3DGS" in done.err
