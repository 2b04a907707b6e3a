"""`evaluate --path`: quality along a camera path during a transfer."""

import json

import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.bitstream import Packetization, write_stream
from splatwire.data import save_cameras
from splatwire.io.formats import write_splats
from splatwire.lod import encode_levels
from splatwire.render.importance import surrounding_cameras
from splatwire.types import SplatScene

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path, scene = tmp_path_factory.mktemp("path"), SplatScene(some_splats(900))
    write_stream(encode_levels(scene, Packetization(block_size=40, lanes=2)), path / "city.swz")
    write_splats([scene.splats], path / "big.ply")
    save_cameras(surrounding_cameras(scene, 3, 32), path / "cameras.json")
    return path


def command(folder, *options):
    given = ["evaluate", f"{folder}/city.swz", "--reference", f"{folder}/big.ply"]
    return [*given, "--path", f"{folder}/cameras.json", *options]


def test_path_evaluation_reports_quality_over_time(folder, tmp_path, run):
    outcome = run(*command(folder, "--rate", "200k", "--seconds", "1", "--json", "-o", str(tmp_path / "report")))
    report = json.loads(outcome.out)
    moments = report["moments"]
    assert [moment["seconds"] for moment in moments if moment["seconds"] % 0.25 == 0] == [0, 0.25, 0.5, 0.75, 1]
    assert report["rate"] == 200e3
    assert moments[-1]["psnr"] > report["first_picture"]["psnr"] > moments[0]["psnr"]
    assert report["first_picture"]["num_bytes"] < moments[-1]["num_bytes"] <= 200e3 / 8
    text = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert text.count("<figure>") == 10
    table = run(*command(folder, "--rate", "10M", "--seconds", "1", "--loss", "bernoulli:0.1", "--seeds", "2")).out
    assert "bernoulli:0.1" in table


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--rate", "fast"], "bits per second"),
        ([], "--rate"),
        (["--rate", "0"], "above 0"),
        (["--rate", "1M", "--views", "2"], "--views"),
        (["--rate", "1M", "--seconds", "0"], "more than 0"),
        (["--rate", "1M", "--delay", "-1"], "a delay is"),
        (["--rate", "1M", "--seeds", "1", "2"], "one seed"),
    ],
)
def test_options_unusable_with_a_path_are_refused(folder, run, options, message):
    outcome = run(*command(folder, *options))
    assert (outcome.status, message in outcome.err) == (2, True)


def test_rate_requires_a_path(folder, run):
    given = ["evaluate", f"{folder}/city.swz", "--reference", f"{folder}/big.ply"]
    outcome = run(*given, "--rate", "1M")
    assert (outcome.status, "--path" in outcome.err) == (2, True)
