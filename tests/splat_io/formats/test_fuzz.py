"""Mutated files of every format give Gaussians or one error.

Meaningful fields are changed; checksums, sizes and packing are repaired, so that the inner readers are reached.
`SPLATWIRE_FUZZ_CASES=100000 pytest tests/splat_io/formats/test_fuzz.py` runs longer; a number identifies each case.
"""

import io
import json
import lzma
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from PIL import Image

from splat_io.formats.handmade import glb, glb_of, ksplat, legacy_spz, ply, some_splats
from splatwire.errors import DatasetError
from splatwire.io.formats import read_splats, write_splats
from splatwire.io.formats._columns import FREE_GAUSSIANS
from splatwire.io.formats.ply_file import read_ply_elements
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow

CASES = int(os.environ.get("SPLATWIRE_FUZZ_CASES", "1200"))
NUMBERS = (0, 1, -1, 2, 3, 4, 7, 255, 256, 65535, 65536, 2**24, 2**31 - 1, -(2**31), 2**32 - 1, 19_000_000)
FLOATS = (0.0, -0.0, 1.0, -1.0, float("nan"), float("inf"), -float("inf"), 1e38, -1e38, 1e-45, 100.0, 90.0)
VALUES = (*NUMBERS, *FLOATS, None, True, "", "x", [], [0], {}, [[0]], "meta.json", "../../etc/passwd", 1e400, 10**30)


def _hit(data: bytes, rng: np.random.Generator) -> bytes:
    """Overwrites random places with extreme bytes, integers or floats; sometimes cuts, repeats or clears parts."""
    raw = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(0, max(len(raw), 1)))
        kind = rng.integers(0, 6)
        if kind == 0:
            raw[at : at + 1] = bytes([rng.integers(0, 256)])
        elif kind == 1:
            raw[at // 4 * 4 : at // 4 * 4 + 4] = struct.pack("<I", int(rng.choice(NUMBERS)) & 0xFFFFFFFF)
        elif kind == 2:
            raw[at // 4 * 4 : at // 4 * 4 + 4] = struct.pack("<f", float(rng.choice(FLOATS)))
        elif kind == 3:
            del raw[at:]
        elif kind == 4:
            raw[at:at] = bytes(int(rng.integers(1, 4096)))
        else:
            raw[at : at + 64] = bytes(len(raw[at : at + 64]))
    return bytes(raw)


def _hit_json(value: Any, rng: np.random.Generator) -> Any:
    """Replaces or removes one value anywhere in a document."""
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = list(value)[rng.integers(len(value))]
        if rng.random() < 0.1:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: _hit_json(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.85:
        at = int(rng.integers(len(value)))
        return [*value[:at], _hit_json(value[at], rng), *value[at + 1 :]]
    return VALUES[rng.integers(len(VALUES))]


def _gzip_spz(rng: np.random.Generator, _: bytes) -> bytes:
    import gzip

    base = legacy_spz(int(rng.integers(2, 4)), int(rng.integers(0, 5)))
    return legacy_spz(raw=_hit(gzip.decompress(base), rng))


def _zstd_spz(rng: np.random.Generator, base: bytes) -> bytes:
    """Changes and recompresses a stream, with or without repaired sizes in the table."""
    count = base[15]
    table = [struct.unpack_from("<QQ", base, 32 + 16 * i) for i in range(count)]
    at, streams = 32 + 16 * count, []
    for packed, size in table:
        streams.append(zstandard.ZstdDecompressor().decompress(base[at : at + packed], size))
        at += packed
    hit = int(rng.integers(count))
    streams[hit] = _hit(streams[hit], rng) if rng.random() < 0.7 else bytes(1 << 20)
    packed = [zstandard.ZstdCompressor().compress(stream) for stream in streams]
    head = _hit(base[:32], rng)[:32].ljust(32, b"\0") if rng.random() < 0.4 else base[:32]
    truthful = rng.random() < 0.3
    sizes = [(len(p), len(s) if truthful else size) for p, s, (_, size) in zip(packed, streams, table, strict=True)]
    return head + b"".join(struct.pack("<QQ", *row) for row in sizes) + b"".join(packed)


def _sog(rng: np.random.Generator, base: bytes) -> bytes:
    with zipfile.ZipFile(io.BytesIO(base)) as bundle:
        files = {name: bundle.read(name) for name in bundle.namelist()}
    name = list(files)[rng.integers(len(files))]
    if name == "meta.json" or rng.random() < 0.5:
        files["meta.json"] = json.dumps(_hit_json(json.loads(files["meta.json"]), rng)).encode()
    elif rng.random() < 0.5:
        files[name] = _hit(files[name], rng)
    else:
        pixels = rng.integers(0, 256, (int(rng.integers(1, 70)), int(rng.integers(1, 70)), 4), dtype=np.uint8)
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "WEBP", lossless=True, exact=True, method=0)
        files[name] = file.getvalue()
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED if rng.random() < 0.3 else zipfile.ZIP_STORED) as bundle:
        for member, data in files.items():
            bundle.writestr(member, data)
    return file.getvalue()


def _gltf(rng: np.random.Generator, base: bytes) -> bytes:
    size = struct.unpack_from("<I", base, 12)[0]
    document, binary = json.loads(base[20 : 20 + size]), base[28 + size :]
    if rng.random() < 0.7:
        document = _hit_json(document, rng)
    else:
        binary = _hit(binary, rng)
    return glb_of(document, binary)


def _header_only(rng: np.random.Generator, base: bytes) -> bytes:
    """Replaces a number or word of a text header and keeps the body."""
    head, body = base.split(b"end_header\n", 1)
    words = head.split(b" ")
    lies = [b"0", b"1", b"-1", b"99999999999", b"300", b"double", b"x\nelement y 3\n"]
    words[rng.integers(len(words))] = lies[rng.integers(len(lies))]
    return b" ".join(words) + b"end_header\n" + body


def _ply(rng: np.random.Generator, base: bytes) -> bytes:
    head, body = base.split(b"end_header\n", 1)
    changed = _hit(body, rng)
    return head + b"end_header\n" + changed[: len(body)].ljust(len(body), b"\0")


def _text_ply(rng: np.random.Generator, base: bytes) -> bytes:
    """Replaces a word of the header or the rows, or changes bytes in between."""
    if rng.random() < 0.3:
        return _hit(base, rng)
    words = base.split(b" ")
    lies = [b"0", b"-1", b"nan", b"inf", b"1e400", b"x", b"", b"\n\n", b"9" * 70, b"1_0", b"list uchar", b"\0", b"300"]
    for _ in range(rng.integers(1, 4)):
        words[rng.integers(len(words))] = lies[rng.integers(len(lies))]
    return b" ".join(words)


def _other_ways(base: bytes, folder: Path) -> dict[str, bytes]:
    """Writes a PLY as text and in big-endian order."""
    (folder / "base.ply").write_bytes(base)
    elements = {name: element.rows for name, element in read_ply_elements(folder / "base.ply").items()}
    return {form: ply(form, elements) for form in ("ascii", "binary_big_endian")}


LIES: dict[str, tuple[str, Callable[[np.random.Generator, bytes], bytes]]] = {
    "ply": (".ply", _ply),
    "ply header": (".ply", _header_only),
    "compressed ply": (".compressed.ply", _ply),
    "compressed ply header": (".compressed.ply", _header_only),
    "text ply": (".ascii", _text_ply),
    "big-endian ply": (".big", _ply),
    "big-endian ply header": (".big", _header_only),
    "xz ply": (".xz", lambda rng, base: _hit(base, rng)),
    "gzip spz": (".spz", _gzip_spz),
    "zstd spz": (".spz", _zstd_spz),
    "sog": (".sog", _sog),
    "splat": (".splat", lambda rng, base: _hit(base, rng)),
    "ksplat": (".ksplat", lambda rng, _: _hit(ksplat(int(rng.integers(3)), int(rng.integers(3))), rng)),
    "gltf": (".glb", _gltf),
    "any bytes": ("", lambda rng, base: _hit(base, rng)),
}


def _read_or_refuse(path: Path) -> Splats | None:
    message = ""
    try:
        return read_splats(path)
    except DatasetError as error:
        message = str(error)
    assert path.name in message
    assert len(message) < 600
    return None


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[bytes]]:
    folder = tmp_path_factory.mktemp("bases")
    found: dict[str, list[bytes]] = {".ksplat": [ksplat()], ".glb": [glb(some_splats(8, 1))]}
    for end in (".ply", ".compressed.ply", ".spz", ".sog", ".splat"):
        for degree in (0, 2):
            write_splats([some_splats(8, degree)], folder / f"{degree}{end}")
            found.setdefault(end, []).append((folder / f"{degree}{end}").read_bytes())
            if end in (".ply", ".compressed.ply"):
                ways = _other_ways(found[end][-1], folder)
                found.setdefault(".ascii", []).append(ways["ascii"])
                found.setdefault(".big", []).append(ways["binary_big_endian"])
                found.setdefault(".xz", []).append(lzma.compress(found[end][-1], preset=0))
    return found


@pytest.mark.parametrize("name", LIES)
def test_mutated_files_are_read_or_refused(name: str, bases: dict[str, list[bytes]], tmp_path: Path) -> None:
    end, lie = LIES[name]
    read = 0
    for case in range(CASES // len(LIES)):
        rng = np.random.default_rng((case, *name.encode()))
        this_end = end or list(bases)[case % len(bases)]
        data = lie(rng, bases[this_end][rng.integers(len(bases[this_end]))])
        path = tmp_path / f"case{this_end}"
        path.write_bytes(data)
        splats = _read_or_refuse(path)
        if splats is None:
            continue
        read += 1
        assert splats.num_gaussians <= max(FREE_GAUSSIANS, len(data)), case
        for value in vars(splats).values():
            assert bool(np.isfinite(value).all()), case
        assert bool((splats.scales > 0).all()), case
        assert 0 <= float(splats.opacities.min()) <= float(splats.opacities.max()) <= 1, case
    assert read < CASES // len(LIES)  # the mutations stay invalid
