"""Updates on the command line: encoding, inspection, verification and application."""

import json
from dataclasses import replace

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.io.formats import write_splats

BALL = np.argsort(np.linalg.norm(some_splats().means - some_splats().means[7], axis=1))[:40]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path, splats = tmp_path_factory.mktemp("updates"), some_splats()
    means = splats.means.copy()
    means[BALL, 0] += 0.7
    write_splats([splats], path / "old.ply")
    write_splats([replace(splats, means=means)], path / "new.ply")
    return path


def test_updates_are_encoded_inspected_verified_and_applied(folder, run):
    old, change, new, again = (str(folder / f"{name}.swz") for name in ("old", "change", "new", "again"))
    assert run("encode", str(folder / "old.ply"), "-o", old).status == 0
    report = json.loads(run("encode", str(folder / "new.ply"), "--update", old, "-o", change, "--json").out)
    assert (report["num_kept"], report["num_removed"], report["num_new"]) == (460, 40, 40)
    assert 0 < report["share"] < 1
    facts = json.loads(run("inspect", change, "--json").out)
    assert (facts["codec"], facts["format_version"], facts["num_elements"]) == ("update", 5, 40)
    assert facts["update"]["base_digest"] == json.loads(run("inspect", old, "--json").out)["manifest_digest"]
    assert run("verify", change).status == 0
    applied = json.loads(run("apply", old, change, "-o", new, "--json").out)
    assert applied["num_elements"] == 500
    assert facts["update"]["result_digest"] == json.loads(run("inspect", new, "--json").out)["manifest_digest"]
    assert run("verify", new).status == 0
    wrong = run("apply", new, change, "-o", again)
    assert (wrong.status, "the update changes another stream" in wrong.err) == (2, True)
    unlike = run("encode", change, "-o", again)
    assert (unlike.status, "is an update, which has only the changes" in unlike.err) == (2, True)
    for words in (("decode", change, "-o", folder / "x.ply"), ("render", change, "-o", folder / "x"),
                  ("thumb", change, "-o", folder / "x.png"), ("convert", change, folder / "x.spz"),
                  ("evaluate", change, "--reference", folder / "old.ply"), ("plan", change),
                  ("serve", change), ("serve", change, "--page", "0"), ("view", change, "--no-open"),
                  ("pack", change, "-o", folder / "x.html"), ("publish", change, "-o", folder / "x")):  # fmt: skip
        alone = run(*words)
        assert (alone.status, "is an update, which has only the changes" in alone.err) == (2, True), words
    assert not list(folder.glob("x*"))


@pytest.mark.parametrize("option", [("--quality", "50"), ("--preset", "paper"), ("--levels", "auto"), ("--fps", "30")])
def test_updates_refuse_options_that_their_stream_determines(folder, run, option):
    outcome = run("encode", str(folder / "new.ply"), "--update", "old.swz", "-o", str(folder / "x.swz"), *option)
    assert (outcome.status, f"{option[0]} cannot be combined with --update" in outcome.err) == (2, True)
