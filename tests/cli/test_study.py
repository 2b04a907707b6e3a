"""`splatwire study PROTOCOL.toml`: output files, resuming, and one error line per mistake."""

import importlib.util
import json
from dataclasses import replace

import numpy as np
import pytest

from scenes import tiny_cameras
from splat_io.formats.handmade import some_splats
from splat_io.formats.test_origin import UTM
from splatwire.bitstream import write_stream
from splatwire.codec import encode_scene
from splatwire.data import save_cameras
from splatwire.evaluation.study import InProcess
from splatwire.types import SplatScene
from splatwire.types.origin import NO_ORIGIN

pytestmark = pytest.mark.slow

PROTOCOL = """
[protocol]
seeds = [1, 2]
metrics = ["psnr"]

[[scene]]
name = "tiny"
stream = "{stream}"
cameras = "{cameras}"

[[loss]]
model = "bernoulli:0.3"

[[row]]
key = "drop"
label = "none"
"""


def assert_complains(outcome, words):
    assert (outcome.status, outcome.out) == (2, "")
    last = outcome.err.splitlines()[-1]
    assert last.startswith("splatwire: error: ")
    assert words in last


def _protocol(tmp_path, journey, text=PROTOCOL):
    path = tmp_path / "mine.toml"
    path.write_text(text.format(stream=journey / "tiny.swz", cameras=journey / "cameras.json"))
    return path


def test_protocol_runs_once_and_reuses_its_records(run, journey, tmp_path):
    path = _protocol(tmp_path, journey)
    words = (path, "-o", tmp_path / "out", "--views", 1, "--workers", 1, "--json")
    first, again = run("study", *words).json, run("study", *words).json
    assert (first["num_computed"], first["num_reused"]) == (2, 0)
    assert (again["num_computed"], again["num_reused"]) == (0, 2)
    assert again["rows"] == first["rows"]
    assert json.loads((tmp_path / "out" / "results.json").read_text())["seeds"] == [1, 2]


def test_streams_are_drawn_at_their_origin_and_with_their_antialiasing(run, tmp_path, monkeypatch):
    monkeypatch.setattr("splatwire.cli._run_study.create_engine", lambda *_: InProcess())
    splats, psnr = some_splats(200, 0), {}
    splats = replace(splats, scales=splats.scales * np.float32(0.1))
    for name, origin, antialiased in (("local", NO_ORIGIN, False), ("world", UTM, False), ("smooth", NO_ORIGIN, True)):
        folder = tmp_path / name
        folder.mkdir()
        write_stream(encode_scene(SplatScene(splats, origin=origin, antialiased=antialiased)), folder / "tiny.swz")
        save_cameras(replace(tiny_cameras(1, 64, 48, distance=5.0), origin=origin), folder / "cameras.json")
        done = run("study", _protocol(folder, folder), "-o", folder / "out", "--json")
        assert "cameras are around" not in done.err
        psnr[name] = done.json["rows"][0]["figures"]["psnr"]["mean"]
    assert psnr["world"] == pytest.approx(psnr["local"], abs=0.1)
    assert psnr["smooth"] > psnr["local"] + 10  # small Gaussians are nearly transparent


@pytest.mark.needs_torch
def test_renderer_option_overrides_the_protocol(run, journey, tmp_path, monkeypatch):
    """The option also applies when it names the default, because the protocol may name another renderer."""
    monkeypatch.setattr("splatwire.cli._run_study.create_engine", lambda *_: InProcess())
    text = PROTOCOL.replace("seeds = [1, 2]", 'seeds = [1]\nrenderer = "reference"')
    words = (_protocol(tmp_path, journey, text), "-o", tmp_path / "out", "--views", 1, "--json")
    for number, more in enumerate(((), ("--renderer", "cpu"))):
        assert run("study", *words, *more).json["num_computed"] == 1, number
    records = (tmp_path / "out" / "records.csv").read_text().splitlines()
    assert ",cpu," in records[1]


def test_invalid_protocol_is_one_error_line(run, journey, tmp_path):
    path = _protocol(tmp_path, journey)
    assert "--output" in run("study", path).err
    assert_complains(run("study", path, "-o", tmp_path / "out", "--engine", "moon"), "unknown engine")
    assert_complains(run("study", path, "-o", tmp_path / "out", "--photos", tmp_path), "--scene")
    both = ("--scene", "bundled", "--photos", tmp_path, "--cameras", journey / "cameras.json")
    assert_complains(run("study", path, "-o", tmp_path / "out", *both), "not both")
    assert_complains(run("study", path, "-o", tmp_path / "out", "--views", 0), "views")
    assert_complains(run("study", path, "-o", tmp_path / "out", "--renderer", "crayons"), "crayons")
    assert_complains(run("study", path, "-o", tmp_path / "out", "--scene", tmp_path / "absent"), "does not exist")
    assert_complains(run("study", path, "-o", tmp_path / "out", "--seeds", 1, 1), "seed 1 is there 2 times")
    assert_complains(run("study", tmp_path / "absent.toml", "-o", tmp_path / "out"), "absent.toml")
    wrong = _protocol(tmp_path, journey, PROTOCOL.replace("seeds", "sedes"))
    assert_complains(run("study", wrong, "-o", tmp_path / "out"), "did you mean 'seeds'")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("module", ["pyarrow", "matplotlib", "jinja2"])
def test_missing_result_writer_is_reported_before_the_work(run, journey, tmp_path, monkeypatch, module):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == module else found(name, *rest))
    done = run("study", _protocol(tmp_path, journey), "-o", tmp_path / "out")
    assert_complains(done, "pip install 'splatwire[")
    assert module in done.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("words", [("--partition", "x"), ("--account", "x"), ("--minutes", 5), ("--memory-gb", 5)])
def test_slurm_options_require_the_slurm_engine(run, journey, tmp_path, words):
    assert_complains(run("study", _protocol(tmp_path, journey), "-o", tmp_path / "out", *words), "for engine 'slurm'")
