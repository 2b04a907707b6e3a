"""The codec of a documented package: files, streams, losses, evaluation, and a study with its workers."""

import json

import numpy as np
import pytest

from distributions import install_page, run_with
from splatwire.concealment import concealer_names
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow  # each test starts processes

PROTOCOL = """
[protocol]
name = "points"
title = "points"
metrics = ["psnr"]
views = 2
[[scene]]
name = "cloud"
scene = "cloud.pts"
[[loss]]
model = "bernoulli:0.3"
[[row]]
key = "drop"
label = "drop"
block_size = 60
[[row]]
key = "grow"
label = "grow"
conceal = "grow"
block_size = 60
"""
COUNT = 400


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("points")
    install_page("your-own-codec.md", folder / "site")
    rng = np.random.default_rng(0)
    rows = np.concatenate([rng.random((COUNT, 3)), rng.integers(256, size=(COUNT, 3))], axis=1)
    np.savetxt(folder / "cloud.pts", rows, "%.7g", header="points")
    run(folder, "encode", "cloud.pts", "-o", "cloud.swz")
    (folder / "study.toml").write_text(PROTOCOL, encoding="utf-8")
    return folder


def run(folder, *words):
    done = run_with(folder / "site", folder, *words)
    assert done.returncode == 0, done.stderr
    return done


def test_scene_of_the_package_is_inspected_as_a_file_and_as_a_stream(folder):
    file = json.loads(run(folder, "inspect", "cloud.pts", "--json").stdout)
    assert (file["kind"], file["num_gaussians"]) == ("scene", COUNT)
    stream = json.loads(run(folder, "inspect", "cloud.swz", "--json").stdout)
    assert stream["codec"] == "points"
    assert stream["side_info_parts"]["places"] > 6 * COUNT


@pytest.mark.parametrize("preset", ["spread", "datagram", "paper"])
def test_decoded_points_are_those_of_the_file(folder, preset):
    run(folder, "encode", "cloud.pts", "-o", f"{preset}.swz", "--preset", preset)
    run(folder, "decode", f"{preset}.swz", "-o", f"{preset}.pts")
    before, after = np.loadtxt(folder / "cloud.pts"), np.loadtxt(folder / f"{preset}.pts")
    assert np.abs(before - after).max() < 2e-5


def test_decoded_points_are_written_in_formats_of_gaussians(folder):
    run(folder, "decode", "cloud.swz", "-o", "cloud.ply")
    run(folder, "export", "spz", "cloud.swz", "-o", "cloud.spz")


def test_losses_of_points_are_concealed_and_scored(folder):
    run(folder, "encode", "cloud.pts", "-o", "small.swz", "--preset", "paper", "--block-size", 50)
    run(folder, "transmit", "small.swz", "-o", "lossy.swz", "--loss", "bernoulli:0.3")
    content = json.loads(run(folder, "decode", "lossy.swz", "-o", "lossy.pts", "--conceal", "grow", "--json").stdout)
    assert 0 < content["num_lost"] < COUNT
    words = ("evaluate", "small.swz", "--reference", "cloud.pts", "--loss", "bernoulli:0.3", "--views", "2")
    rows = {row["method"]: row for row in json.loads(run(folder, *words, "--json").stdout)["rows"]}
    assert set(rows) == {"no loss", *concealer_names((), {Splats})}
    assert rows["no loss"]["psnr"] > rows["grow"]["psnr"] > 0


def test_study_and_its_workers_encode_and_decode_points(folder):
    run(folder, "study", "study.toml", "-o", "out", "--engine", "local", "--workers", "1")
    table = (folder / "out" / "tables.md").read_text()
    assert "| drop |" in table
    assert "points hit" in table


def test_stream_without_its_package_is_one_line(folder, tmp_path):
    for words in (("inspect", "cloud.swz"), ("decode", "cloud.swz", "-o", "x.ply")):
        done = run_with(tmp_path, folder, *words)
        assert done.returncode == 2
        assert "format_version 2 has no codec 'points'" in done.stderr


def test_package_that_cannot_be_loaded_is_named(folder, tmp_path):
    install_page("your-own-codec.md", tmp_path / "site")
    module = tmp_path / "site" / "points.py"
    module.write_text("import nowhere_to_be_found\n" + module.read_text())
    done = run_with(tmp_path / "site", folder, "decode", "cloud.swz", "-o", "x.ply")
    assert done.returncode == 2
    assert "schema 'points' of splatwire-points cannot be loaded: No module named 'nowhere_to_be_found'" in done.stderr
    done = run_with(tmp_path / "site", folder, "inspect", "decoded.ply")
    assert "splatwire-points" not in done.stderr
