"""SPZ files, versions 2 to 4 (github.com/nianticlabs/spz): numbers of fixed width, packed column by column.

Versions 2 and 3 are one gzip stream: a header of 16 bytes, then the columns. Version 4 has a plain header of 32 bytes,
a table of sizes and a zstd stream for each column. Version 2 has rotations of 3 bytes, later ones of 4. Axes are RUB.
"""

import gzip
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zstandard

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.whole import written_whole
from splatwire.formats._axes import SPZ_FLIPS, flip_axes, harmonic_signs
from splatwire.formats._columns import build_splats, check_count, join
from splatwire.formats._files import mapped_file
from splatwire.ops.spherical_harmonics import MAX_DEGREE, num_functions
from splatwire.scene.splats import Splats

GZIP_MAGIC = b"\x1f\x8b"
MAGIC = b"NGSP"
_HEADER = struct.Struct("<4sIIBBBB")
_ANTIALIASED = 1
_TABLE_OFFSET, _TABLE_ROW = struct.Struct("<I"), struct.Struct("<QQ")
_PLAIN_HEADER_BYTES = 32
_MAX_FRACTION_BITS, _FRACTION_BITS = 24, 12
_MIN_WINDOW, _MAX_WINDOW = 8 << 20, 128 << 20
"""How far back a zstd stream may refer, bytes: its unpacker holds as many. No more than a column needs is allowed."""
_PIECES_BEHIND, _PIECE_BEHIND = 256, 1 << 16
"""How far beyond the columns the end of a gzip stream is looked for, bytes."""
_COLOR_SCALE = 0.15
_MAGNITUDE = 511
FULL_BITS, FEWER_BITS = (8, 8), (5, 4)
"""Bits of harmonics of degree 1, and of those beyond: all that there are, and as the format's own software writes."""


@dataclass(frozen=True)
class _Header:
    version: int
    count: int
    degree: int
    fraction_bits: int
    streams: int

    @property
    def columns(self) -> dict[str, int]:
        """Bytes of each column, in the order of the file."""
        rest = 3 * (num_functions(self.degree) - 1)
        widths = {"positions": 9, "alphas": 1, "colors": 3, "scales": 3, "rotations": 3 if self.version == 2 else 4}
        return {name: width * self.count for name, width in {**widths, "sh": rest}.items() if width}


def read_spz(path: Path) -> Splats:
    """Reads an SPZ file of version 2, 3 or 4.

    Raises:
        DatasetError: If it is damaged, of another version or degree, or asks for more memory than such a file can need.
        OSError: If it cannot be read.
    """
    data = mapped_file(path)
    head = bytes(data[:4])
    if head.startswith(GZIP_MAGIC):
        header, columns = _gunzip(path, len(data))
    elif head == MAGIC:
        header, columns = _unzstd(path, data)
    else:
        raise DatasetError(f"{path}: not an SPZ file, it starts with {head!r}")
    return _splats(path, header, columns)


def is_antialiased(path: Path) -> bool:
    """Whether the header of an SPZ says that it was trained with antialiasing."""
    with path.open("rb") as plain:
        head = plain.read(_HEADER.size)
    if head.startswith(GZIP_MAGIC):
        with gzip.open(path) as file:
            head = file.read(_HEADER.size)
    return bool(_HEADER.unpack(head)[5] & _ANTIALIASED)


def _parse(path: Path, data: bytes | memoryview, file_bytes: int) -> _Header:
    if len(data) < _HEADER.size:
        raise DatasetError(f"{path}: the SPZ header ends after {len(data)} bytes")
    magic, version, count, degree, fraction_bits, _, last = _HEADER.unpack_from(data)
    if magic != MAGIC:
        raise DatasetError(f"{path}: what is packed in it starts with {magic!r} and is no SPZ")
    if version not in (2, 3, 4):
        raise DatasetError(f"{path}: SPZ of version {version}; versions 2 to 4 are read")
    if degree > MAX_DEGREE:
        raise DatasetError(f"{path}: harmonics of degree {degree}; 0 to {MAX_DEGREE} are read")
    if fraction_bits > _MAX_FRACTION_BITS:
        raise DatasetError(f"{path}: {fraction_bits} fractional bits of 24 in a position")
    check_count(path, count, file_bytes)
    return _Header(version, count, degree, fraction_bits, last)


def _gunzip(path: Path, file_bytes: int) -> tuple[_Header, dict[str, np.ndarray]]:
    try:
        with gzip.open(path) as file:
            header = _parse(path, file.read(_HEADER.size), file_bytes)
            if header.version == 4:
                raise DatasetError(f"{path}: SPZ of version 4 within gzip")
            needed = sum(header.columns.values())
            body = file.read(needed)
            for _ in range(_PIECES_BEHIND):  # at the end its checksum is compared
                if not file.read(_PIECE_BEHIND):
                    break
    except (zlib.error, EOFError, gzip.BadGzipFile) as error:
        raise DatasetError(f"{path}: the gzip data are damaged: {error}") from error
    if len(body) < needed:
        raise DatasetError(f"{path}: the gzip data end after {len(body)} bytes, {needed} were promised")
    ends = np.cumsum(list(header.columns.values()))
    pieces = np.split(np.frombuffer(body, np.uint8), ends[:-1])
    return header, dict(zip(header.columns, pieces, strict=True))


def _unzstd(path: Path, data: memoryview) -> tuple[_Header, dict[str, np.ndarray]]:
    header = _parse(path, data, len(data))
    if header.version != 4 or len(data) < _PLAIN_HEADER_BYTES:
        raise DatasetError(f"{path}: an SPZ header of version {header.version} and {len(data)} bytes, not of version 4")
    (table,) = _TABLE_OFFSET.unpack_from(data, _HEADER.size)
    at = table + header.streams * _TABLE_ROW.size
    if header.streams != len(header.columns) or not _PLAIN_HEADER_BYTES <= table <= at <= len(data):
        raise DatasetError(f"{path}: a table of {header.streams} streams at byte {table} is not where it can be")
    columns = {}
    for stream, (name, size) in enumerate(header.columns.items()):
        packed, unpacked = _TABLE_ROW.unpack_from(data, table + stream * _TABLE_ROW.size)
        if unpacked != size or packed > len(data) - at:
            raise DatasetError(f"{path}: stream {name} is said to be {packed} bytes for {unpacked}, not for {size}")
        columns[name] = _unpack_stream(path, name, data[at : at + packed], size)
        at += packed
    return header, columns


def _unpack_stream(path: Path, name: str, data: memoryview, size: int) -> np.ndarray:
    window = min(max(2 * size, _MIN_WINDOW), _MAX_WINDOW)
    try:
        with zstandard.ZstdDecompressor(max_window_size=window).stream_reader(data) as reader:
            content = reader.read(size + 1)
    except zstandard.ZstdError as error:
        raise DatasetError(f"{path}: stream {name} is damaged: {error}") from error
    if len(content) != size:
        raise DatasetError(f"{path}: stream {name} has not the {size} bytes that it was said to have")
    return np.frombuffer(content, np.uint8)


def _splats(path: Path, header: _Header, columns: dict[str, np.ndarray]) -> Splats:
    low, middle, high = columns["positions"].astype(np.int32).reshape(-1, 3, 3).transpose(2, 0, 1)
    fixed = (low | middle << 8 | high << 16) - ((high & 128) << 17)
    color = (columns["colors"].astype(np.float32) / 255 - 0.5) / _COLOR_SCALE
    sh = np.empty((header.count, num_functions(header.degree), 3), np.float32)
    sh[:, 0] = color.reshape(-1, 3)
    if "sh" in columns:  # in place, here and below: these are most of the memory
        sh[:, 1:] = columns["sh"].reshape(header.count, -1, 3)
        sh[:, 1:] -= 128
        sh[:, 1:] /= 128
    sh *= harmonic_signs(SPZ_FLIPS, header.degree)[:, None]
    unpack = _three_bytes if header.version == 2 else _smallest_three
    return build_splats(
        path,
        means=fixed / np.float32(1 << header.fraction_bits) * np.array(SPZ_FLIPS, np.float32),
        quats=unpack(columns["rotations"]) * np.array((1, *SPZ_FLIPS), np.float32),
        log_scales=columns["scales"].astype(np.float32).reshape(-1, 3) / 16 - 10,
        opacities=columns["alphas"].astype(np.float32) / 255,
        sh=sh,
    )


def _three_bytes(data: np.ndarray) -> np.ndarray:
    """Rotations of version 2: x, y and z, from which w follows."""
    vector = data.astype(np.float32).reshape(-1, 3) / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - (vector**2).sum(axis=1, keepdims=True)))
    return np.concatenate([w, vector], axis=1)


def _smallest_three(data: np.ndarray) -> np.ndarray:
    """Rotations since version 3: which of x, y, z, w is largest, and sign and 9 bits of the others."""
    packed = data.reshape(-1, 4).view("<u4")[:, 0].copy()
    largest = packed >> 30
    xyzw = np.zeros((len(packed), 4), np.float32)
    for axis in (3, 2, 1, 0):
        other = largest != axis
        value = (packed & _MAGNITUDE) / np.float32(_MAGNITUDE * 2**0.5)
        xyzw[:, axis] = np.where(other, np.where(packed >> 9 & 1, -value, value), 0)
        packed = np.where(other, packed >> 10, packed)
    rest = np.sqrt(np.maximum(0, 1 - (xyzw**2).sum(axis=1)))
    xyzw[np.arange(len(xyzw)), largest] = rest
    return np.roll(xyzw, 1, axis=1)


def write_spz(
    parts: Iterable[Splats],
    path: Path,
    harmonic_bits: tuple[int, int] = FULL_BITS,
    *,
    antialiased: bool = False,
) -> int:
    """Writes an SPZ file of version 3, which all viewers read; harmonics are cut to their range.

    Args:
        parts: See `splatwire.formats.write_splats`, like `path` and what is returned.
        path: The file.
        harmonic_bits: Bits of harmonics of degree 1, and of those beyond, 1 to 8 each: they stay bytes, of which the
            last bits are 0, so that they pack better.
        antialiased: Whether the header says that it was trained with antialiasing.

    Raises:
        InvalidValueError: Also if a position is beyond 2**23, or there is no such number of bits.
    """
    if not all(1 <= number <= 8 for number in harmonic_bits):
        raise InvalidValueError(f"harmonics of an SPZ have 1 to 8 bits, of degree 1 and beyond, not {harmonic_bits}")
    splats = flip_axes(join(path, parts), SPZ_FLIPS)
    bits = _fraction_bits(float(splats.means.abs().max()))
    header = _HEADER.pack(MAGIC, 3, splats.num_gaussians, splats.degree, bits, _ANTIALIASED * antialiased, 0)
    content = header + b"".join(column.tobytes() for column in _columns(splats, bits, harmonic_bits))
    with written_whole(path) as unfinished:
        unfinished.write_bytes(gzip.compress(content, mtime=0))
    return splats.num_gaussians


def _fraction_bits(farthest: float) -> int:
    """12 as other writers, fewer where positions would not fit into 24 bits."""
    bits = _FRACTION_BITS
    while bits and farthest * 2**bits > 2**23 - 1:
        bits -= 1
    if farthest * 2**bits > 2**23 - 1:
        raise InvalidValueError(f"a position of {farthest:g} is too far away for SPZ, which ends at {2**23 - 1}")
    return bits


def _columns(splats: Splats, bits: int, harmonic_bits: tuple[int, int]) -> list[np.ndarray]:
    fixed = np.rint(splats.means.double().numpy() * 2**bits).astype("<i4")
    sh = splats.sh.numpy()
    columns = [
        np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[:, :, :3],
        _byte(splats.opacities.numpy() * 255),
        _byte((sh[:, 0] * _COLOR_SCALE + 0.5) * 255),
        _byte((np.log(splats.scales.numpy()) + 10) * 16),
        _pack_smallest_three(splats.quats.numpy()),
        np.concatenate([_harmonic(sh[:, 1:4], harmonic_bits[0]), _harmonic(sh[:, 4:], harmonic_bits[1])], axis=1),
    ]
    return [np.ascontiguousarray(column) for column in columns if column.size]


def _harmonic(values: np.ndarray, bits: int) -> np.ndarray:
    """Bytes of harmonics, to the nearest multiple of their step."""
    step = 1 << (8 - bits)
    return _byte(np.floor((np.rint(values * 128 + 128) + step / 2) / step) * step)


def _byte(values: np.ndarray) -> np.ndarray:
    return np.rint(values).clip(0, 255).astype(np.uint8)


def _pack_smallest_three(quats: np.ndarray) -> np.ndarray:
    xyzw = np.roll(quats.astype(np.float64), -1, axis=1)
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw *= np.where(xyzw[np.arange(len(xyzw)), largest] < 0, -1, 1)[:, None]
    packed = largest.astype(np.uint32)
    magnitudes = np.rint(np.abs(xyzw) * (_MAGNITUDE * 2**0.5)).clip(0, _MAGNITUDE).astype(np.uint32)
    for axis in range(4):
        field = np.where(xyzw[:, axis] < 0, np.uint32(512), np.uint32(0)) | magnitudes[:, axis]
        packed = np.where(largest != axis, packed << np.uint32(10) | field, packed)
    return packed.astype("<u4")
