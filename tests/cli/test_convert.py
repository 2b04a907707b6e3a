"""`convert` gives the results of encode, export and decode, for one file or for many."""

import os
import signal
import sys
from dataclasses import replace

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.cli import _run_convert
from splatwire.io.formats import read_splats, write_splats
from splatwire.sequence.frames import frame_files


def shifted(number=0):
    """Ball of Gaussians, moved along x."""
    ball = ball_of_gaussians()
    return replace(ball, means=ball.means + np.float32([0.01 * number, 0, 0]))


@pytest.fixture
def cloud(tmp_path):
    write_splats([shifted()], tmp_path / "cloud.ply")
    return tmp_path / "cloud.ply"


@pytest.fixture
def frames(tmp_path):
    folder = tmp_path / "walk"
    folder.mkdir()
    for number in range(3):
        write_splats([shifted(number)], folder / f"{number}.ply")
    return folder


def test_converted_stream_equals_that_of_encode(run, cloud, tmp_path):
    done = run("convert", cloud, tmp_path / "a.swz", "--json")
    assert done.status == 0, done.err
    assert run("encode", cloud, "-o", tmp_path / "b.swz").status == 0
    assert (tmp_path / "a.swz").read_bytes() == (tmp_path / "b.swz").read_bytes()
    assert done.json["num_bytes"] == (tmp_path / "a.swz").stat().st_size


@pytest.mark.parametrize("form", ["ply", "compressed-ply", "spz", "sog", "splat", "glb"])
def test_converted_files_equal_those_of_export_in_every_format(run, cloud, tmp_path, form):
    assert run("convert", cloud, tmp_path / "a.swz").status == 0
    ending = form.replace("-", ".")
    done = run("convert", tmp_path / "a.swz", tmp_path / f"x.{ending}", "--json")
    assert done.status == 0, done.err
    assert run("export", form, tmp_path / "a.swz", "-o", tmp_path / f"y.{ending}").status == 0
    assert (tmp_path / f"x.{ending}").read_bytes() == (tmp_path / f"y.{ending}").read_bytes()


def test_anchors_become_gaussians(run, journey, tmp_path):
    done = run("convert", journey / "tiny.swz", tmp_path / "a.ply", "--json")
    assert done.status == 0, done.err
    assert done.json["num_gaussians"] == read_splats(tmp_path / "a.ply").num_gaussians > 100


@pytest.mark.slow
def test_frames_become_frames_of_another_format_and_a_clip_and_frames_again(run, frames, tmp_path):
    assert run("convert", frames, tmp_path / "small", "--to", "spz", "--json").json["num_frames"] == 3
    names = [path.name for path in frame_files(tmp_path / "small")]
    assert names == ["frame_0.spz", "frame_1.spz", "frame_2.spz"]
    for number, path in enumerate(frame_files(tmp_path / "small")):
        np.testing.assert_allclose(read_splats(path).means, shifted(number).means, atol=1e-3)
    assert run("convert", frames, tmp_path / "walk.swz").status == 0
    assert run("inspect", tmp_path / "walk.swz", "--json").json["clip"]["frames"] == 3
    assert run("convert", tmp_path / "walk.swz", tmp_path / "back", "--to", "sog").status == 0
    assert [path.name for path in frame_files(tmp_path / "back")] == ["frame_0.sog", "frame_1.sog", "frame_2.sog"]


@pytest.mark.slow
def test_many_files_are_converted_and_failures_named(run, cloud, frames, tmp_path):
    write_splats([shifted(5)], tmp_path / "other.compressed.ply")
    (tmp_path / "broken.ply").write_bytes(cloud.read_bytes()[:-100])
    sources = (cloud, tmp_path / "other.compressed.ply", frames)
    out = tmp_path / "out"
    done = run("convert", *sources, "--to", "spz", "-o", out, "--jobs", 2, "--json")
    assert done.status == 0, done.err
    assert sorted(path.name for path in out.iterdir()) == ["cloud.spz", "other.spz", "walk"]
    assert [each["status"] for each in done.json["converted"]] == [0, 0, 0]
    assert done.json["converted"][0]["facts"]["num_gaussians"] == shifted().num_gaussians
    done = run("convert", cloud, tmp_path / "broken.ply", "--to", "swz", "-o", out, "--json")
    assert done.status == 2
    assert [each["status"] for each in done.json["converted"]] == [0, 2]
    assert "broken.ply" in done.json["converted"][1]["error"]
    assert (out / "cloud.swz").exists()
    assert not (out / "broken.swz").exists()


def test_other_processes_import_no_module_from_the_current_folder(run, cloud, tmp_path, monkeypatch):
    (tmp_path / "random.py").write_text("raise SystemExit('the module of the folder was imported')\n")
    monkeypatch.chdir(tmp_path)
    done = run("convert", "cloud.ply", "--to", "spz", "-o", "streams")
    assert done.status == 0, done.err
    assert (tmp_path / "streams" / "cloud.spz").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM")
def test_a_signal_ends_the_conversions_that_run_and_those_that_wait(run, cloud, tmp_path, monkeypatch):
    finished = []

    def convert(processes, chosen, accept_damage):
        os.kill(os.getpid(), signal.SIGTERM)
        finished.append(processes.run([sys.executable, "-c", "import time; time.sleep(300)"]))

    sources = [tmp_path / f"{number}.ply" for number in range(3)]
    for path in sources:
        path.write_bytes(cloud.read_bytes())
    monkeypatch.setattr(_run_convert, "_in_process", convert)
    done = run("convert", *sources, "--to", "spz", "-o", tmp_path / "out", "--jobs", 1)
    assert done.status == 128 + signal.SIGTERM
    assert all(each.returncode for each in finished)


def test_a_scene_becomes_3d_tiles(run, cloud, frames, tmp_path):
    done = run("convert", cloud, tmp_path / "tiles", "--to", "3dtiles", "--json")
    assert done.status == 0, done.err
    assert done.json["num_gaussians"] == shifted().num_gaussians
    assert (tmp_path / "tiles" / "tileset.json").is_file()
    assert "still scenes" in run("convert", frames, tmp_path / "no", "--to", "3dtiles").err
    assert not (tmp_path / "no").exists()


def test_damage_gives_its_own_status(run, cloud, tmp_path):
    assert run("convert", cloud, tmp_path / "a.swz").status == 0
    data = bytearray((tmp_path / "a.swz").read_bytes())
    data[-5] ^= 4
    (tmp_path / "a.swz").write_bytes(data)
    assert run("convert", tmp_path / "a.swz", tmp_path / "a.ply").status == 3
    assert run("convert", tmp_path / "a.swz", tmp_path / "a.ply", "--accept-damage").status == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["cloud.ply"], "one input and one output"),
        (["cloud.ply", "a.swz", "b.swz"], "--to FORMAT -o FOLDER"),
        (["cloud.ply", "a.obj"], "a.obj: its suffix names no format to write; known are .4dgs, .compressed.ply, "),
        (["cloud.ply", "a.4dgs"], "cloud.ply is a still scene; .4dgs files are for clips"),
        (["cloud.ply", "--to", "obj", "-o", "out"], "unknown format to write 'obj': known are 3dtiles, 4dgs"),
        (["cloud.ply", "--to", "obj", "-o", "out"], "streamed-sog, swz, usd, usda, usdc, usdz"),
        (["cloud.ply", "cloud.ply", "--to", "spz", "-o", "out"], "would both be written"),
        (["walk/cloud.ply", "cloud.ply", "--to", "spz", "-o", "out"], "would both be written"),
        (["--to", "spz", "-o", "out"], "name the files"),
        (["-", "--to", "spz", "-o", "out"], "standard input"),
        (["walk", "walk.ply"], "written to a folder"),
        (["missing.ply", "a.swz"], "no such file"),
        (["cloud.ply", "a.swz", "--jobs", "0"], "--jobs is from 1"),
    ],
)
def test_invalid_arguments_are_one_error_line_and_write_nothing(
    run, cloud, frames, tmp_path, monkeypatch, words, message
):
    monkeypatch.chdir(tmp_path)
    before = {path.name for path in tmp_path.iterdir()}
    done = run("convert", *words)
    assert done.status == 2
    assert message in done.err
    assert len(done.err.splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == before


@pytest.mark.slow
def test_clips_become_time_samples_of_openusd_and_clips_again(run, frames, tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    assert run("convert", frames, tmp_path / "walk.swz").status == 0
    done = run("convert", tmp_path / "walk.swz", tmp_path / "walk.usdc", "--json")
    assert done.status == 0, done.err
    assert (done.json["num_frames"], done.json["fps"]) == (3, 30)
    assert run("convert", frames, tmp_path / "direct.usdz", "--json").json["num_frames"] == 3
    assert run("convert", tmp_path / "direct.usdz", tmp_path / "again.swz").status == 0
    assert run("inspect", tmp_path / "again.swz", "--json").json["clip"]["frames"] == 3
    assert run("convert", tmp_path / "direct.usdz", tmp_path / "files", "--to", "ply", "--json").json["num_frames"] == 3


def test_very_many_frames_become_no_file_of_another_program(run, frames, tmp_path, monkeypatch):
    """A few bytes may announce 131,072 frames, which such a file would contain one by one."""
    assert run("convert", frames, tmp_path / "walk.swz").status == 0
    monkeypatch.setattr("splatwire.sequence.frame_writer.MAX_FILES", 2)
    for name in ("walk.splat4d", "walk.4dgs", "walk.usdc"):
        done = run("convert", tmp_path / "walk.swz", tmp_path / name)
        assert done.status == 2
        assert "has 3 frames, and a file of this format gets 2 at most" in done.err
        assert not (tmp_path / name).exists()
    done = run("convert", tmp_path / "walk.swz", tmp_path / "files", "--to", "spz")
    assert "--max-frames of `decode` allows more" in done.err


@pytest.mark.slow
def test_clips_become_files_of_other_programs_and_clips_again(run, frames, tmp_path):
    pytest.importorskip("fourdgs", reason="fourdgs is not installed")
    done = run("convert", frames, tmp_path / "walk.4dgs", "--json")
    assert done.status == 0, done.err
    assert done.json["num_frames"] == 3
    assert run("convert", tmp_path / "walk.4dgs", tmp_path / "again.swz").status == 0
    assert run("inspect", tmp_path / "again.swz", "--json").json["clip"]["frames"] == 3
    done = run("convert", tmp_path / "again.swz", "--to", "4dgs", "-o", tmp_path / "out", "--json")
    assert done.status == 0, done.err
    assert (tmp_path / "out" / "again.4dgs").is_file()
