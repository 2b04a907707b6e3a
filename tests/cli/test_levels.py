"""Levels on the command line: encoding, inspection, loss and concealment."""

import json

import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.io.formats import write_splats


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("levels") / "ball.ply"
    write_splats([some_splats(900)], path)
    return path


def test_levels_are_encoded_inspected_and_concealed(scene, tmp_path, run):
    stream, lossy, out = (str(tmp_path / name) for name in ("a.swz", "b.swz", "c.ply"))
    assert run("encode", str(scene), "-o", stream, "--levels", "auto", "--block-size", "60").status == 0
    facts = json.loads(run("inspect", stream, "--json").out)
    assert list(facts["levels"]) == ["level 0", "level 1", "level 2"]
    assert facts["levels"]["level 0"]["Gaussians"] == 900
    assert facts["levels"]["level 2"]["error"] > facts["levels"]["level 1"]["error"] > 0
    assert run("transmit", stream, "-o", lossy, "--loss", "bernoulli:0.3", "--seed", "3").status == 0
    assert run("decode", lossy, "-o", out, "--conceal", "coarse").status == 0
    kept = json.loads(run("inspect", out, "--json").out)["num_gaussians"]
    assert run("decode", lossy, "-o", out, "--conceal", "drop").status == 0
    assert 0 < json.loads(run("inspect", out, "--json").out)["num_gaussians"] < kept
    assert run("encode", stream, "-o", lossy).status == 0
    assert json.loads(run("inspect", lossy, "--json").out)["num_elements"] == 900


def test_levels_exclude_the_option_tiers(scene, tmp_path, run):
    outcome = run("encode", str(scene), "-o", str(tmp_path / "a.swz"), "--levels", "auto", "--tiers", "0.1")
    assert (outcome.status, "replace --tiers" in outcome.err) == (2, True)
