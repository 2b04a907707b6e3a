"""Every option of every verb has an effect: an invalid value is refused by name."""

import asyncio
import contextlib
import dataclasses
import json
import re
import shutil
import types
import typing
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from close import unit
from random_numbers import Numbers
from splatwire.cli._parsing import settings_of
from splatwire.cli._verbs import VERBS
from splatwire.cli.calibrate import Calibrate
from splatwire.io.formats import write_splats
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow

MISSING = "lens.json/missing"
"""An impossible name: it can be neither read nor written, and no name equals it."""
WRONG = {str: (MISSING,), Path: (MISSING,), int: ("-7",), float: ("nan", "-7")}
"""Invalid values by type."""
OF_OPTION = {
    "background": ("nan 0 0", "0 0 2"),
    "tiers": ("nan", "-7", "0.6 0.7"),
    "kind": (MISSING,),
}
"""Invalid values by option name, where the type has none."""
IN_EFFECT = {
    ("train", "loss_share"): ("--loss", "bernoulli:0.2"),
    ("plan", "rate"): ("--deadline", "2"),
    ("plan", "deadline"): ("--rate", "2"),
    ("serve", "certificate"): ("--quic", "--key", "cameras.json"),
    ("serve", "key"): ("--quic", "--certificate", "cameras.json"),
    ("serve", "origins"): ("--quic",),
    ("serve", "public_url"): ("--page", "0"),
    ("serve", "proxy"): ("--page", "0"),
    ("live", "public_url"): ("--page", "0"),
    ("live", "proxy"): ("--page", "0"),
}
"""Options that depend on another option, with that option."""
EXCEPTIONS = {
    ("train", "seed"): "torch takes every integer",
    ("token", "scenes"): "a scene may have any name",
}
"""Verbs and options that accept any value, with the reason."""

NEED_TORCH = {"train", "calibrate gnn", "encode --refine"}
"""Verbs, and options of other verbs, that name torch first where it is not installed."""
LATE = {("view", "host"): "an address is known to be wrong when it is listened on, after the scene was decoded"}
"""Verbs and options with errors only after some work, with the reason."""
REQUIRED = {
    "demo": ({},),
    "train": ({"data": "photos", "output": "out.scene"},),
    "import": ({"kind": "splats", "model_dir": "cloud.ply", "output": "out.ply"},),
    "export": tuple({"kind": "ply", "scene": name, "output": "out.ply"} for name in ("tiny.swz", "cloud.ply")),
    "encode": tuple({"scene": name, "output": "out.swz"} for name in ("tiny.scene", "cloud.ply")),
    "apply": ({"stream": "cloud.swz", "update": "change.swz", "output": "out.swz"},),
    "convert": ({"sources": "cloud.ply", "output": "out.swz"},),
    "inspect": ({"source": "tiny.swz"},),
    "verify": ({"streams": "tiny.swz"},),
    "transmit": ({"stream": "tiny.swz", "output": "out.swz"},),
    "plan": ({"streams": "cloud.swz"},),
    "serve": ({"streams": "cloud.swz"},),
    "token": ({"scenes": "room", "key": "study.toml"},),
    "live": ({"frames": "."},),
    "receive": ({"url": "udp://127.0.0.1:9", "output": "out.swz"},),
    "pack": ({"sources": "cloud.swz", "output": "out.html"},),
    "publish": ({"scenes": "cloud.swz", "output": "site"},),
    "thumb": tuple({"scene": name, "output": "out.jpg"} for name in ("cloud.ply", "cloud.swz")),
    "view": ({"stream": "cloud.swz"},),
    "decode": ({"stream": "tiny.swz", "output": "out.scene"}, {"stream": "cloud.swz", "output": "out.ply"}),
    "render": tuple({"scene": name, "output": "pictures"} for name in ("tiny.scene", "cloud.ply")),
    "evaluate": tuple(
        {"source": name, "reference": name, "loss": "none"} for name in ("tiny.swz", "cloud.swz", "cloud.ply")
    ),
    "compare": ({"files": "cloud.ply", "reference": "cloud.swz"}, {"files": "tiny.swz", "reference": "tiny.scene"}),
    "study": (
        {"protocol": "study.toml", "output": "out"},
        {"protocol": "study.toml", "output": "out", "scene": "bundled"},
    ),
    "calibrate gnn": ({"source": "tiny.swz", "output": "out.swz"},),
    "calibrate sketch": tuple({"source": name, "output": "out.swz"} for name in ("tiny.swz", "cloud.swz")),
    "calibrate preview": tuple({"source": name, "output": "out.swz"} for name in ("tiny.swz", "cloud.swz")),
}
"""Required arguments of each verb: first for anchors, then for Gaussians."""


@dataclasses.dataclass(frozen=True)
class Option:
    verb: str
    name: str
    positional: bool
    types: tuple[type, ...]

    def __str__(self):
        return f"{self.verb}-{self.name}"

    def wrong(self):
        """Invalid values for the types of an option."""
        return OF_OPTION.get(self.name) or tuple(value for t in self.types for value in WRONG.get(t, ()))


def _options(verb, settings):
    hints = typing.get_type_hints(settings, include_extras=True)
    for field in dataclasses.fields(settings):
        kind = hints[field.name]
        positional = "Positional" in str(kind)
        if dataclasses.is_dataclass(kind):
            yield from _options(verb, kind)
        else:
            yield Option(verb, field.name, positional, tuple(_plain(kind)))


def _plain(kind):
    """Possible types of one word of an option."""
    if isinstance(kind, type):
        return {kind} - {types.NoneType}
    if typing.get_origin(kind) is typing.Literal:
        return {str}
    parts = typing.get_args(kind)[:1] if typing.get_origin(kind) is typing.Annotated else typing.get_args(kind)
    return set().union(*(_plain(part) for part in parts if part is not Ellipsis))


def _every_option():
    for verb in VERBS:
        if verb == "calibrate":
            for part in typing.get_args(typing.get_type_hints(Calibrate, include_extras=True)["addition"]):
                settings, subcommand = typing.get_args(part)
                yield from _options(f"calibrate {subcommand.name}", settings)
        else:
            yield from _options(verb, settings_of(verb))


OPTIONS = list(_every_option())


@pytest.fixture(scope="module")
def files(journey, tmp_path_factory):
    """Folder with all input files of the verbs."""
    folder = tmp_path_factory.mktemp("options")
    for name in ("tiny.scene", "tiny.swz", "cameras.json"):
        shutil.copy(journey / name, folder / name)
    shutil.copy(journey / "cameras.json", folder / "lens.json")
    rng = Numbers(5)
    quats = unit(rng.randn(60, 4))
    means, scales = rng.rand(60, 3), rng.rand(60, 3) * 0.05 + 0.01
    write_splats(
        [Splats(means, quats, scales, np.full((60,), 0.7, np.float32), Numbers(0).rand(60, 1, 3))],
        folder / "cloud.ply",
    )
    write_photos(folder / "photos")
    (folder / "study.toml").write_text(STUDY)
    return folder


STUDY = """
[protocol]
seeds = [1]
metrics = ["psnr"]
[[scene]]
name = "tiny"
stream = "tiny.swz"
cameras = "cameras.json"
[[loss]]
model = "none"
[[row]]
key = "drop"
label = "none"
"""


def write_photos(folder):
    """Three grey photos in the nerfstudio layout."""
    folder.mkdir()
    frames = []
    for view in range(3):
        Image.new("RGB", (24, 16), (100 + view, 120, 140)).save(folder / f"{view}.png")
        pose = [[1, 0, 0, 0.1 * view], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]
        frames.append({"file_path": f"{view}.png", "transform_matrix": pose})
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 20.0, "w": 24, "h": 16, "frames": frames}))


@pytest.fixture
def here(files, monkeypatch, run):
    """Changes to the folder of input files, and shortens waits for clients and servers."""
    monkeypatch.chdir(files)
    if not (files / "cloud.swz").exists():
        assert run("encode", "cloud.ply", "-o", "cloud.swz", "--preset", "datagram").status == 0
        assert run("encode", "cloud.ply", "--update", "cloud.swz", "-o", "change.swz").status == 0
    plain = asyncio.run

    def briefly(work):
        async def ended():
            with contextlib.suppress(TimeoutError):
                return await asyncio.wait_for(work, 60)
            raise AssertionError("nothing was refused: it ran")

        return plain(ended())

    monkeypatch.setattr(asyncio, "run", briefly)
    return files


def _words(option, required, value):
    """Command line with one invalid option value."""
    given = {**required, option.name: value}
    positionals = {o.name for o in OPTIONS if o.verb == option.verb and o.positional}
    names = [o.name for o in OPTIONS if o.verb == option.verb and o.name in given]
    words = option.verb.split() + [given[name] for name in names if name in positionals]
    for name in names:
        if name not in positionals:
            words += [f"--{name.replace('_', '-')}", *given[name].split()]
    return words + list(IN_EFFECT.get((option.verb, option.name), ()))


@pytest.mark.parametrize("option", [o for o in OPTIONS if o.types != (bool,)], ids=str)
def test_invalid_option_value_is_refused(run, here, option):
    """Flags have no invalid value."""
    if (option.verb, option.name) in EXCEPTIONS:
        pytest.skip(EXCEPTIONS[option.verb, option.name])
    if option.verb in NEED_TORCH or f"{option.verb} --{option.name}" in NEED_TORCH:
        pytest.importorskip("torch")
    before = _listing(here)
    assert option.wrong()
    for required in REQUIRED[option.verb]:
        for value in option.wrong():
            words = _words(option, required, value)
            done = run(*words)
            assert (done.status, done.out) == (2, ""), words
            message = " ".join(done.err.split())
            spellings = (option.name.replace("_", "-"), option.name.replace("_", " "))
            named = (*spellings, value.split()[0], *value.split("/"))
            assert any(name in message for name in named), (words, message)
            assert (option.verb, option.name) in LATE or not re.search(r" s\] (?!loading)", message), (
                f"reported after some work: {message}"
            )
    assert _listing(here) == before


def _listing(folder):
    return sorted(path for path in folder.rglob("*"))


def test_every_listed_exception_exists_and_has_a_reason():
    known = {(option.verb, option.name) for option in OPTIONS}
    assert set(EXCEPTIONS) | set(LATE) <= known
    assert all((*EXCEPTIONS.values(), *LATE.values()))
