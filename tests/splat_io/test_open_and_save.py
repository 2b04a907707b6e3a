"""`open_scene` reads every kind of scene file and returns the saved scene."""

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

import splatwire
from scenes import tiny_scene
from splat_io.formats.handmade import glb, ksplat, some_splats
from splatwire.anchors.scene_file import load_scene_file
from splatwire.bitstream import Packetization, write_stream
from splatwire.errors import BitstreamError, InvalidValueError, SplatwireError, UnknownNameError
from splatwire.files.kinds import file_kind
from splatwire.io import read_any_scene
from splatwire.io.formats import read_splats
from splatwire.types import AnchorScene, ReceivedScene, SplatScene
from splatwire.types.scene import Scene
from splatwire.types.scene_digest import scene_digest

ANCHORS = ("scene", "stream", "stream folder", "decoded", "causal stream")
GAUSSIANS = (
    "ply.ply", "compressed.compressed.ply", "spz.spz", "sog.sog", "sog folder", "sog folder/meta.json", "splat.splat",
    "ksplat.ksplat", "glb.glb", "splats.swz", "splats folder",
)  # fmt: skip


@pytest.fixture(scope="module")
def zoo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene in every kind of file, with losses under `lossy ...`."""
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
    assert scene_digest(splatwire.open_scene(zoo / name, conceal="drop").elements) == scene_digest(scene.elements)


@pytest.mark.parametrize("name", GAUSSIANS)
def test_explicit_gaussians_of_any_format_are_opened(zoo: Path, name: str) -> None:
    scene = splatwire.open_scene(zoo / name)
    assert isinstance(scene, SplatScene)
    assert scene.background == (0, 0, 0)
    assert splatwire.encode_scene(scene).manifest.num_elements == scene.num_elements
    found = read_any_scene(zoo / name)
    assert found.kind == file_kind(zoo / name)
    assert found.num_lost == 0
    if "swz" not in name and "folder" not in name:
        assert scene_digest(scene.elements) == scene_digest(read_splats(zoo / name))


def test_sog_folder_equals_its_file(zoo: Path) -> None:
    bundled = splatwire.open_scene(zoo / "sog.sog")
    for name in ("sog folder", "sog folder/meta.json"):
        assert scene_digest(splatwire.open_scene(zoo / name).elements) == scene_digest(bundled.elements)


@pytest.mark.parametrize("name", ["lossy stream", "lossy decoded", "lossy splats"])
def test_lossy_scene_requires_a_concealer(zoo: Path, name: str) -> None:
    with pytest.raises(BitstreamError, match=r"lossy .*: \d+ of the .* were lost; conceal it first.*open_scene"):
        splatwire.open_scene(zoo / name)
    scene = splatwire.open_scene(zoo / name, conceal="grow")
    assert isinstance(scene, AnchorScene | SplatScene)
    found = read_any_scene(zoo / name)
    assert isinstance(found.loaded, ReceivedScene)
    assert 0 < found.num_lost < scene.num_elements
    with pytest.raises(UnknownNameError, match="concealer 'nobody'"):
        splatwire.open_scene(zoo / name, conceal="nobody")


def test_concealed_scene_keeps_its_loss_mask(zoo: Path, tmp_path: Path) -> None:
    found = read_any_scene(zoo / "lossy decoded")
    scene = splatwire.open_scene(zoo / "lossy decoded", "grow")
    splatwire.save_scene(scene, tmp_path / "seen", loss_mask=found.loss_mask)
    assert read_any_scene(tmp_path / "seen").num_lost == found.num_lost
    assert scene_digest(splatwire.open_scene(tmp_path / "seen").elements) == scene_digest(scene.elements)


def test_saved_file_omits_lost_gaussians_with_a_warning(
    zoo: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    found = read_any_scene(zoo / "lossy splats")
    splatwire.save_scene(found.loaded, tmp_path / "seen.ply")
    assert splatwire.open_scene(tmp_path / "seen.ply").num_elements == 30 - found.num_lost
    assert f"seen.ply: {found.num_lost} lost Gaussians are left out, and such files cannot record losses" in caplog.text


@pytest.mark.parametrize("name", ["seen.ply", "seen.spz"])
def test_loss_mask_that_a_format_cannot_store_gives_a_warning(
    name: str, zoo: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    found = read_any_scene(zoo / "lossy splats")
    scene = splatwire.open_scene(zoo / "lossy splats", "scene_free")
    splatwire.save_scene(scene, tmp_path / name, loss_mask=found.loss_mask)
    assert f"{name}: such files cannot record losses: the {found.num_lost} Gaussians that were lost" in caplog.text


def test_anchors_round_trip_bit_identically(tmp_path: Path) -> None:
    scene = tiny_scene(num_anchors=40)
    splatwire.save_scene(scene, tmp_path / "a")
    back = splatwire.open_scene(tmp_path / "a")
    assert isinstance(back, AnchorScene)
    for name, value in vars(scene.anchors).items():
        assert np.array_equal(getattr(back.anchors, name), value)


@pytest.mark.parametrize("name", ["a.ply", "a.SPZ", "a.sog", "a.compressed.ply", "a.glb"])
def test_suffix_of_another_format_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match=r"a\..*the name says another kind of file"):
        splatwire.save_scene(tiny_scene(num_anchors=5), tmp_path / name)
    with pytest.raises(UnknownNameError, match=r"format of explicit Gaussians 'a\.scene'"):
        splatwire.save_scene(SplatScene(some_splats(4)), tmp_path / "a.scene")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("scene", [tiny_scene(num_anchors=5), SplatScene(some_splats(4))], ids=["anchors", "Gaussians"])
def test_the_suffix_of_a_stream_names_its_writer(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match=r"a\.swz: .*`write_stream\(encode_scene\(scene\), path\)` writes"):
        splatwire.save_scene(scene, tmp_path / "a.swz")
    assert not list(tmp_path.iterdir())


def test_non_scene_files_name_their_reader(tmp_path: Path) -> None:
    (tmp_path / "photos" / "sparse").mkdir(parents=True)
    (tmp_path / "empty").mkdir()
    (tmp_path / "text").write_text("hello")
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "pak_lane0_s0.pak").touch()
    for name, message in (
        ("photos", "a folder of posed photos"),
        ("empty", "an empty folder"),
        ("text", "a text file"),
        ("nobody", "no such file"),
        ("bare", "manifest.json is missing"),
    ):
        for read in (splatwire.open_scene, lambda path: splatwire.open_scene(path, "drop"), read_any_scene):
            with pytest.raises(SplatwireError, match=message) as caught:
                read(tmp_path / name)
            assert name in str(caught.value)


def test_specific_readers_name_the_general_function(zoo: Path) -> None:
    """The message names Python functions and verbs of the command line."""
    with pytest.raises(BitstreamError, match=r"spz\.spz.*an SPZ file: `encode` makes a stream of it.*`open_scene`"):
        splatwire.read_stream(zoo / "spz.spz")
    with pytest.raises(BitstreamError, match=r"spz\.spz.*an SPZ file: `encode` makes a stream of it.*`open_scene`"):
        load_scene_file(zoo / "spz.spz")
