"""Concealers of installed packages are found by name in every process, and broken ones give one error sentence."""

import json
import logging
import tomllib
from pathlib import Path

import numpy as np
import pytest

from concealment.gaps import gaussians, random_context
from distributions import announce, install_page, run_with
from random_numbers import Numbers
from scenes import tiny_cameras, tiny_scene
from splatwire.bitstream import Packetization, write_stream
from splatwire.channel import parse_loss, transmit
from splatwire.codec import encode_scene
from splatwire.concealment import conceal, concealer_names, create_concealer, register_concealer, registry
from splatwire.data import save_cameras
from splatwire.errors import InvalidValueError, UnknownNameError

pytestmark = pytest.mark.slow

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
options = { max_factor = 1.5 }
"""


@pytest.fixture
def known(monkeypatch):
    """Restores the registry afterwards."""
    concealer_names()  # an installed package registers once per process
    for name in ("_entries", "_sources"):
        monkeypatch.setattr(registry.CONCEALERS, name, dict(getattr(registry.CONCEALERS, name)))
    for name, kind in (("_loaded", list), ("_warned", set)):
        monkeypatch.setattr(registry.CONCEALERS, name, kind())


@pytest.fixture
def streams(tmp_path):
    stream = encode_scene(tiny_scene(num_anchors=120), Packetization(block_size=60))
    write_stream(stream, tmp_path / "whole.swz")
    write_stream(transmit(stream, parse_loss("bernoulli:0.4"), seed=1)[0], tmp_path / "lossy.swz")
    save_cameras(tiny_cameras(1, 32, 24), tmp_path / "cameras.json")
    return tmp_path


def run(folder, *words):
    """Runs code in a process that finds the package of the documentation page."""
    site = folder / "site"
    if not site.exists():
        install_page("your-own-concealer.md", site)
    return run_with(site, folder, *words)


def test_documented_concealer_works_on_the_command_line(streams):
    done = run(streams, "decode", "lossy.swz", "-o", "a.scene", "--conceal", "swell", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    done = run(streams, "decode", "lossy.swz", "-o", "b.scene", "--conceal", "swell:1")
    assert done.returncode == 2
    assert "concealer 'swell' takes no value after a colon" in done.stderr


@pytest.mark.parametrize("engine", [[], ["--engine", "local"]])
def test_study_workers_find_third_party_concealers(streams, engine):
    (streams / "study.toml").write_text(PROTOCOL, encoding="utf-8")
    done = run(streams, "study", "study.toml", "-o", "out", *engine)
    assert done.returncode == 0, done.stderr


def test_third_party_concealer_is_registered_and_constrained(tmp_path, monkeypatch, known):
    monkeypatch.syspath_prepend(install_page("your-own-concealer.md", tmp_path))
    assert "swell" in concealer_names()
    assert vars(create_concealer("swell", max_factor=1.5))["max_factor"] == 1.5
    anchors = random_context(50, 3)
    assert float(conceal(anchors, "swell").hints.size_gain.max()) == pytest.approx(
        float(anchors.fully_received.astype(np.float64).mean()) ** -0.5
    )
    splats = gaussians(Numbers(0).rand(9, 3), np.full((9,), 0.5, np.float32), np.arange(9) > 2)
    assert len(conceal(splats, "swell").drawn().means) == 6
    assert registry.concealer_package("swell") == ("splatwire-swell 1.0",)
    assert registry.concealer_package("cari") == ()
    with pytest.raises(InvalidValueError, match="largest factor must be at least 1"):
        create_concealer("swell", max_factor=0.5)


@pytest.mark.parametrize(
    ("module", "sentence"),
    [
        ("import nowhere_to_be_found", "concealer 'broken' of acme cannot be loaded: No module named 'nowhere_to_be_f"),
        ("raise OSError('no disk')", "concealer 'broken' of acme cannot be loaded: no disk"),
        ("class Thing: pass", "acme announces concealer 'broken' and does not register it"),
    ],
)
def test_broken_package_is_one_error_sentence_on_use(tmp_path, monkeypatch, known, caplog, module, sentence):
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


def test_duplicate_name_is_refused(known):
    with pytest.raises(InvalidValueError, match=r"two concealers are called 'grow': splatwire\.concealment\.grow"):
        register_concealer("grow")(type("Other", (), {}))


@pytest.mark.needs_torch
def test_the_entry_points_of_the_paper_are_installed():
    """An installation that predates the entry points must be repeated (`pip install -e .`)."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for name in project["entry-points"][registry.GROUP]:
        assert registry.CONCEALERS[name].static.make.__module__.startswith("splatwire.paper.")
