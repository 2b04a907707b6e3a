"""SPZ files, versions 1 to 4 (github.com/nianticlabs/spz): fixed-width values, compressed attribute by attribute.

Versions 1 to 3 are one gzip stream: a header of 16 bytes, one array (column) per attribute, and extensions. Version 4
has an uncompressed header of 32 bytes, extensions, a table of sizes and a zstd stream for each column. Version 1 has
positions in half precision, later ones in fixed point. Versions 1 and 2 have rotations of 3 bytes, later ones of 4.
Axes are RUB unless an extension (record of type, size and content) defines others.
"""

import gzip
import logging
import struct
import zlib
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import zstandard

from splatwire.errors import DatasetError
from splatwire.files.read_limited import open_regular, read_at_most
from splatwire.io.formats._axes import SPZ_FLIPS, frame_to_rdf, harmonic_signs, transform_splats
from splatwire.io.formats._columns import build_splats, check_count
from splatwire.io.formats._files import FileBytes, warn_of_bytes_outside
from splatwire.io.formats._spz_extensions import (
    FRAME,
    KNOWN,
    MAX_EXTENSION_BYTES,
    frame_of,
    metadata_of_records,
    origin_of_records,
    records_by_type,
    split_records,
)
from splatwire.io.formats.content import FileContent
from splatwire.ops.spherical_harmonics import MAX_DEGREE
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
GZIP_MAGIC = b"\x1f\x8b"
MAGIC = b"NGSP"
HEADER = struct.Struct("<4sIIBBBB")
ANTIALIASED = 1
EXTENDED, _LEVELS = 2, 128
TABLE_OFFSET, TABLE_ROW = struct.Struct("<I"), struct.Struct("<QQ")
PLAIN_HEADER_BYTES = 32
_MAX_FILE_DEGREE = 4
_MAX_FRACTION_BITS = 24
_MIN_WINDOW, _MAX_WINDOW = 8 << 20, 128 << 20
"""Limits of the window of a zstd stream, bytes; the decoder allocates it. The limit depends on the column size."""
_PIECES_BEHIND, _PIECE_BEHIND = 256, 1 << 16
"""Number and size in bytes of blocks read after the last column to find the end of a gzip stream."""
COLOR_SCALE = 0.15
MAGNITUDE = 511


@dataclass(frozen=True)
class _Header:
    version: int
    count: int
    degree: int
    fraction_bits: int
    flags: int
    streams: int
    extensions: dict[int, bytes] = field(default_factory=dict)

    @property
    def columns(self) -> dict[str, int]:
        """Number of bytes of each column (array of one attribute), in the order of the file."""
        rest = 3 * ((self.degree + 1) ** 2 - 1)
        widths = {"positions": 6 if self.version == 1 else 9, "alphas": 1, "colors": 3, "scales": 3}
        widths["rotations"] = 3 if self.version < 3 else 4
        return {name: width * self.count for name, width in {**widths, "sh": rest}.items() if width}


def read_spz(path: Path) -> FileContent:
    """Reads Gaussians and metadata of an SPZ file of version 1 to 4, in the axis convention that the file declares.

    Harmonics of degree 4 and unknown extensions are dropped with a warning.

    Raises:
        DatasetError: If the file is damaged, of an unsupported version or degree, or too large when decompressed.
        OSError: If the file cannot be read.
    """
    head = read_at_most(path, len(MAGIC), DatasetError)
    if head.startswith(GZIP_MAGIC):
        header, columns = _gunzip(path, path.stat().st_size)
    elif head == MAGIC:
        header, columns = _unzstd(path, FileBytes(path))
    else:
        raise DatasetError(f"{path}: not an SPZ file, it starts with {head!r}")
    _log_left_out(path, header)
    frame = frame_of(path, header.extensions)
    splats = _splats(path, header, columns)
    if frame != FRAME:  # columns were read as RUB: undo this, then convert from the file's convention to RDF
        splats = transform_splats(splats, frame_to_rdf(frame) @ np.diag(SPZ_FLIPS))
    antialiased = bool(header.flags & ANTIALIASED)
    metadata, origin = metadata_of_records(path, header.extensions), origin_of_records(path, header.extensions)
    return FileContent(splats, origin, antialiased, metadata)


def _log_left_out(path: Path, header: _Header) -> None:
    """Logs the parts of an SPZ file that splatwire does not support and therefore ignores."""
    if header.degree > MAX_DEGREE:
        dropped = 3 * ((header.degree + 1) ** 2 - (MAX_DEGREE + 1) ** 2)
        LOG.warning(
            "%s: harmonics of degree %d are read up to degree %d: %d of %d coefficients of each Gaussian are left out",
            path, header.degree, MAX_DEGREE, dropped, 3 * (header.degree + 1) ** 2,
        )  # fmt: skip
    for kind, content in header.extensions.items():
        if kind not in KNOWN:
            LOG.warning(
                "%s: extension 0x%08X of %d bytes is not known and left out: the scene may look different",
                path, kind, len(content),
            )  # fmt: skip


def _log_unread(path: Path, count: int) -> None:
    LOG.warning(
        "%s: %s bytes may be extensions, but its flags name none: they are left out, the scene may look different",
        path, f"{count:,}",
    )  # fmt: skip


def _parse(path: Path, data: bytes | memoryview, file_bytes: int) -> _Header:
    if len(data) < HEADER.size:
        raise DatasetError(f"{path}: the SPZ header ends after {len(data)} bytes")
    magic, version, count, degree, fraction_bits, flags, last = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise DatasetError(f"{path}: what is packed in it starts with {magic!r} and is no SPZ")
    if version not in (1, 2, 3, 4):
        raise DatasetError(f"{path}: SPZ of version {version}; versions 1 to 4 are read")
    if degree > _MAX_FILE_DEGREE:
        raise DatasetError(f"{path}: harmonics of degree {degree}; 0 to {_MAX_FILE_DEGREE} are read")
    if flags & _LEVELS:
        raise DatasetError(f"{path}: an SPZ with coarser levels of Spark in it; export the scene without levels")
    if flags & ~(ANTIALIASED | EXTENDED):
        LOG.warning("%s: flags 0x%02X are not known: the scene may look different", path, flags)
    if fraction_bits > _MAX_FRACTION_BITS:
        raise DatasetError(f"{path}: {fraction_bits} fractional bits of 24 in a position")
    check_count(path, count, file_bytes)
    return _Header(version, count, degree, fraction_bits, flags, last)


def _gunzip(path: Path, file_bytes: int) -> tuple[_Header, dict[str, np.ndarray]]:
    try:
        with open_regular(path, DatasetError) as packed, gzip.open(packed) as file:
            header = _parse(path, file.read(HEADER.size), file_bytes)
            if header.version == 4:
                raise DatasetError(f"{path}: SPZ of version 4 within gzip")
            needed = sum(header.columns.values())
            body = file.read(needed)
            behind = file.read(MAX_EXTENSION_BYTES + 1)
            for _ in range(_PIECES_BEHIND):  # reading to the end verifies the checksum
                if not file.read(_PIECE_BEHIND):
                    break
    except (zlib.error, EOFError, gzip.BadGzipFile) as error:
        raise DatasetError(f"{path}: the gzip data are damaged, or other bytes follow them: {error}") from error
    if len(body) < needed:
        raise DatasetError(f"{path}: the gzip data end after {len(body)} bytes, {needed} were promised")
    if not header.flags & EXTENDED:
        if any(behind):
            _log_unread(path, len(behind))
        behind = b""
    try:
        records = split_records(path, behind)
    except DatasetError as error:  # versions before 4 also had records without a size
        LOG.warning("%s; its extensions are left out: the scene may look different", error)
        records = []
    header = replace(header, extensions=records_by_type(path, records))
    ends = np.cumsum(list(header.columns.values()))
    pieces = np.split(np.frombuffer(body, np.uint8), ends[:-1])
    return header, dict(zip(header.columns, pieces, strict=True))


def _unzstd(path: Path, data: FileBytes) -> tuple[_Header, dict[str, np.ndarray]]:
    header = _parse(path, data[: HEADER.size], len(data))
    if header.version != 4 or len(data) < PLAIN_HEADER_BYTES:
        raise DatasetError(f"{path}: an SPZ header of version {header.version} and {len(data)} bytes, not of version 4")
    (table,) = TABLE_OFFSET.unpack_from(data[HEADER.size : PLAIN_HEADER_BYTES])
    offset = table + header.streams * TABLE_ROW.size
    if header.streams != len(header.columns) or not PLAIN_HEADER_BYTES <= table <= offset <= len(data):
        raise DatasetError(f"{path}: a table of {header.streams} streams at byte {table} is not where it can be")
    if header.flags & EXTENDED:
        records = split_records(path, data[PLAIN_HEADER_BYTES:table])
        header = replace(header, extensions=records_by_type(path, records))
    elif any(data[PLAIN_HEADER_BYTES:table]):
        _log_unread(path, table - PLAIN_HEADER_BYTES)
    columns, rows = {}, TABLE_ROW.iter_unpack(data[table:offset])
    for (name, size), (packed, unpacked) in zip(header.columns.items(), rows, strict=True):
        if unpacked != size:
            raise DatasetError(f"{path}: stream {name} is said to be {packed} bytes for {unpacked}, not for {size}")
        if packed > len(data) - offset:
            raise DatasetError(f"{path}: is cut: stream {name} has {len(data) - offset:,} of {packed:,} bytes")
        columns[name] = _unpack_stream(path, name, data[offset : offset + packed], size)
        offset += packed
    warn_of_bytes_outside(path, len(data) - offset)
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
    color = (columns["colors"].astype(np.float32) / 255 - 0.5) / COLOR_SCALE
    degree = min(header.degree, MAX_DEGREE)
    sh = np.empty((header.count, (degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = color.reshape(-1, 3)
    if "sh" in columns:  # in place, here and below, to limit memory
        sh[:, 1:] = columns["sh"].reshape(header.count, -1, 3)[:, : sh.shape[1] - 1]
        sh[:, 1:] -= 128
        sh[:, 1:] /= 128
    sh *= harmonic_signs(SPZ_FLIPS, degree)[:, None]
    unpack = _three_bytes if header.version < 3 else _smallest_three
    return build_splats(
        path,
        means=_positions(header, columns["positions"]) * np.array(SPZ_FLIPS, np.float32),
        quats=unpack(columns["rotations"]) * np.array((1, *SPZ_FLIPS), np.float32),
        log_scales=columns["scales"].astype(np.float32).reshape(-1, 3) / 16 - 10,
        opacities=columns["alphas"].astype(np.float32) / 255,
        sh=sh,
    )


def _positions(header: _Header, data: np.ndarray) -> np.ndarray:
    """Decodes the positions of an SPZ file in the axes of the file, float32 (N, 3)."""
    if header.version == 1:
        return data.view("<f2").reshape(-1, 3).astype(np.float32)
    low, middle, high = data.astype(np.int32).reshape(-1, 3, 3).transpose(2, 0, 1)
    fixed = (low | middle << 8 | high << 16) - ((high & 128) << 17)
    return fixed / np.float32(1 << header.fraction_bits)


def _three_bytes(data: np.ndarray) -> np.ndarray:
    """Decodes rotations of 3 bytes each (x, y, z), as in versions 1 and 2 of the SPZ format."""
    vector = data.astype(np.float32).reshape(-1, 3) / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - (vector**2).sum(axis=1, keepdims=True)))
    return np.concatenate([w, vector], axis=1)


def _smallest_three(data: np.ndarray) -> np.ndarray:
    """Decodes the 4-byte rotations of SPZ version 3 and above to unit quaternions (w, x, y, z).

    A code contains the index of the largest component of (x, y, z, w), and the values of the three other components.
    """
    packed = data.reshape(-1, 4).view("<u4")[:, 0].copy()
    largest = packed >> 30
    xyzw = np.zeros((len(packed), 4), np.float32)
    for axis in (3, 2, 1, 0):
        other = largest != axis
        value = (packed & MAGNITUDE) / np.float32(MAGNITUDE * 2**0.5)
        xyzw[:, axis] = np.where(other, np.where(packed >> 9 & 1, -value, value), 0)
        packed = np.where(other, packed >> 10, packed)
    rest = np.sqrt(np.maximum(0, 1 - (xyzw**2).sum(axis=1)))
    xyzw[np.arange(len(xyzw)), largest] = rest
    return np.roll(xyzw, 1, axis=1)
