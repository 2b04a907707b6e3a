"""`splatwire encode` with a size, a PSNR, a quality number or an effort."""

import functools

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.bitstream import read_stream
from splatwire.cli import _encode_extras
from splatwire.io.formats import write_splats
from splatwire.rate_control import Tuning


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("targets") / "ball.ply"
    write_splats([ball_of_gaussians()], path)
    return path


@pytest.mark.slow
def test_size_is_reached_and_printed(ball, tmp_path, run):
    whole = run("encode", ball, "-o", tmp_path / "whole.swz", "--json").json
    assert "reached" not in whole
    size = whole["num_bytes"] - 150
    done = run("encode", ball, "-o", tmp_path / "a.swz", "--size", f"{size / 1000:g}kB", "--json").json
    assert 0.9 * size <= done["num_bytes"] <= size
    assert (tmp_path / "a.swz").stat().st_size == done["num_bytes"]
    reached = done["reached"]
    assert reached["psnr"] > 20
    assert 0 < reached["kept"] <= 1
    assert reached["effort"] == "default"
    assert reached["classes"] == 6


@pytest.mark.slow
def test_psnr_is_reached_and_equals_that_of_compare(ball, tmp_path, run):
    done = run("encode", ball, "-o", tmp_path / "a.swz", "--psnr", "40", "--json").json
    assert abs(done["reached"]["psnr"] - 40) < 0.6  # 200 Gaussians are too few for every PSNR
    rows = run("compare", ball, tmp_path / "a.swz", "--json").json["rows"]
    assert rows[1]["psnr"] == pytest.approx(done["reached"]["psnr"], abs=0.01)


def test_quality_names_equal_their_quality_numbers(ball, tmp_path, run):
    for value in ("small", "40"):
        assert run("encode", ball, "-o", tmp_path / f"{value}.swz", "--quality", value).status == 0
    assert (tmp_path / "small.swz").read_bytes() == (tmp_path / "40.swz").read_bytes()


@pytest.mark.slow
def test_effort_prunes_and_prints_the_kept_share(ball, tmp_path, run):
    done = run("encode", ball, "-o", tmp_path / "a.swz", "--quality", "30", "--effort", "default")
    assert "% kept, level 5.50)" in done.out
    assert "dB against pictures of the source" in done.out
    assert read_stream(tmp_path / "a.swz")[0].manifest.num_elements < 200
    fast = run("encode", ball, "-o", tmp_path / "b.swz", "--quality", "30", "--effort", "fast", "--json").json
    assert fast["num_elements"] == 200


@pytest.mark.extended
@pytest.mark.slow
def test_effort_best_fine_tunes_and_depends_on_seed_and_losses(ball, tmp_path, run, monkeypatch):
    few = functools.partial(Tuning, iterations=8, num_views=4, size=32)
    monkeypatch.setattr(_encode_extras, "Tuning", few)
    written = []
    for options in ((), ("--seed", "0"), ("--seed", "1"), ("--loss", "bernoulli:0.5")):
        output = tmp_path / f"{len(written)}.swz"
        options = ("--quality", "30", "--block-size", "20", *options)
        done = run("encode", ball, "-o", output, "--effort", "best", *options, "--json")
        assert done.json["reached"]["effort"] == "best"
        assert done.json["reached"]["kept"] < 1
        assert done.json["reached"]["fine_tuned"]
        assert "fine-tuning" in done.err
        written.append(output.read_bytes())
    assert written[0] == written[1]
    assert len(set(written)) == 3


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [("--levels", "auto", "--block-size", "60"), ("--tiers", "0.2"), ("--preset", "datagram"), ("--up", "z")],
)
def test_targets_are_reached_with_other_packetizations(options, ball, tmp_path, run):
    assert run("encode", ball, "-o", tmp_path / "whole.swz", *options).status == 0
    size = (tmp_path / "whole.swz").stat().st_size - 200
    done = run("encode", ball, "-o", tmp_path / "a.swz", "--size", size, *options, "--json").json
    assert 0.85 * size <= done["num_bytes"] <= size
    assert np.isfinite(done["reached"]["psnr"])


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (("--size", "1MB", "--psnr", "40"), "give either --size or --psnr"),
        (("--psnr", "40", "--quality", "50"), "give either --psnr or --quality"),
        (("--size", "big"), "a size is a number of bytes"),
        (("--psnr", "-3"), "--psnr takes decibels above 0"),
        (("--quality", "101"), "a number is 0 to 100"),
        pytest.param(
            ("--size", "10B"), "cannot be encoded to 10 bytes: the smallest stream has", marks=pytest.mark.slow
        ),
        (("--effort", "default", "--keep", "0.5"), "--keep is for --effort fast"),
        (("--effort", "best", "--keep", "0.5"), "--keep is for --effort fast"),
        (("--effort", "best", "--levels", "auto"), "--effort best does not make levels of detail yet"),
        (("--effort", "best", "--loss", "often"), "unknown loss model 'often'"),
        (("--effort", "best", "--seed", "-1"), "seed is 0 to 9,223,372,036,854,775,807, not -1"),
        (("--size", "1MB", "--loss", "bernoulli:0.2"), "--loss is for --effort best"),
        (("--seed", "1"), "--seed is for --effort best"),
    ],
)
def test_contradictory_or_impossible_targets_are_errors(options, error, ball, tmp_path, run):
    done = run("encode", ball, "-o", tmp_path / "a.swz", *options)
    assert done.status != 0
    assert error in done.err
    assert not (tmp_path / "a.swz").exists()


@pytest.mark.parametrize(
    "options", [("--size", "1MB"), ("--psnr", "40"), ("--effort", "default"), ("--effort", "best")]
)
def test_anchors_and_clips_have_no_targets(options, journey, tmp_path, run):
    done = run("encode", journey / "tiny.scene", "-o", tmp_path / "a.swz", *options)
    assert done.status != 0
    assert "explicit Gaussians" in done.err
    frames = tmp_path / "frames"
    frames.mkdir()
    for frame in range(3):
        write_splats([ball_of_gaussians()], frames / f"{frame}.ply")
    done = run("encode", frames, "-o", tmp_path / "a.swz", *options)
    assert done.status != 0
    assert "is for a still scene, not for a clip" in done.err
