"""Every verb applies the same rule to rows that are invisible or cannot be rendered, and reports them."""

import re
from pathlib import Path

import numpy as np
import pytest

import splatwire
from moving_sequences import cut_frames
from splat_io.formats.handmade import glb, some_splats, write
from splatwire.cli._input_warnings import LOGGERS
from splatwire.io.formats import write_splats

OTHER_MESSAGES = ("splatwire.api.", "splatwire.cli._run_serve.", "splatwire.ops.", "splatwire.transport.")
"""Modules whose warnings are not about inputs: those of servers, of the compiler and of `serve_training`."""


@pytest.fixture
def broken(tmp_path):
    splats = some_splats(60, 0)
    splats.opacities[2:5] = 0
    splats.means[7, 1] = np.nan
    return write(tmp_path / "broken.glb", glb(splats))


def test_every_verb_skips_the_same_gaussians_and_reports_once(run, broken, tmp_path):
    expected = [
        f"splatwire: {broken}: 3 of 60 Gaussians draw nothing and are left out",
        f"splatwire: warning: {broken}: 1 of 60 Gaussians cannot be drawn and are left out (the first is row 7)",
    ]
    found = run("inspect", broken, "--json")
    assert (found.json["num_gaussians"], found.json["num_rows"]) == (56, 60)
    assert found.json["left_out"] == {"draw_nothing": 3, "cannot_be_drawn": 1, "first_that_cannot": 7}
    assert "cannot_be_drawn" in run("inspect", broken).out
    plain = tmp_path / "plain.ply"
    for words in (
        ("import", "splats", broken, "-o", plain),
        ("encode", broken, "-o", tmp_path / "a.swz", "--tiers", "0.3"),
        ("render", broken, "-o", tmp_path / "pictures", "--scale", "0.1"),
        ("evaluate", plain, "--reference", broken, "--views", "1"),
        ("export", "splat", broken, "-o", tmp_path / "a.splat"),
    ):
        done = run(*words)
        assert done.status == 0, words
        assert [line for line in done.err.splitlines() if line.startswith("splatwire:")] == expected, words
    assert run("inspect", tmp_path / "a.swz", "--json").json["num_elements"] == 56


def test_scene_without_drawable_gaussians_is_one_error(run, tmp_path):
    splats = some_splats(5, 0)
    splats.opacities[:] = 0
    path = write(tmp_path / "empty.glb", glb(splats))
    for words in (("encode", path, "-o", tmp_path / "a.swz"), ("render", path, "-o", tmp_path / "pictures")):
        done = run(*words)
        assert done.status == 2
        assert "none of its 5 Gaussians is left: 5 draw nothing" in done.err.splitlines()[-1]
    found = run("inspect", path, "--json").json
    assert (found["num_gaussians"], found["left_out"]["draw_nothing"]) == (0, 5)


def test_warnings_about_clips_have_the_name_of_the_program(run, tmp_path):
    clip = tmp_path / "clip"
    clip.mkdir()
    for number in (1, 2, 4):
        write_splats([some_splats(60, 0)], clip / f"{number}.ply")
    err = run("encode", clip, "-o", tmp_path / "a.swz").err
    assert f"splatwire: warning: {clip}: frames are missing after 2.ply" in err


def test_a_warning_about_many_frames_is_given_once_with_their_number(run, tmp_path):
    clip = tmp_path / "clip"
    clip.mkdir()
    for number in range(5):
        write_splats([some_splats(60, 0)], clip / f"{number}.ply")
        data = (clip / f"{number}.ply").read_bytes()
        comments = f"comment offset: {number} 20 30\n" + "comment unit: cm\n" * (number > 2)
        (clip / f"{number}.ply").write_bytes(data.replace(b"element vertex", comments.encode() + b"element vertex"))
    done = run("encode", clip, "-o", tmp_path / "a.swz")
    shift = "comment 'offset: 0 20 30' may be a shift of the positions: it is left out, values are read as they are"
    unit = "comment 'unit: cm' may be the unit of the positions: it is left out, values are read as they are"
    assert [line for line in done.err.splitlines() if line.startswith("splatwire:")] == [
        f"splatwire: warning: {clip}/0.ply: {shift} in the file",
        f"splatwire: warning: {clip}/3.ply: {unit} in the file",
        f"splatwire: warning: {clip}: 4 more files like 0.ply: {shift} in the file",
        f"splatwire: warning: {clip}: 1 more file like 3.ply: {unit} in the file",
    ]


def test_metadata_that_are_left_out_give_a_warning_once(run, tmp_path):
    asset = {"version": "2.0", "extras": {"author": ["A", "B"]}}
    path = write(tmp_path / "a.glb", glb(some_splats(60, 0), {"asset": asset}))
    warning = f"splatwire: warning: {path}: 'author' of its metadata is left out: expected text, not list"
    for words in (("inspect", path), ("encode", path, "-o", tmp_path / "a.swz")):
        assert [line for line in run(*words).err.splitlines() if "left out" in line] == [warning]


def test_modules_that_warn_about_inputs_have_a_logger_that_is_printed():
    folder = Path(splatwire.__file__).parent
    modules = {
        ".".join(("splatwire", *file.relative_to(folder).with_suffix("").parts)) + "."
        for file in folder.rglob("*.py")
        if "LOG.warning(" in file.read_text(encoding="utf-8")
    }
    printed = tuple(f"{logger}." for logger in LOGGERS)
    assert {name for name in modules if not name.startswith((*OTHER_MESSAGES, *printed))} == set()


def test_clips_with_scenes_too_small_for_their_lattice_give_a_warning(run, tmp_path):
    clip = tmp_path / "clip"
    clip.mkdir()
    for number, splats in enumerate(cut_frames(100, 2, [1.0, 1e-8])):
        write_splats([splats], clip / f"{number}.ply")
    err = run("encode", clip, "-o", tmp_path / "a.swz", "--group", "2").err
    assert re.search(r"^splatwire: warning: (\d+) of \1 new Gaussians are smaller than two steps", err, re.M)
