"""Concealers of installed packages: found by name in every process, and refused with one sentence where broken."""

import json
import logging
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import torch

from conceal.gaps import gaussians, random_context
from conceal.third_party import announce, install_swell
from scenes import tiny_cameras, tiny_scene
from splatwire.channel import parse_loss, transmit
from splatwire.codec import encode_scene
from splatwire.conceal import conceal, concealer_names, create_concealer, register_concealer, registry
from splatwire.data import save_cameras
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.packets import Packetization, write_stream

REPOSITORY = Path(__file__).resolve().parents[2]
PROTOCOL = """
[protocol]
name = "swell"
title = "swell"
metrics = ["psnr"]
[[scene]]
name = "tiny"
stream = "whole.swz"
cameras = "cameras.json"
[[loss]]
model = "bernoulli:0.3"
[[row]]
key = "swell"
label = "swell"
conceal = "swell"
block_size = 60
options = { most = 1.5 }
"""


@pytest.fixture
def known(monkeypatch):
    """What the registry knows, put back afterwards."""
    concealer_names()  # what is installed registers once in a process
    monkeypatch.setattr(registry, "_KNOWN", dict(registry._KNOWN))


@pytest.fixture
def streams(tmp_path):
    stream = encode_scene(tiny_scene(num_anchors=120), Packetization(block_size=60))
    write_stream(stream, tmp_path / "whole.swz")
    write_stream(transmit(stream, parse_loss("bernoulli:0.4"), seed=1)[0], tmp_path / "lossy.swz")
    save_cameras(tiny_cameras(1, 32, 24), tmp_path / "cameras.json")
    return tmp_path


def run(folder, *words):
    """A process of its own that finds the page's package."""
    site = folder / "site"
    if not site.exists():
        site.mkdir()
        install_swell(site)
    path = os.pathsep.join([*filter(None, [os.environ.get("PYTHONPATH")]), str(site)])
    return subprocess.run(
        [sys.executable, "-m", "splatwire", *words], cwd=folder, env={**os.environ, "PYTHONPATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_the_pages_concealer_works_in_a_command(streams):
    done = run(streams, "decode", "lossy.swz", "-o", "a.scene", "--conceal", "swell", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    done = run(streams, "decode", "lossy.swz", "-o", "b.scene", "--conceal", "swell:1")
    assert done.returncode == 2
    assert "concealer 'swell' takes nothing behind a colon" in done.stderr


@pytest.mark.parametrize("engine", [[], ["--engine", "local"]])
def test_a_study_and_its_workers_find_it(streams, engine):
    (streams / "study.toml").write_text(PROTOCOL, encoding="utf-8")
    done = run(streams, "study", "study.toml", "-o", "out", *engine)
    assert done.returncode == 0, done.stderr


def test_in_one_process_with_its_laws(tmp_path, monkeypatch, known):
    monkeypatch.syspath_prepend(install_swell(tmp_path))
    assert "swell" in concealer_names()
    assert vars(create_concealer("swell", most=1.5))["most"] == 1.5
    anchors = random_context(50, 3)
    assert float(conceal(anchors, "swell").hints.size_gain.max()) == pytest.approx(
        float(anchors.known.astype(np.float64).mean()) ** -0.5
    )
    splats = gaussians(torch.rand(9, 3).numpy(), np.full((9,), 0.5, np.float32), np.arange(9) > 2)
    assert len(conceal(splats, "swell").drawn().means) == 6
    assert registry.concealer_package("swell") == ("splatwire-swell 1.0",)
    assert registry.concealer_package("cari") == ()
    with pytest.raises(InvalidValueError, match="largest factor must be at least 1"):
        create_concealer("swell", most=0.5)


@pytest.mark.parametrize(
    ("module", "sentence"),
    [
        ("import nowhere_to_be_found", "concealer 'broken' of acme cannot be loaded: No module named 'nowhere_to_be_f"),
        ("raise OSError('no disk')", "concealer 'broken' of acme cannot be loaded: no disk"),
        ("class Thing: pass", "acme announces concealer 'broken' and does not register it"),
    ],
)
def test_a_broken_package_is_one_sentence_where_it_is_asked_for(tmp_path, monkeypatch, known, caplog, module, sentence):
    name = f"acme_{abs(hash(module))}"
    (tmp_path / f"{name}.py").write_text(module, encoding="utf-8")
    points = {"splatwire.concealers": {"broken": f"{name}:Thing"}}
    announce(tmp_path, {"name": "acme", "version": "1", "entry-points": points})
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InvalidValueError, match=sentence):
        create_concealer("broken")
    with caplog.at_level(logging.WARNING):
        assert "broken" not in concealer_names()
    assert sentence in caplog.text
    with pytest.raises(UnknownNameError, match="broken"):
        create_concealer("magic")


def test_a_name_that_is_taken_is_refused(known):
    with pytest.raises(InvalidValueError, match=r"two concealers are called 'grow': splatwire\.conceal\.grow"):
        register_concealer("grow")(type("Other", (), {}))


def test_the_entry_points_of_the_paper_are_installed():
    """An installation from before they were there has to be made again (`pip install -e .`)."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for name in project["entry-points"][registry.GROUP]:
        assert registry._registered(name).make.__module__.startswith("splatwire.paper.")
