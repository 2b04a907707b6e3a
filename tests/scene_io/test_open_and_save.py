"""One door for scenes: whatever kind a file is, `open_scene` reads it, and what it reads is what was saved."""

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

import splatwire
from formats.handmade import glb, ksplat, some_splats
from scenes import tiny_scene
from splatwire.errors import BitstreamError, InvalidValueError, SplatwireError, UnknownNameError
from splatwire.files.kinds import file_kind
from splatwire.formats import read_splats
from splatwire.model import AnchorScene, Partial, SplatScene
from splatwire.model.scene_digest import scene_digest
from splatwire.model.scene_file import load_scene_file
from splatwire.packets import Packetization, write_stream
from splatwire.scene_io import background_of_file, read_scene_file

ANCHORS = ("scene", "stream", "stream folder", "decoded", "causal stream")
GAUSSIANS = (
    "ply.ply", "compressed.compressed.ply", "spz.spz", "sog.sog", "sog folder", "sog folder/meta.json", "splat.splat",
    "ksplat.ksplat", "glb.glb", "splats.swz", "splats folder",
)  # fmt: skip


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene in each kind of file that can hold one, under `lossy ...` with gaps."""
    folder = tmp_path_factory.mktemp("scenes")
    scene = tiny_scene(num_anchors=60)
    splatwire.save_scene(scene, folder / "scene")
    stream = splatwire.encode_scene(scene, Packetization(block_size=30, lanes=2))
    lossy = stream.with_packets(stream.packets[1:])
    shutil.copyfile(Path(__file__).parents[1] / "golden" / "tiny_causal.swz", folder / "causal stream")
    write_stream(stream, folder / "x.swz")
    (folder / "x.swz").rename(folder / "stream")
    write_stream(stream, folder / "stream folder")
    write_stream(lossy, folder / "lossy stream")
    splatwire.save_scene(splatwire.decode_stream(stream), folder / "decoded")
    splatwire.save_scene(splatwire.decode_stream(lossy), folder / "lossy decoded")
    splats = SplatScene(some_splats(30, 1))
    for name in (*GAUSSIANS[:4], "splat.splat"):
        splatwire.save_scene(splats, folder / name)
    with zipfile.ZipFile(folder / "sog.sog") as bundle:
        bundle.extractall(folder / "sog folder")
    (folder / "ksplat.ksplat").write_bytes(ksplat())
    (folder / "glb.glb").write_bytes(glb(some_splats(8, 1)))
    stream = splatwire.encode_scene(splats, Packetization(block_size=15, lanes=2))
    write_stream(stream, folder / "splats.swz")
    write_stream(stream, folder / "splats folder")
    write_stream(stream.with_packets(stream.packets[1:]), folder / "lossy splats")
    return folder


@pytest.mark.parametrize("name", ANCHORS)
def test_scenes_of_anchors_are_opened(zoo: Path, name: str) -> None:
    scene = splatwire.open_scene(str(zoo / name))
    assert isinstance(scene, AnchorScene)
    assert scene.background == background_of_file(zoo / name)
    assert scene_digest(splatwire.open_scene(zoo / name, conceal="drop").elements) == scene_digest(scene.elements)


@pytest.mark.parametrize("name", GAUSSIANS)
def test_explicit_gaussians_of_any_format_are_opened(zoo: Path, name: str) -> None:
    scene = splatwire.open_scene(zoo / name)
    assert isinstance(scene, SplatScene)
    assert background_of_file(zoo / name) == (0, 0, 0)
    assert splatwire.encode_scene(scene).manifest.num_elements == scene.num_elements
    found = read_scene_file(zoo / name)
    assert found.kind == file_kind(zoo / name)
    assert found.num_lost == 0
    if "swz" not in name and "folder" not in name:
        assert scene_digest(scene.elements) == scene_digest(read_splats(zoo / name))


def test_a_folder_of_sog_is_its_file(zoo: Path) -> None:
    bundled = splatwire.open_scene(zoo / "sog.sog")
    for name in ("sog folder", "sog folder/meta.json"):
        assert scene_digest(splatwire.open_scene(zoo / name).elements) == scene_digest(bundled.elements)


@pytest.mark.parametrize("name", ["lossy stream", "lossy decoded", "lossy splats"])
def test_gaps_want_a_concealer(zoo: Path, name: str) -> None:
    with pytest.raises(BitstreamError, match=r"lossy .*: \d+ of the .* were lost; conceal it first.*open_scene"):
        splatwire.open_scene(zoo / name)
    scene = splatwire.open_scene(zoo / name, conceal="grow")
    assert isinstance(scene, AnchorScene | SplatScene)
    found = read_scene_file(zoo / name)
    assert isinstance(found.loaded, Partial)
    assert 0 < found.num_lost < scene.num_elements
    with pytest.raises(UnknownNameError, match="concealer 'nobody'"):
        splatwire.open_scene(zoo / name, conceal="nobody")


def test_what_was_concealed_is_a_scene_that_knows_its_losses(zoo: Path, tmp_path: Path) -> None:
    found = read_scene_file(zoo / "lossy decoded")
    scene = splatwire.open_scene(zoo / "lossy decoded", "grow")
    splatwire.save_scene(scene, tmp_path / "seen", erasures=found.erasures)
    assert read_scene_file(tmp_path / "seen").num_lost == found.num_lost
    assert scene_digest(splatwire.open_scene(tmp_path / "seen").elements) == scene_digest(scene.elements)


def test_lost_gaussians_are_not_in_the_file(zoo: Path, tmp_path: Path) -> None:
    found = read_scene_file(zoo / "lossy splats")
    splatwire.save_scene(found.loaded, tmp_path / "seen.ply")
    assert splatwire.open_scene(tmp_path / "seen.ply").num_elements == 30 - found.num_lost


def test_anchors_keep_every_bit(tmp_path: Path) -> None:
    scene = tiny_scene(num_anchors=40)
    splatwire.save_scene(scene, tmp_path / "a")
    back = splatwire.open_scene(tmp_path / "a")
    assert isinstance(back, AnchorScene)
    for name, value in vars(scene.anchors).items():
        assert np.array_equal(getattr(back.anchors, name), value)


@pytest.mark.parametrize("name", ["a.ply", "a.SPZ", "a.sog", "a.compressed.ply", "a.glb", "a.swz"])
def test_a_name_that_says_something_else_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match=r"a\..*the name says another kind of file"):
        splatwire.save_scene(tiny_scene(num_anchors=5), tmp_path / name)
    with pytest.raises(UnknownNameError, match=r"format of explicit Gaussians 'a\.scene'"):
        splatwire.save_scene(SplatScene(some_splats(4)), tmp_path / "a.scene")
    assert not list(tmp_path.iterdir())


def test_what_is_no_scene_is_told_with_what_reads_it(tmp_path: Path) -> None:
    (tmp_path / "photos" / "sparse").mkdir(parents=True)
    (tmp_path / "empty").mkdir()
    (tmp_path / "text").write_text("hello")
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "pak_lane0_s0.pak").touch()
    for name, told in (
        ("photos", "a folder of posed photos"),
        ("empty", "an empty folder"),
        ("text", "a text file"),
        ("nobody", "no such file"),
        ("bare", "manifest.json is missing"),
    ):
        for read in (splatwire.open_scene, lambda path: splatwire.open_scene(path, "drop"), read_scene_file):
            with pytest.raises(SplatwireError, match=told) as caught:
                read(tmp_path / name)
            assert name in str(caught.value)


def test_readers_of_one_kind_name_the_function_that_reads_all(zoo: Path) -> None:
    """From Python, not only verbs of the command line."""
    with pytest.raises(BitstreamError, match=r"spz\.spz.*an SPZ file.*`open_scene` reads it in Python"):
        splatwire.read_stream(zoo / "spz.spz")
    with pytest.raises(BitstreamError, match=r"spz\.spz.*an SPZ file.*`open_scene` reads it in Python"):
        load_scene_file(zoo / "spz.spz")
