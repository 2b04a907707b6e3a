"""Writes SPZ (see `splatwire.formats.spz`)."""

import gzip
import logging
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import zstandard

from splatwire.errors import InvalidValueError
from splatwire.files.whole import written_whole
from splatwire.formats._axes import SPZ_FLIPS, flip_axes
from splatwire.formats._columns import join
from splatwire.formats._spz_extensions import write_records
from splatwire.formats.outliers import DEFAULT, Outliers, find_outliers, treated_positions, warn_of_outliers
from splatwire.formats.spz import (
    ANTIALIASED,
    COLOR_SCALE,
    EXTENDED,
    HEADER,
    MAGIC,
    MAGNITUDE,
    PLAIN_HEADER_BYTES,
    TABLE_OFFSET,
    TABLE_ROW,
)
from splatwire.scene.metadata import NO_METADATA, SceneMetadata
from splatwire.scene.splats import Splats

LOG = logging.getLogger(__name__)
VERSIONS = (3, 4)
"""Versions that are written."""
_FRACTION_BITS = 12
_MOST = (1 << 23) - 1
"""Largest position, in units of the last fraction bit."""
_ZSTD_LEVEL = 12
FULL_BITS, FEWER_BITS = (8, 8), (5, 4)
"""Bits of harmonics of degree 1, and of those beyond: all that there are, and as the format's own software writes."""


def write_spz(
    parts: Iterable[Splats],
    path: Path,
    harmonic_bits: tuple[int, int] = FULL_BITS,
    *,
    antialiased: bool = False,
    metadata: SceneMetadata = NO_METADATA,
    version: int = 4,
    outliers: Outliers = DEFAULT,
) -> int:
    """Writes an SPZ file; harmonics are cut to their range.

    Args:
        parts: See `splatwire.formats.write_splats`, like `path` and what is returned.
        path: The file.
        harmonic_bits: Bits of harmonics of degree 1, and of those beyond, 1 to 8 each: they stay bytes, of which the
            last bits are 0, so that they pack better.
        antialiased: True if the header is to say that it was trained with antialiasing.
        metadata: Metadata of the scene, written as extension records.
        version: 4 (zstd), or 3 (gzip) for programs that do not read 4 yet.
        outliers: Treatment of few Gaussians whose positions would cost all others precision.

    Raises:
        InvalidValueError: Also if a position is beyond 2**23, or there is no such version or number of bits.
    """
    if version not in VERSIONS:
        raise InvalidValueError(f"SPZ is written in version 3 or 4, not {version}")
    if not all(1 <= number <= 8 for number in harmonic_bits):
        raise InvalidValueError(f"harmonics of an SPZ have 1 to 8 bits, of degree 1 and beyond, not {harmonic_bits}")
    splats = flip_axes(_without_costs(join(path, parts), path, outliers), SPZ_FLIPS)
    bits = _fraction_bits(float(np.abs(splats.means).max()))
    columns = [column.tobytes() for column in _columns(splats, bits, harmonic_bits)]
    write = _write_plain if version == 4 else _write_gzip
    records = write_records(metadata)
    flags = ANTIALIASED * antialiased | EXTENDED * bool(records)
    header = (MAGIC, version, splats.num_gaussians, splats.degree, bits, flags)
    with written_whole(path) as unfinished:
        write(unfinished, columns, header, records)
    return splats.num_gaussians


def _without_costs(splats: Splats, path: Path, treatment: Outliers) -> Splats:
    """Treats outliers that would take fraction bits from the positions of all others; what bits cost is logged."""
    column = find_outliers(splats.means)
    farthest, others = (float(np.abs(some).max()) for some in (column.values, column.others))
    bits = _fraction_bits(others)
    limit = _MOST / 2**bits
    if farthest <= limit:
        if bits < _FRACTION_BITS:
            LOG.warning(
                "%s: positions are rounded to steps of %.3g instead of %.3g, because they reach %.4g from the origin",
                path, 2.0**-bits, 2.0**-_FRACTION_BITS, farthest,
            )  # fmt: skip
        return splats
    beyond = np.flatnonzero(np.abs(column.values).max(axis=1) > limit)
    steps = (2.0 ** math.ceil(math.log2(farthest / _MOST)), 2.0**-bits)
    warn_of_outliers(path, treatment, "positions", column, steps, len(beyond))
    return treated_positions(splats, treatment, beyond, column.middle, np.full(3, -limit), np.full(3, limit))


def _write_gzip(
    path: Path, columns: list[bytes], header: tuple[bytes, int, int, int, int, int], records: bytes
) -> None:
    path.write_bytes(gzip.compress(b"".join([HEADER.pack(*header, 0), *columns, records]), mtime=0))


def _write_plain(
    path: Path, columns: list[bytes], header: tuple[bytes, int, int, int, int, int], records: bytes
) -> None:
    packed = [zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(column) for column in columns]
    with path.open("wb") as file:
        head = HEADER.pack(*header, len(packed)) + TABLE_OFFSET.pack(PLAIN_HEADER_BYTES + len(records))
        file.write(head.ljust(PLAIN_HEADER_BYTES, b"\0") + records)
        for column, data in zip(columns, packed, strict=True):
            file.write(TABLE_ROW.pack(len(data), len(column)))
        file.writelines(packed)


def _fraction_bits(farthest: float) -> int:
    """12 as other writers, fewer where positions would not fit into 24 bits."""
    bits = _FRACTION_BITS
    while bits and farthest * 2**bits > _MOST:
        bits -= 1
    if farthest * 2**bits > _MOST:
        raise InvalidValueError(f"a position of {farthest:g} is too far away for SPZ, which ends at {_MOST}")
    return bits


def _columns(splats: Splats, bits: int, harmonic_bits: tuple[int, int]) -> list[np.ndarray]:
    fixed = np.rint(splats.means.astype(np.float64) * 2**bits).astype("<i4")
    sh = splats.sh
    columns = [
        np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[:, :, :3],
        _byte(splats.opacities * 255),
        _byte((sh[:, 0] * COLOR_SCALE + 0.5) * 255),
        _byte((np.log(splats.scales) + 10) * 16),
        _pack_smallest_three(splats.quats),
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
    magnitudes = np.rint(np.abs(xyzw) * (MAGNITUDE * 2**0.5)).clip(0, MAGNITUDE).astype(np.uint32)
    for axis in range(4):
        field = np.where(xyzw[:, axis] < 0, np.uint32(512), np.uint32(0)) | magnitudes[:, axis]
        packed = np.where(largest != axis, packed << np.uint32(10) | field, packed)
    return packed.astype("<u4")
