"""Memory for untrusted files: small files that announce large content."""

import gzip
import io
import json
import lzma
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from close import assert_close
from splat_io.formats.handmade import glb, glb_of, some_splats, write
from splatwire.data.photos import load_mask, load_photo
from splatwire.errors import DatasetError
from splatwire.files.archive import open_archive
from splatwire.io.formats import gltf, read_splats, write_splats
from splatwire.io.formats._columns import BYTES_PER_GAUSSIAN, FREE_GAUSSIANS

MIB = 1 << 20
MAX_RATIO = 130
"""Bytes of memory per byte of file, for large files."""
MANY = FREE_GAUSSIANS + 10_000


def peak(action: Callable[[], object]) -> int:
    """Peak memory during an action above that before, of Python and NumPy, bytes."""
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def refused(path: Path, reason: str, read: Callable[[Path], object] = read_splats) -> int:
    """Peak memory while a file is refused."""

    def act() -> None:
        with pytest.raises(DatasetError, match=reason) as caught:
            read(path)
        assert path.name in str(caught.value)

    return peak(act)


@pytest.fixture(scope="module")
def sog(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The members of a SOG."""
    path = tmp_path_factory.mktemp("sog") / "a.sog"
    write_splats([some_splats(8, 3)], path)
    with zipfile.ZipFile(path) as bundle:
        return {name: bundle.read(name) for name in bundle.namelist()}


def bundled(path: Path, members: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", method) as bundle:
        for name, data in members.items():
            bundle.writestr(name, data)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_archive_members_with_unbounded_decompression_are_refused(
    sog: dict[str, bytes], method: int, tmp_path: Path
) -> None:
    """Python decompresses a block of bzip2 or LZMA to its end, however few bytes are requested."""
    path = bundled(tmp_path / "a.sog", {**sog, "meta.json": sog["meta.json"] + b" " * (48 * MIB)}, method)
    assert path.stat().st_size < 100_000
    with zipfile.ZipFile(path) as bundle:  # the kind is checked before the announced size
        name = "means_l.webp"
        assert bundle.getinfo(name).compress_type == method
    assert refused(path, r"meta\.json has .* bytes|packed with method") < 4 * MIB
    path = bundled(tmp_path / "b.sog", sog, method)
    assert refused(path, "is packed with method") < 4 * MIB


def test_picture_file_larger_than_its_pixels_is_refused(sog: dict[str, bytes], tmp_path: Path) -> None:
    members = {**sog, "means_l.webp": sog["means_l.webp"] + bytes(48 * MIB)}
    path = bundled(tmp_path / "a.sog", members, zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 100_000
    assert refused(path, r"means_l\.webp has 5\d+ bytes, the limit is") < 4 * MIB
    (tmp_path / "sog").mkdir()
    for name, data in members.items():
        (tmp_path / "sog" / name).write_bytes(data)
    assert refused(tmp_path / "sog", r"means_l\.webp has 5\d+ bytes, the limit is") < 4 * MIB


def test_oversized_archive_directory_is_not_read(tmp_path: Path) -> None:
    path = bundled(tmp_path / "a.sog", {f"{i:040d}": b"" for i in range(14_000)})
    assert refused(path, "list of members is longer") < 4 * MIB


def picture(width: int, height: int, pixel: tuple[int, int, int, int]) -> bytes:
    file = io.BytesIO()
    Image.new("RGBA", (width, height), pixel).save(file, "WEBP", lossless=True, method=0)
    return file.getvalue()


def crowded_sog(path: Path, sog: dict[str, bytes], count: int, size: int) -> Path:
    """Writes a SOG of identical Gaussians, which compress well."""
    side = int(count**0.5) + 1
    members = dict.fromkeys(sog, picture(side, side, (0, 0, 0, 255)))
    members |= {
        "quats.webp": picture(side, side, (0, 0, 0, 252)),
        "shN_centroids.webp": picture(960, 1, (0, 0, 0, 255)),
    }
    meta = json.loads(sog["meta.json"]) | {"count": count}
    meta["shN"] |= {"count": 8}
    members["meta.json"] = json.dumps(meta).encode()
    return bundled(path, {**members, "padding": bytes(size - sum(map(len, members.values())))})


def crowded_spz(path: Path, count: int, size: int) -> Path:
    head = struct.pack("<4sIIBBBB", b"NGSP", 3, count, 3, 12, 0, 0)
    raw = head + bytes(9 * count) + b"\xff" * count + bytes(6 * count) + struct.pack("<I", 3 << 30) * count
    packed = gzip.compress(raw + b"\x80" * (45 * count))
    return write(path, packed + bytes(size - len(packed)))


def crowded_glb(path: Path, count: int, size: int) -> Path:
    """Attributes of one byte per number that share the same bytes."""
    kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    accessors = [
        {"bufferView": 0, "componentType": 5121, "normalized": True, "count": count, "type": kinds[width]}
        for width in (3, 4, 3, 1, *[3] * 16)
    ]
    document = json.loads(glb(some_splats(2, 3))[20:].partition(b"BIN\0")[0][:-4].rstrip(b" "))
    document |= {"accessors": accessors, "bufferViews": [{"buffer": 0, "byteLength": size}]}
    return write(path, glb_of(document, b"\xff" * size))


@pytest.mark.slow
@pytest.mark.parametrize("end", ["sog", "spz", "glb"])
def test_memory_is_proportional_to_the_file_size(sog: dict[str, bytes], end: str, tmp_path: Path) -> None:
    crowded: dict[str, Callable[[Path, int, int], Path]] = {
        "sog": lambda path, count, size: crowded_sog(path, sog, count, size),
        "spz": crowded_spz,
        "glb": crowded_glb,
    }
    path = crowded[end](tmp_path / f"a.{end}", MANY, BYTES_PER_GAUSSIAN * MANY)
    found: list[int] = []
    assert peak(lambda: found.append(read_splats(path).num_gaussians)) < MAX_RATIO * path.stat().st_size
    assert found == [MANY]
    if end != "glb":  # its numbers alone need as many bytes
        path = crowded[end](tmp_path / f"b.{end}", MANY, BYTES_PER_GAUSSIAN * MANY // 2)
        assert refused(path, "more than .* bytes of file can hold") < 8 * MIB


PROPERTIES = [*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3)),
              *(f"rot_{i}" for i in range(4)), *(f"f_rest_{i}" for i in range(45))]  # fmt: skip


def ply_head(form: str, count: int) -> bytes:
    lines = ["ply", f"format {form} 1.0", f"element vertex {count}", *(f"property float {name}" for name in PROPERTIES)]
    return ("\n".join(lines) + "\nend_header\n").encode()


@pytest.mark.extended
@pytest.mark.slow
def test_xz_memory_is_bounded_by_its_content(tmp_path: Path) -> None:
    rows = np.zeros((200_000, len(PROPERTIES)), "<f4")
    rows[:, PROPERTIES.index("rot_0")] = 1
    path = write(tmp_path / "a.ply.xz", lzma.compress(ply_head("binary_little_endian", 200_000) + rows.tobytes()))
    assert refused(path, "which .* bytes of file cannot hold") < 24 * MIB  # 8 for the archive's dictionary
    path = write(tmp_path / "b.ply.xz", lzma.compress(ply_head("ascii", 10) + b" " * (40 * MIB)))
    assert refused(path, "unpacks to more than") < 24 * MIB
    path = write(
        tmp_path / "c.ply.xz", lzma.compress(ply_head("binary_little_endian", 50_000) + rows[:50_000].tobytes())
    )
    assert peak(lambda: read_splats(path)) < 80 * MIB  # always allowed


def test_archive_is_read_or_refused_as_damaged(tmp_path: Path) -> None:
    path = bundled(tmp_path / "a.zip", {"x": b"hello" * 100}, zipfile.ZIP_DEFLATED)
    with open_archive(path, DatasetError) as archive:
        assert archive.read("x", 500) == b"hello" * 100
        with pytest.raises(DatasetError, match=r"a\.zip: x has 500 bytes, the limit is 499"):
            archive.read("x", 499)
        with pytest.raises(DatasetError, match=r"a\.zip: y is missing"):
            archive.read("y", 1)
    raw = bytearray(path.read_bytes())
    raw[40] ^= 255
    with open_archive(write(path, bytes(raw)), DatasetError) as archive, pytest.raises(DatasetError, match="damaged"):
        archive.read("x", 500)
    for data in (b"", b"PK\x03\x04", raw[:50]):
        with (
            pytest.raises(DatasetError, match=r"a\.zip: the zip is (cut|damaged)"),
            open_archive(write(path, bytes(data)), DatasetError),
        ):
            pass


def png_head(side: int) -> bytes:
    """A PNG that ends before its pixels."""
    chunk = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    head = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return head + struct.pack(">I", 1 << 30) + b"IDAT" + bytes(8)


def test_photo_pixels_are_limited_by_file_size(tmp_path: Path) -> None:
    path = write(tmp_path / "a.png", png_head(5000))
    assert refused(path, "5000 x 5000 pixels are more than .* bytes of file can hold", load_photo) < MIB
    path = write(tmp_path / "b.png", png_head(9000))
    assert refused(path, "9000 x 9000 pixels are more than .* file can hold", lambda p: load_mask(p, (9, 9))) < MIB
    path = write(tmp_path / "c.png", png_head(5000) + bytes(MIB))  # the largest possible number
    refused(path, "damaged", load_photo)


class _Watched(dict[str, Any]):
    """A node that counts accesses to its children."""

    asked = 0

    def get(self, name: str, default: Any = None) -> Any:
        _Watched.asked += name == "children"
        return super().get(name, default)


@pytest.mark.slow
def test_deep_node_chain_takes_linear_time(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    count = 4000
    nodes: list[dict[str, Any]] = [{"mesh": 0}, *({"children": [i]} for i in range(count))]
    path = write(tmp_path / "a.glb", glb(some_splats(4), {"nodes": nodes}))
    loads = json.loads
    monkeypatch.setattr(gltf.json, "loads", lambda data: loads(data, object_hook=_Watched))
    monkeypatch.setattr(_Watched, "asked", 0)
    still = read_splats(path)
    assert still.num_gaussians == 4
    assert count < _Watched.asked <= 2 * (count + 1)  # once to find the root, once to traverse
    nodes[count // 2]["translation"] = [1, 0, 0]
    write(path, glb(some_splats(4), {"nodes": nodes}))
    moved = read_splats(path).means - still.means
    assert_close(moved, np.tile([-1.0, 0.0, 0.0], (4, 1)))
    nodes[0]["children"] = [count]  # a cycle, which glTF forbids, ends as well
    write(path, glb(some_splats(4), {"nodes": nodes}))
    assert np.array_equal(read_splats(path).means, still.means)  # without a root, no node shows the Gaussians
    write(path, glb(some_splats(4), {"nodes": nodes, "scenes": [{"nodes": [count]}]}))
    with pytest.raises(DatasetError, match=f"node {count} has two parents, or is below itself"):
        read_splats(path)
