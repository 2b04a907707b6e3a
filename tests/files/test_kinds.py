"""File kinds are detected from the first bytes, and any bytes give a kind."""

import contextlib
import gzip
import json
import os
import pickle
import random
import shutil
import struct

import numpy as np
import pytest
import torch
from PIL import Image

from scenes import tiny_cameras, tiny_scene
from splatwire.anchors.scene_file import load_scene, save_partial, save_scene
from splatwire.bitstream import Packetization, read_stream, write_stream
from splatwire.codec import decode_stream, encode_scene
from splatwire.data import load_cameras, open_dataset, save_cameras
from splatwire.errors import SplatwireError
from splatwire.files import kinds
from splatwire.files.kinds import file_kind, kind_of_bytes
from splatwire.files.scene_formats import FORMATS
from splatwire.io import open_scene
from splatwire.io.formats import read_splats, write_splats
from splatwire.neural.importers.hacpp import import_hacpp
from splatwire.neural.training.checkpoint import load_checkpoint
from splatwire.sequence import is_sequence
from splatwire.types.splats import Splats


@pytest.fixture(scope="module")
def zoo(tmp_path_factory):
    """One file of each of several formats."""
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
    (folder / "tileset.json").write_text('{"geometricError": 8.0, "root": {}, "extensionsUsed": ["3DTILES_metadata"]}')
    (folder / "transforms").write_text('{"camera_angle_x": 1, "frames": []}')
    (folder / "other ply").write_bytes(b"ply\nformat ascii 1.0\nelement face 0\nend_header\n")
    (folder / "empty").touch()
    (folder / "unknown").write_bytes(bytes(range(256)) * 3)
    (folder / "empty folder").mkdir()
    (folder / "hacpp" / "point_cloud" / "iteration_3").mkdir(parents=True)
    (folder / "hacpp" / "point_cloud" / "iteration_3" / "checkpoint.pth").touch()
    (folder / "no gaussians" / "point_cloud" / "iteration_7").mkdir(parents=True)
    (folder / "no gaussians" / "point_cloud" / "iteration_7" / "point_cloud.ply").touch()
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
    (folder / "gsplat results" / "ckpts").mkdir(parents=True)
    (folder / "gsplat results" / "ckpts" / "ckpt_6999_rank0.pt").write_bytes(b"PK")
    (folder / "gsplat compressed").mkdir()
    for name in ("meta.json", "means_l.png"):
        (folder / "gsplat compressed" / name).write_text("{}")
    (folder / "nerfstudio results" / "nerfstudio_models").mkdir(parents=True)
    (folder / "frames").mkdir()
    write_splats([splats], folder / "frames" / "point_cloud.ply")
    os.mkfifo(folder / "device")
    return folder


def test_every_file_kind_is_detected(zoo):
    for path in zoo.iterdir():
        assert file_kind(path).key == path.name.partition(".")[0], path
    assert file_kind(zoo / "nobody") == file_kind(zoo / "json" / "x") == kinds.NOTHING
    assert file_kind(zoo / "a\0b") == kinds.UNREADABLE


def test_splat_file_is_detected_by_its_suffix(tmp_path):
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
    "read_splats": [kind.key for form in FORMATS.registered().values() for kind in form.kinds],
    "load_cameras": ["cameras"],
    "import_hacpp": ["hacpp"],
}
PARTICULAR = {
    ("import_hacpp", "no gaussians"): ["checkpoint.pth: missing"],
    ("load_scene", "partial scene"): ["conceal it first"],
    ("open_dataset", "dataset"): ["neither a COLMAP reconstruction"],
}
"""Covers files with more known than the kind."""


@pytest.mark.parametrize("reader", READERS)
def test_readers_name_the_kind_of_a_wrong_file(zoo, reader):
    """Covers a pipe, which would block, and a missing name."""
    for path in (*zoo.iterdir(), zoo / "nobody", zoo / "a\0b"):
        kind = file_kind(path)
        if kind.key in WELCOME.get(reader, ()):
            with contextlib.suppress(SplatwireError):  # the reader of the kind reports the damage
                READERS[reader](path)
            continue
        with pytest.raises(SplatwireError) as caught:
            READERS[reader](path)
        assert path.name.split("\0")[0] in str(caught.value)
        words = (
            kind.description,
            *PARTICULAR.get((reader, kind.key), ()),
            *(["cannot be read", "expected the path"] * ("\0" in path.name)),
        )
        assert any(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize("seed", range(4))
def test_arbitrary_bytes_get_a_kind(seed):
    """Headers of every kind, truncated or with changed bytes, and random bytes."""
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
def test_safetensors_kind_requires_a_valid_header(metadata):
    header = json.dumps({"__metadata__": {"splatwire": metadata}}).encode()
    assert kind_of_bytes(struct.pack("<Q", len(header)) + header, 10_000) == kinds.TENSORS
    for text in (b"{" * 4000, b'{"__metadata__": 3}', b'{"__metadata__": {"splatwire": 3}}'):
        assert kind_of_bytes(struct.pack("<Q", len(text)) + text, 10_000) == kinds.TENSORS


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gsplat checkpoint.pt", ["gsplat", "never opened", "export_splats", "PLY"]),
        ("nerfstudio checkpoint.ckpt", ["nerfstudio", "never opened", "ns-export gaussian-splat"]),
        ("gsplat results", ["gsplat", "never opened", "point_cloud_*.ply"]),
        ("gsplat results/ckpts", ["gsplat", "never opened"]),
        ("gsplat compressed", ["gsplat", "PNG", "not read", "export_splats"]),
        ("nerfstudio results", ["nerfstudio", "ns-export gaussian-splat"]),
        ("frames", ["name one of them", "clip"]),
        ("pytorch", ["PyTorch", "never opened", "point_cloud.ply"]),
        ("pickle", ["pickle", "never opened"]),
    ],
)
def test_foreign_checkpoints_are_named_with_their_export_to_ply(zoo, name, message):
    with pytest.raises(SplatwireError) as caught:
        read_splats(zoo / name)
    assert all(word in str(caught.value) for word in message), str(caught.value)


def test_a_model_folder_of_3dgs_is_read_as_the_ply_of_its_last_iteration(zoo):
    assert kinds.trained_ply(zoo / "3dgs") == zoo / "3dgs" / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    assert read_splats(zoo / "3dgs").num_gaussians == 5


@pytest.mark.parametrize(
    ("given", "number"),
    [("3dgs/point_cloud", 30000), ("3dgs/point_cloud/iteration_7000", 7000), ("3dgs", 30000)],
)
def test_parts_of_a_model_folder_of_3dgs_are_read(zoo, given, number):
    assert kinds.trained_ply(zoo / given) == zoo / f"3dgs/point_cloud/iteration_{number}/point_cloud.ply"
    assert open_scene(zoo / given).num_gaussians == 5


def test_a_renamed_folder_of_iterations_is_a_model_and_no_clip(zoo, tmp_path):
    shutil.copytree(zoo / "3dgs" / "point_cloud", tmp_path / "out")
    assert kinds.trained_ply(tmp_path / "out") == tmp_path / "out" / "iteration_30000" / "point_cloud.ply"
    assert not is_sequence(tmp_path / "out")
    assert open_scene(tmp_path / "out").num_gaussians == 5


def test_files_of_a_model_folder_and_folders_above_it_are_refused_with_its_path(tmp_path, zoo):
    model = tmp_path / "runs" / "first"
    shutil.copytree(zoo / "3dgs", model)
    (model / "cfg_args").write_text("Namespace()")
    for given in (tmp_path, tmp_path / "runs", model / "cfg_args"):
        with pytest.raises(SplatwireError) as caught:
            open_scene(given)
        assert str(caught.value).endswith(f"{model} looks like a model folder of 3DGS")
    (tmp_path / "hac" / "point_cloud" / "iteration_3").mkdir(parents=True)
    (tmp_path / "hac" / "point_cloud" / "iteration_3" / "opacity_mlp.pt").touch()
    for name in ("point_cloud", "point_cloud/iteration_3"):
        folder = tmp_path / "hac" / name
        for reader in (import_hacpp, open_scene):
            with pytest.raises(SplatwireError, match=f"{tmp_path / 'hac'} looks like a model folder of HAC"):
                reader(folder)


def test_folders_above_many_others_are_searched_within_limits(tmp_path, monkeypatch):
    looked = []
    for number in range(100):
        (tmp_path / f"{number:03d}" / "inner").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path)
    kinds.folder_nearby(tmp_path, lambda folder: looked.append(folder) or False)
    assert len(looked) == 3 + 32 + 32
    assert kinds.folder_nearby(tmp_path / "absent", lambda folder: True) is None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("unknown", "; it is a file of an unknown format"),
        ("empty", "; it is an empty file"),
        ("empty folder", "; it is an empty folder"),
        ("text", "; it looks like a text file"),
    ],
)
def test_kinds_in_messages_are_sentences(zoo, name, words):
    assert kinds.format_error(zoo / name, "a stream").endswith(f"{name}: not a stream{words}")


@pytest.mark.parametrize("rest", range(1, 32))
def test_a_splat_file_cut_within_a_row_is_refused_with_its_size(tmp_path, rest):
    path = tmp_path / "a.splat"
    path.write_bytes((np.arange(64, dtype=np.uint8) * 37 + 128).tobytes()[: 32 + rest])
    with pytest.raises(SplatwireError, match=f"{32 + rest} bytes are not records of 32 bytes"):
        read_splats(path)


@pytest.mark.parametrize("content", ["<!DOCTYPE html><html>404", "404: Not found", '{"error": 404}'])
def test_a_text_with_the_name_of_a_splat_file_is_named(tmp_path, content):
    path = tmp_path / "a.splat"
    path.write_text(content.ljust(64))
    with pytest.raises(SplatwireError, match=r"looks like (an HTML page|a text file|a JSON file)"):
        read_splats(path)
