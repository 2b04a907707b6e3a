"""`splatwire compare`: several files of one scene in one table, one JSON object and one report."""

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

from explicit import ball_of_gaussians
from moving_sequences import moving_frames
from splatwire.io.formats import write_splats

ROW = {
    "file", "format", "num_bytes", "num_gaussians", "psnr", "ssim", "lpips", "exact", "num_equal_views", "worst_psnr",
    "worst_view", "psnr_by_view", "seconds_decode",
}  # fmt: skip


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    for name in ("a.ply", "c.sog", "d.spz"):
        write_splats([ball_of_gaussians()], folder / name)
    return [folder / name for name in ("a.ply", "c.sog", "d.spz")]


def test_json_has_a_row_for_each_file(run, files):
    outcome = run("compare", *files, "--views", 2, "--json")
    assert outcome.status == 0
    content = outcome.json
    assert set(content) == {"reference", "renderer", "background", "views", "width", "height", "rows", "report"}
    assert content["reference"] == str(files[0])
    assert (len(content["views"]), content["report"]) == (2, None)
    assert [row["file"] for row in content["rows"]] == list(map(str, files))
    assert all(set(row) == ROW for row in content["rows"])
    first, *others = content["rows"]
    assert (first["psnr"], first["worst_psnr"], first["exact"], first["num_equal_views"]) == (None, None, True, 2)
    for row in others:
        assert row["psnr"] == pytest.approx(np.mean(row["psnr_by_view"]))
        assert row["worst_psnr"] == min(row["psnr_by_view"])


def test_table_names_files_bytes_and_figures(run, files):
    out = run("compare", *files, "--views", 1).out
    for file in files:
        assert re.search(rf"{file.name} .*200 .*{file.stat().st_size:,}", out)
    assert "equal" in out
    assert "PSNR dB" in out


@pytest.mark.slow
def test_report_shows_the_pictures_and_differences_of_each_file(run, files, tmp_path):
    outcome = run("compare", *files, "--views", 3, "-o", tmp_path / "report", "--json")
    page = (tmp_path / "report" / "report.html").read_text()
    assert outcome.json["report"] == str(tmp_path / "report" / "report.html")
    shown = {
        alt: _pixels(data) for data, alt in re.findall(r'<img src="data:image/jpeg;base64,([^"]*)" alt="([^"]*)"', page)
    }
    for file in files:
        assert shown[file.name].shape == (400, 400, 3)
        assert shown[file.name].max() > 100
    assert shown["difference of a.ply"].max() == 0
    assert shown["difference of d.spz"].max() > 0
    assert "<h2>Worst view of each file</h2>" in page
    assert "<h3>a.ply" not in page


def _pixels(data):
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def _refused(outcome, *words):
    lines = [line for line in outcome.err.splitlines() if line.startswith("splatwire: error: ")]
    assert (outcome.status, outcome.out, len(lines)) == (2, "", 1)
    assert all(word in lines[0] for word in words)


def test_missing_file_one_file_and_no_view_are_refused_before_anything_is_drawn(run, files, tmp_path):
    for outcome, words in (
        (run("compare", *files, tmp_path / "none.spz"), ("none.spz", "no such file")),
        (run("compare", files[0]), ("two files", "--reference")),
        (run("compare", *files, "--views", 0), ("--views",)),
        (run("compare", *files, "-o", files[0]), ("not a folder",)),
    ):
        _refused(outcome, *words)
        assert "drawing" not in outcome.err


def test_finest_of_several_levels_of_detail_is_compared(run, files, tmp_path):
    stream = tmp_path / "levels.swz"
    assert run("encode", files[0], "-o", stream, "--levels", "auto", "--block-size", 60).status == 0
    assert len(run("inspect", stream, "--json").json["levels"]) > 1
    row = run("compare", files[0], stream, "--views", 2, "--json").json["rows"][1]
    assert row["num_gaussians"] == 200
    assert row["psnr"] > 40


def test_clip_is_refused_by_name(run, files, tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    for number, splats in enumerate(moving_frames(60, 2)):
        write_splats([splats], frames / f"{number}.ply")
    assert run("encode", frames, "-o", tmp_path / "clip.swz", "--fps", 10).status == 0
    _refused(run("compare", files[0], tmp_path / "clip.swz", "--views", 1), "clip.swz is a clip")
    _refused(run("compare", files[0], frames, "--views", 1), str(frames), "not a scene file")
