"""`splatwire encode` with a size, a PSNR, a quality number or an effort."""

import numpy as np
import pytest

from explicit import ball_of_gaussians
from splatwire.bitstream import read_stream
from splatwire.io.formats import write_splats


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("targets") / "ball.ply"
    write_splats([ball_of_gaussians()], path)
    return path


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


def test_psnr_is_reached_and_equals_that_of_compare(ball, tmp_path, run):
    done = run("encode", ball, "-o", tmp_path / "a.swz", "--psnr", "40", "--json").json
    assert abs(done["reached"]["psnr"] - 40) < 0.6  # 200 Gaussians are too few for every PSNR
    rows = run("compare", ball, tmp_path / "a.swz", "--json").json["rows"]
    assert rows[1]["psnr"] == pytest.approx(done["reached"]["psnr"], abs=0.01)


def test_quality_names_equal_their_quality_numbers(ball, tmp_path, run):
    for value in ("small", "40"):
        assert run("encode", ball, "-o", tmp_path / f"{value}.swz", "--quality", value).status == 0
    assert (tmp_path / "small.swz").read_bytes() == (tmp_path / "40.swz").read_bytes()


def test_effort_prunes_and_prints_the_kept_share(ball, tmp_path, run):
    done = run("encode", ball, "-o", tmp_path / "a.swz", "--quality", "30", "--effort", "default")
    assert "% kept, level 5.50)" in done.out
    assert "dB against pictures of the source" in done.out
    assert read_stream(tmp_path / "a.swz")[0].manifest.num_elements < 200
    fast = run("encode", ball, "-o", tmp_path / "b.swz", "--quality", "30", "--effort", "fast", "--json").json
    assert fast["num_elements"] == 200


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
        (("--size", "10B"), "cannot be encoded to 10 bytes: the smallest stream has"),
        (("--effort", "default", "--keep", "0.5"), "--keep is for --effort fast"),
    ],
)
def test_contradictory_or_impossible_targets_are_errors(options, error, ball, tmp_path, run):
    done = run("encode", ball, "-o", tmp_path / "a.swz", *options)
    assert done.status != 0
    assert error in done.err
    assert not (tmp_path / "a.swz").exists()


@pytest.mark.parametrize("options", [("--size", "1MB"), ("--psnr", "40"), ("--effort", "default")])
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
