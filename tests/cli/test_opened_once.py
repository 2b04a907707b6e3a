"""Each command opens its scene file once; detection, reading and digests share the open file."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import splatwire
from scenes import tiny_cameras
from splat_io.formats.handmade import glb, ksplat, some_splats
from splatwire.data import save_cameras
from splatwire.files.kinds import SPLATS_PLY, file_kind, opened
from splatwire.files.opened import OpenedFile
from splatwire.types import SplatScene

_OPENED: list[str] | None = None
"""Paths opened by this process while a test counts them; None while no test does."""


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if event == "open" and _OPENED is not None and isinstance(arguments[0], str | bytes | os.PathLike):
        _OPENED.append(os.fsdecode(arguments[0]))


@pytest.fixture(scope="module", autouse=True)
def _hook() -> None:
    sys.addaudithook(_note)  # cannot be removed, so the list decides what is noted


@contextmanager
def _opens() -> Iterator[list[str]]:
    global _OPENED
    _OPENED = found = []
    try:
        yield found
    finally:
        _OPENED = None


def _count(found: list[str], path: Path) -> int:
    return sum(os.path.realpath(name) == os.path.realpath(path) for name in found)


NAMES = ("a.ply", "a.compressed.ply", "a.spz", "a.sog", "a.splat", "a.ksplat", "a.glb", "a.swz")


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small scene in each file format."""
    folder = tmp_path_factory.mktemp("zoo")
    scene = SplatScene(some_splats(30, 1))
    for name in ("a.ply", "a.compressed.ply", "a.spz", "a.sog", "a.splat"):
        splatwire.save_scene(scene, folder / name)
    (folder / "a.ksplat").write_bytes(ksplat())
    (folder / "a.glb").write_bytes(glb(some_splats(8, 1)))
    splatwire.write_stream(splatwire.encode_scene(scene), folder / "a.swz")
    save_cameras(tiny_cameras(2, 32, 24), folder / "cameras.json")
    return folder


def _words(verb: str, path: Path, output: Path) -> list[object]:
    return {
        "encode": ["encode", path, "-o", output / "b.swz"],
        "inspect": ["inspect", path],
        "export": ["export", "ply", path, "-o", output / "b.ply"],
        "render": ["render", path, "-o", output / "pictures", "--cameras", path.parent / "cameras.json"],
        "transmit": ["transmit", path, "--loss", "bernoulli:0.5", "-o", output / "b.swz"],
        "decode": ["decode", path, "-o", output / "b.ply"],
        "verify": ["verify", path],
        "pack": ["pack", path, "-o", output / "pages"],
        "evaluate": ["evaluate", path, "--reference", path.parent / "reference.ply", "--cameras",
                     path.parent / "cameras.json", "--conceal", "drop", "--loss", "bernoulli:0.5"],
    }[verb]  # fmt: skip


@pytest.mark.parametrize("name", NAMES[:-1])
@pytest.mark.parametrize("verb", ["encode", "inspect", "export", "render"])
def test_commands_open_a_file_of_gaussians_once(run, zoo, tmp_path, verb, name):
    with _opens() as found:
        done = run(*_words(verb, zoo / name, tmp_path))
    assert done.status == 0, done.err
    assert _count(found, zoo / name) == 1


@pytest.mark.parametrize("verb", ["inspect", "export", "render", "transmit", "decode", "verify", "pack"])
def test_commands_open_a_stream_once(run, zoo, tmp_path, verb):
    with _opens() as found:
        done = run(*_words(verb, zoo / "a.swz", tmp_path))
    assert done.status == 0, done.err
    assert _count(found, zoo / "a.swz") == 1


@pytest.mark.parametrize("verb", ["encode", "inspect", "render"])
def test_commands_open_a_scene_file_of_anchors_once(run, zoo, journey, tmp_path, verb):
    path = tmp_path / "tiny.scene"
    path.write_bytes((journey / "tiny.scene").read_bytes())
    (tmp_path / "cameras.json").write_bytes((zoo / "cameras.json").read_bytes())
    with _opens() as found:
        done = run(*_words(verb, path, tmp_path))
    assert done.status == 0, done.err
    assert _count(found, path) == 1


@pytest.mark.parametrize("name", ["a.swz", "a.spz"])
def test_evaluate_opens_source_and_reference_once(run, zoo, tmp_path, name):
    (zoo / "reference.ply").write_bytes((zoo / "a.ply").read_bytes())
    with _opens() as found:
        done = run(*_words("evaluate", zoo / name, tmp_path), "-o", tmp_path / "report")
    assert done.status == 0, done.err
    assert _count(found, zoo / name) == 1
    assert _count(found, zoo / "reference.ply") == 1


def test_an_open_file_keeps_its_content_and_kind_when_the_path_is_replaced(zoo, tmp_path):
    path = tmp_path / "a.ply"
    path.write_bytes((zoo / "a.ply").read_bytes())
    with opened(path) as source:
        os.replace(_copy(zoo / "a.spz", tmp_path / "new"), path)
        assert file_kind(source) is SPLATS_PLY
        assert splatwire.open_scene(source).num_elements == 30
        assert splatwire.open_scene(source).num_elements == 30, "each reader starts at the first byte"
    assert file_kind(source).key == "spz", "after closing it is an ordinary path"


def _copy(source: Path, target: Path) -> Path:
    target.write_bytes(source.read_bytes())
    return target


def test_paths_derived_from_an_open_file_are_not_open(zoo):
    with opened(zoo / "a.ply") as source:
        assert isinstance(source, OpenedFile)
        assert source == zoo / "a.ply"
        assert file_kind(source.parent / "a.spz").key == "spz"
        assert file_kind(source.with_name("missing")).key == "nothing"
        with opened(source) as same:
            assert same is source
