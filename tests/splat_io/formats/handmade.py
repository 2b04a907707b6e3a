"""Files of explicit Gaussians built from the specifications of their formats, and matching Gaussians."""

import gzip
import itertools
import json
import struct
from pathlib import Path

import numpy as np
import zstandard

from close import unit
from random_numbers import Numbers
from splatwire.types.splats import Splats


def some_splats(count: int = 20, degree: int = 3, seed: int = 0) -> Splats:
    """Gaussians within the range of all formats."""
    rng = Numbers(seed)
    means = rng.randn(count, 3)
    means[:, 0] = np.linspace(-2, 2, count)[rng.randperm(count)]  # sorting by x finds each again
    return Splats(
        means=means,
        quats=unit(rng.randn(count, 4)),
        scales=rng.rand(count, 3) * 0.1 + 1e-3,
        opacities=rng.rand(count) * 0.98 + 0.01,
        sh=rng.randn(count, (degree + 1) ** 2, 3).clip(-3, 3) * 0.25,
    )


def legacy_spz(version: int = 2, degree: int = 1, count: int = 2, raw: bytes | None = None) -> bytes:
    """SPZ of version 2 or 3: Gaussians at (1, 2, 3) and (-1, -2, -3) in file axes, the rest in the middle."""
    if raw is None:
        rotation = b"\x80\x7f\x80" if version == 2 else struct.pack("<I", 3 << 30)
        positions = b"".join(
            int(sign * axis * 4096).to_bytes(3, "little", signed=True) for sign in (1, -1) for axis in (1, 2, 3)
        )
        rest = 3 * ((degree + 1) ** 2 - 1)
        raw = struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, 12, 0, 0) + positions
        raw += b"\xff\x00" + b"\x80" * 6 + b"\x90" * 6 + rotation * 2 + bytes(range(100, 100 + rest)) * 2
    return gzip.compress(raw, mtime=0)


def modern_spz(legacy: bytes) -> bytes:
    """SPZ of version 4 with the numbers of one of version 3."""
    raw = gzip.decompress(legacy)
    _, _, count, degree, bits, _, _ = struct.unpack_from("<4sIIBBBB", raw)
    widths = [w for w in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)) if w]
    ends = np.cumsum([16, *(w * count for w in widths)])
    columns = [raw[a:b] for a, b in itertools.pairwise(ends)]
    streams = [zstandard.ZstdCompressor().compress(column) for column in columns]
    head = struct.pack("<4sIIBBBBI", b"NGSP", 4, count, degree, bits, 0, len(streams), 32).ljust(32, b"\0")
    table = b"".join(struct.pack("<QQ", len(s), len(c)) for s, c in zip(streams, columns, strict=True))
    return head + table + b"".join(streams)


def ksplat(level: int = 1, degree: int = 1, count: int = 3, sections: int = 1, spare: int = 0) -> bytes:
    """A `.ksplat` of sections with a full bucket of two Gaussians at (10, 20, 30) and a partial one at (40, 50, 60).

    Args:
        level: Compression level.
        degree: Degree of the harmonics.
        count: Number of Gaussians of each section, 3 unless the level is 0.
        sections: Number of sections. In each, x is 100 larger than in the one before.
        spare: Number of further section headers without a section.
    """
    rest = 3 * ((degree + 1) ** 2 - 1)
    header = bytearray(4096)
    struct.pack_into("<BB", header, 0, 0, 1)
    struct.pack_into("<4IH", header, 4, sections + spare, sections, sections * count, sections * count, level)
    struct.pack_into("<ff", header, 36, -2.0, 2.0)
    heads, bodies = b"", b""
    for number in range(sections):
        shift = 100 * number
        body = struct.pack("<I6f", 1, 10 + shift, 20, 30, 40 + shift, 50, 60)
        for row in range(count):
            color = bytes((255, 0, 128, 200))
            if level == 0:
                numbers = struct.pack("<10f", row + shift, 2, 3, 0.1, 0.2, 0.3, 1, 0, 0, 0)
                body += numbers + color + struct.pack(f"<{rest}f", *range(rest))
            else:
                numbers = np.array([0.1, 0.2, 0.3, 1, 0, 0, 0], "<f2").tobytes()
                tail = np.arange(rest).astype("<f2").tobytes() if level == 1 else bytes(range(rest))
                body += struct.pack("<3H", 32767, 0, 65534) + numbers + color + tail
        fields = (count, count, 2, 2, 4.0, 12, 32767, len(body), 1, 1, degree)
        heads, bodies = heads + struct.pack("<4IfH2x4IH", *fields).ljust(1024, b"\0"), bodies + body
    return bytes(header) + heads + bytes(1024 * spare) + bodies


def glb(splats: Splats, change: dict[str, object] | None = None) -> bytes:
    """Binary glTF of Gaussians in file axes; `change` overwrites keys of the document."""
    name = "KHR_gaussian_splatting"
    columns = {
        "POSITION": splats.means,
        f"{name}:ROTATION": np.roll(splats.quats, -1, axis=1),
        f"{name}:SCALE": splats.scales,
    }
    columns[f"{name}:OPACITY"] = splats.opacities[:, None]
    for band in range(splats.degree + 1):
        for i in range(2 * band + 1):
            columns[f"{name}:SH_DEGREE_{band}_COEF_{i}"] = splats.sh[:, band * band + i]
    binary, views, accessors = b"", [], []
    for values in columns.values():
        data = values.astype("<f4").tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]]
        accessors.append({"bufferView": len(accessors), "componentType": 5126, "count": len(values), "type": kind})
        binary += data
    primitive = {"attributes": {key: i for i, key in enumerate(columns)}, "mode": 0, "extensions": {name: {}}}
    document: dict[str, object] = {"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "accessors": accessors}
    document |= {"meshes": [{"primitives": [primitive]}], "bufferViews": views}
    document |= {"buffers": [{"byteLength": len(binary)}]}
    return glb_of(document | (change or {}), binary)


def glb_of(document: object, binary: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def ply(form: str, elements: dict[str, np.ndarray], newline: bytes = b"\n", comments: tuple[bytes, ...] = ()) -> bytes:
    """A PLY of elements, each a record array, in one of the `FORMATS`."""
    lines = [b"ply", f"format {form} 1.0".encode(), *comments]
    body = b""
    words = {"f4": "float", "f8": "double", "u1": "uchar", "i4": "int", "u4": "uint32", "i2": "int16"}
    for name, rows in elements.items():
        lines.append(f"element {name} {len(rows)}".encode())
        kinds = [(field, rows.dtype[field].str[1:]) for field in rows.dtype.names]
        lines += [f"property  {words[kind]} {field} ".encode() for field, kind in kinds]
        if form == "ascii":
            body += b"".join(b" ".join(repr(value.item()).encode() for value in row) + newline for row in rows)
        else:
            body += rows.astype(rows.dtype.newbyteorder(FORMATS[form])).tobytes()
    return newline.join([*lines, b"end_header", b""]) + body
