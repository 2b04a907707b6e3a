"""A file with rows that draw nothing or cannot be drawn, through the verbs: all of them go by one rule and say so."""

import numpy as np
import pytest

from formats.handmade import glb, some_splats, write


@pytest.fixture
def broken(tmp_path):
    splats = some_splats(60, 0)
    splats.opacities[2:5] = 0
    splats.means[7, 1] = np.nan
    return write(tmp_path / "broken.glb", glb(splats))


def test_every_verb_leaves_out_the_same_and_says_it_once(run, broken, tmp_path):
    told = [
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
        assert [line for line in done.err.splitlines() if line.startswith("splatwire:")] == told, words
    assert run("inspect", tmp_path / "a.swz", "--json").json["num_elements"] == 56


def test_nothing_left_is_one_clear_error(run, tmp_path):
    splats = some_splats(5, 0)
    splats.opacities[:] = 0
    path = write(tmp_path / "empty.glb", glb(splats))
    for words in (("encode", path, "-o", tmp_path / "a.swz"), ("render", path, "-o", tmp_path / "pictures")):
        done = run(*words)
        assert done.status == 2
        assert "none of its 5 Gaussians is left: 5 draw nothing" in done.err.splitlines()[-1]
    found = run("inspect", path, "--json").json
    assert (found["num_gaussians"], found["left_out"]["draw_nothing"]) == (0, 5)
