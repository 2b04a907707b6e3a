"""What a file is, by its first bytes; and that whatever the bytes are, an answer comes."""

import contextlib
import gzip
import json
import os
import pickle
import random
import struct

import numpy as np
import pytest
import torch
from PIL import Image

from scenes import tiny_cameras, tiny_scene
from splatwire.codec import decode_stream, encode_scene
from splatwire.data import load_cameras, open_dataset, save_cameras
from splatwire.errors import SplatwireError
from splatwire.files import kinds
from splatwire.files.kinds import file_kind, kind_of_bytes
from splatwire.formats import read_splats, write_splats
from splatwire.formats.kinds import KINDS as SPLATS
from splatwire.importers.hacpp import import_hacpp
from splatwire.model.scene_file import load_scene, save_partial, save_scene
from splatwire.packets import Packetization, read_stream, write_stream
from splatwire.scene.splats import Splats
from splatwire.train.checkpoint import load_checkpoint


@pytest.fixture(scope="module")
def zoo(tmp_path_factory):
    """A file of many kinds."""
    folder = tmp_path_factory.mktemp("zoo")
    scene = tiny_scene(num_anchors=40)
    save_scene(scene, folder / "scene")
    stream = encode_scene(scene, Packetization(block_size=40, lanes=2))
    write_stream(stream, folder / "stream.swz")
    write_stream(stream, folder / "stream folder")
    save_partial(decode_stream(stream.with_packets(stream.packets[:1])), folder / "partial scene")
    save_cameras(tiny_cameras(2), folder / "cameras")
    one = np.ones((5, 3), np.float32)
    quats = np.array([[1.0, 0, 0, 0]], np.float32).repeat(5, axis=0)
    splats = Splats(one, quats, one, 0.5 * np.ones(5, np.float32), np.zeros((5, 1, 3), np.float32))
    write_splats([splats], folder / "ply.ply")
    for name in ("compressed ply.compressed.ply", "splat.splat", "spz.spz", "sog.sog"):
        write_splats([splats], folder / name)
    (folder / "ksplat.ksplat").write_bytes(b"\0\1" + bytes(6000))
    (folder / "glb").write_bytes(b"glTF\2\0\0\0\x0c\0\0\0")
    (folder / "sog folder").mkdir()
    (folder / "sog folder" / "meta.json").write_text("{}")
    (folder / "spz").write_bytes(gzip.compress(b"NGSP" + bytes(20)))
    (folder / "gzip").write_bytes(gzip.compress(b"hello"))
    Image.new("RGB", (4, 4)).save(folder / "picture", "PNG")
    Image.new("RGB", (4, 4)).save(folder / "picture.jpg")
    Image.new("RGB", (4, 4)).save(folder / "picture.webp")
    np.savez(folder / "zip.npz", a=np.zeros(3))
    (folder / "html").write_text("<!DOCTYPE html>\n<html>404</html>")
    (folder / "lfs").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    (folder / "text").write_text("Grüße " * 10000)
    (folder / "json").write_text("[1, 2]")
    (folder / "transforms").write_text('{"camera_angle_x": 1, "frames": []}')
    (folder / "other ply").write_bytes(b"ply\nformat ascii 1.0\nelement face 0\nend_header\n")
    (folder / "empty").touch()
    (folder / "unknown").write_bytes(bytes(range(256)) * 3)
    (folder / "empty folder").mkdir()
    (folder / "hacpp" / "point_cloud").mkdir(parents=True)
    for number in (700, 7000, 30000):
        (folder / "3dgs" / "point_cloud" / f"iteration_{number}").mkdir(parents=True)
        write_splats([splats], folder / "3dgs" / "point_cloud" / f"iteration_{number}" / "point_cloud.ply")
    (folder / "3dgs" / "point_cloud" / "iteration_9000000").mkdir()
    torch.save({"step": 3, "splats": {"means": torch.ones(3), "sh0": torch.ones(3)}}, folder / "gsplat checkpoint.pt")
    torch.save(
        {"step": 3, "pipeline": {"_model.gauss_params.means": torch.ones(3)}}, folder / "nerfstudio checkpoint.ckpt"
    )
    torch.save(((torch.ones(1), torch.ones(1)), 30000), folder / "pytorch")
    torch.save([torch.ones(1)], folder / "pytorch.pth", _use_new_zipfile_serialization=False)
    (folder / "pickle").write_bytes(pickle.dumps({"means": [1, 2]}))
    (folder / "dataset" / "sparse").mkdir(parents=True)
    (folder / "folder" / "photos").mkdir(parents=True)
    os.mkfifo(folder / "device")
    return folder


def test_every_kind_is_told(zoo):
    for path in zoo.iterdir():
        assert file_kind(path).key == path.name.partition(".")[0], path
    assert file_kind(zoo / "nobody") == file_kind(zoo / "json" / "x") == kinds.NOTHING
    assert file_kind(zoo / "a\0b") == kinds.UNREADABLE


def test_a_splat_file_is_told_by_its_name_whatever_its_first_bytes_seem_to_be(tmp_path):
    for start in (b"\x1f\x8b", b"BM", b"{", b"<html", b"abc"):
        (tmp_path / "a.splat").write_bytes(start.ljust(64, b"\0"))
        assert file_kind(tmp_path / "a.splat") == kinds.SPLAT
        assert file_kind(tmp_path / "a.splat").use


READERS = {
    "load_scene": load_scene,
    "read_stream": read_stream,
    "read_splats": read_splats,
    "load_cameras": load_cameras,
    "open_dataset": open_dataset,
    "import_hacpp": import_hacpp,
    "load_checkpoint": load_checkpoint,
}


WELCOME = {
    "load_scene": ["scene"],
    "read_stream": ["stream", "stream folder"],
    "read_splats": [kind.key for group in SPLATS.values() for kind in group],
    "load_cameras": ["cameras"],
}
PARTICULAR = {
    ("load_scene", "partial scene"): ["conceal it first"],
}
"""Where more is known than the kind."""


@pytest.mark.parametrize("reader", READERS)
def test_every_reader_says_what_it_was_given(zoo, reader):
    """Also of a pipe, which would block, and of a name that is no name."""
    for path in (*zoo.iterdir(), zoo / "nobody", zoo / "a\0b"):
        kind = file_kind(path)
        if kind.key in WELCOME.get(reader, ()):
            with contextlib.suppress(SplatwireError):  # its own reader says what is damaged
                READERS[reader](path)
            continue
        with pytest.raises(SplatwireError) as caught:
            READERS[reader](path)
        assert path.name.split("\0")[0] in str(caught.value)
        words = (kind.what, *PARTICULAR.get((reader, kind.key), ()), *(["cannot be read"] * ("\0" in path.name)))
        assert any(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize("seed", range(4))
def test_any_bytes_have_a_kind(seed):
    """Heads of every kind, cut and with bytes changed, and bytes that are nothing at all."""
    rng = random.Random(seed)
    heads = [magic for magic, _ in kinds._MAGICS] + [
        b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float scale_0\nend_header\n",
        struct.pack("<Q", 40) + b'{"__metadata__":{"splatwire":"{}"}}     ',
        b'{"frames": [', b"[" * 5000, b"<html>", b"\x1f\x8b\x08" + bytes(30), b"RIFF\0\0\0\0WEBP",
    ]  # fmt: skip
    for _ in range(500):
        data = bytearray(rng.choice(heads) + rng.randbytes(rng.randrange(40)))
        for _ in range(rng.randrange(4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        data = bytes(data[: rng.randrange(len(data) + 1)])
        assert str(kind_of_bytes(data, rng.choice([len(data), 32, 1 << 40]), rng.choice(["", ".splat", ".ply"])))


@pytest.mark.parametrize("metadata", ["[]", "nonsense", '{"format": [], "kind": {}}', "[" * 3000, '"\\ud800"'])
def test_hostile_headers_are_only_safetensors(metadata):
    header = json.dumps({"__metadata__": {"splatwire": metadata}}).encode()
    assert kind_of_bytes(struct.pack("<Q", len(header)) + header, 10_000) == kinds.TENSORS
    for text in (b"{" * 4000, b'{"__metadata__": 3}', b'{"__metadata__": {"splatwire": 3}}'):
        assert kind_of_bytes(struct.pack("<Q", len(text)) + text, 10_000) == kinds.TENSORS


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("gsplat checkpoint.pt", ["gsplat", "never opened", "export_splats", "PLY"]),
        ("nerfstudio checkpoint.ckpt", ["nerfstudio", "never opened", "ns-export gaussian-splat"]),
        ("pytorch", ["PyTorch", "never opened", "point_cloud.ply"]),
        ("pickle", ["pickle", "never opened"]),
    ],
)
def test_checkpoints_of_other_programs_are_named_with_the_way_to_a_ply(zoo, name, told):
    with pytest.raises(SplatwireError) as caught:
        read_splats(zoo / name)
    assert all(word in str(caught.value) for word in told), str(caught.value)


def test_a_model_folder_of_3dgs_is_read_as_the_ply_of_its_last_iteration(zoo):
    assert kinds.trained_ply(zoo / "3dgs") == zoo / "3dgs" / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    assert read_splats(zoo / "3dgs").num_gaussians == 5
