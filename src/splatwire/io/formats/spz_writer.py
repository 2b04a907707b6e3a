"""Writer of SPZ files."""

import gzip
import logging
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import zstandard

from splatwire.errors import InvalidValueError
from splatwire.files.atomic_write import atomic_output
from splatwire.io.formats._axes import SPZ_FLIPS, flip_axes
from splatwire.io.formats._columns import join, rounded_bytes
from splatwire.io.formats._spz_extensions import write_records
from splatwire.io.formats.outliers import (
    DEFAULT,
    VISIBLE_DIVISOR,
    Column,
    Outliers,
    costly_outliers,
    local_scales,
    treated_positions,
    warn_of_clipped,
    warn_of_errors,
    warn_of_outliers,
    warn_of_scales,
)
from splatwire.io.formats.spz import (
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
from splatwire.ops.spherical_harmonics import DC
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
VERSIONS = (3, 4)
"""SPZ versions that can be written."""
_FRACTION_BITS, _MAX_FRACTION_BITS = 12, 24
_MIN_STEPS = 1 << 12
"""Number of position steps from 0 to the farthest coordinate, below which a small scene gets more fraction bits."""
_LOG_SCALES = (-10.0, 255 / 16 - 10)
"""Range of the logarithms of scales."""
_HARMONICS = (-1.0, 127 / 128)
"""Range of the coefficients of harmonics above degree 0."""
_MAX_COORDINATE = (1 << 23) - 1
"""Largest representable coordinate of a position, as a fixed-point integer."""
_ZSTD_LEVEL = 12
FULL_BITS, FEWER_BITS = (8, 8), (5, 4)
"""Bits of spherical harmonics of degree 1 and of higher degrees: full precision, and the precision of the format's
reference software."""


def write_spz(
    parts: Iterable[Splats],
    path: Path,
    harmonic_bits: tuple[int, int] = FULL_BITS,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    metadata: SceneMetadata = NO_METADATA,
    version: int = 4,
    outliers: Outliers = DEFAULT,
) -> int:
    """Writes an SPZ file; spherical harmonics are clipped to the range of the format.

    Args:
        parts: Batches of Gaussians, all of one degree of spherical harmonics.
        path: Path of the file.
        harmonic_bits: Bits per coefficient for spherical harmonics of degree 1, and for those of higher degrees, 1 to 8
            each; fewer bits make the file smaller.
        antialiased: True if the scene was trained with antialiasing; stored in the header.
        origin: World coordinates of the point that positions are relative to; stored next to the metadata.
        metadata: Metadata of the scene.
        version: 4 (zstd), or 3 (gzip) for programs without support for 4.
        outliers: Treatment of a few distant Gaussians that would make all other positions coarse: `clamp`, `prune` or
            `keep`.

    Raises:
        InvalidValueError: If there are no Gaussians, degrees differ, a position is beyond 2**23, or an option is
            invalid.
    """
    if version not in VERSIONS:
        raise InvalidValueError(f"SPZ is written in version 3 or 4, not {version}")
    if not all(1 <= number <= 8 for number in harmonic_bits):
        raise InvalidValueError(f"harmonics of an SPZ have 1 to 8 bits, of degree 1 and beyond, not {harmonic_bits}")
    splats = flip_axes(_treat_outliers(join(path, parts), path, outliers), SPZ_FLIPS)
    warn_of_scales(path, splats.scales, *_LOG_SCALES)
    edge = DC / (2 * COLOR_SCALE)
    warn_of_clipped(path, "base colours", 0.5 + DC * splats.sh[:, 0], 0.5 - edge, 0.5 + edge)
    warn_of_clipped(path, "harmonics", splats.sh[:, 1:], *_HARMONICS)
    bits = _fraction_bits(splats, path)
    columns = [column.tobytes() for column in _columns(splats, bits, harmonic_bits)]
    write = _write_plain if version == 4 else _write_gzip
    records = write_records(metadata, origin)
    flags = ANTIALIASED * antialiased | EXTENDED * bool(records)
    header = (MAGIC, version, splats.num_gaussians, splats.degree, bits, flags)
    with atomic_output(path) as unfinished:
        write(unfinished, columns, header, records)
    return splats.num_gaussians


def _treat_outliers(splats: Splats, path: Path, treatment: Outliers) -> Splats:
    """Moves or removes distant Gaussians (outliers), which would force SPZ to store all positions coarsely.

    Logs a warning if positions stay coarse.

    Args:
        splats: The Gaussians.
        path: The file, for messages.
        treatment: `clamp` to move outliers towards the others, `prune` to remove them, or `keep`.
    """
    farthest = float(np.abs(splats.means).max(initial=0.0))
    if farthest <= _MAX_COORDINATE / 2**_FRACTION_BITS:
        return splats

    def errors(column: Column) -> np.ndarray:
        return np.full(len(column.others), _position_step(float(np.abs(column.others).max())) / 2)

    column = costly_outliers(splats, errors)
    step = _position_step(float(np.abs(column.others).max()))
    limit = _MAX_COORDINATE * step
    inside = bool((np.abs(column.middle) <= limit).all())
    if farthest > limit and inside:
        beyond = np.flatnonzero(np.abs(column.values).max(axis=1) > limit)
        warn_of_outliers(path, treatment, "positions", column, (_position_step(farthest), step), len(beyond))
        splats = treated_positions(splats, treatment, beyond, column.middle, np.full(3, -limit), np.full(3, limit))
    elif step > 2.0**-_FRACTION_BITS:
        LOG.warning(
            "%s: positions are rounded to steps of %.3g instead of %.3g, because they reach %.4g from the origin",
            path, step, 2.0**-_FRACTION_BITS, farthest,
        )  # fmt: skip
    final = np.full(splats.num_gaussians, _position_step(float(np.abs(splats.means).max())) / 2)
    if (final > np.median(splats.scales, axis=1) / VISIBLE_DIVISOR).any():
        warn_of_errors(path, final, local_scales(splats, np.arange(splats.num_gaussians)))
    return splats


def _position_step(farthest: float) -> float:
    """Returns the finest quantisation step with which 24-bit positions cover a scene, world units.

    Args:
        farthest: Largest absolute coordinate of all positions, world units.

    Returns:
        The step, a power of two. The result can exceed 1, the largest step that the format can store.
    """
    return 2.0 ** max(-_FRACTION_BITS, math.ceil(math.log2(max(farthest, 1e-30) / _MAX_COORDINATE)))


def _write_gzip(
    path: Path, columns: list[bytes], header: tuple[bytes, int, int, int, int, int], records: bytes
) -> None:
    path.write_bytes(gzip.compress(b"".join([HEADER.pack(*header, 0), *columns, records]), mtime=0))


def _write_plain(
    path: Path, columns: list[bytes], header: tuple[bytes, int, int, int, int, int], records: bytes
) -> None:
    compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL, write_checksum=True)  # readers recognise damage
    packed = [compressor.compress(column) for column in columns]
    with path.open("wb") as file:
        head = HEADER.pack(*header, len(packed)) + TABLE_OFFSET.pack(PLAIN_HEADER_BYTES + len(records))
        file.write(head.ljust(PLAIN_HEADER_BYTES, b"\0") + records)
        for column, data in zip(columns, packed, strict=True):
            file.write(TABLE_ROW.pack(len(data), len(column)))
        file.writelines(packed)


def _fraction_bits(splats: Splats, path: Path) -> int:
    """Returns the number of fraction bits for storing positions as fixed-point numbers of 24 bits.

    Logs a warning if rounding to this precision is visible, because the Gaussians are small and far from the origin.

    Args:
        splats: The Gaussians.
        path: The file, for messages.

    Raises:
        InvalidValueError: If a coordinate is too large for the format.
    """
    # Other writers always use 12 bits. Large scenes need fewer, so that all positions fit. Scenes that are small, or
    # of small Gaussians far from the origin, are rounded less.
    farthest, bits = float(np.abs(splats.means).max()), _FRACTION_BITS
    largest_error = float(np.median(splats.scales.max(axis=1))) / VISIBLE_DIVISOR
    while bits < _MAX_FRACTION_BITS and (0 < farthest * 2**bits < _MIN_STEPS or 2.0**-bits / 2 > largest_error):
        bits += 1
    while bits and farthest * 2**bits > _MAX_COORDINATE:
        bits -= 1
    if farthest * 2**bits > _MAX_COORDINATE:
        raise InvalidValueError(f"a position of {farthest:g} is too far away for SPZ, which ends at {_MAX_COORDINATE}")
    # With fewer bits, other warnings name the steps. Gaussians too small for the finest steps have a warning of their
    # own (`warn_of_scales`): moving the scene would not help.
    if bits >= _FRACTION_BITS and 2.0**-bits / 2 > largest_error >= 2.0**-_MAX_FRACTION_BITS / 2:
        LOG.warning(
            "%s: positions are rounded to steps of %.3g, and the median size of Gaussians is %.3g: SPZ has no finer "
            "steps for coordinates of up to %.4g, so move the scene to the origin first",
            path, 2.0**-bits, largest_error * VISIBLE_DIVISOR, farthest,
        )  # fmt: skip
    return bits


def _columns(splats: Splats, bits: int, harmonic_bits: tuple[int, int]) -> list[np.ndarray]:
    fixed = np.rint(splats.means.astype(np.float64) * 2**bits).astype("<i4")
    sh = splats.sh
    columns = [
        np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[:, :, :3],
        rounded_bytes(splats.opacities * 255),
        rounded_bytes((sh[:, 0] * COLOR_SCALE + 0.5) * 255),
        rounded_bytes((np.log(splats.scales) + 10) * 16),
        _pack_smallest_three(splats.quats),
        np.concatenate(
            [_quantise_harmonics(sh[:, 1:4], harmonic_bits[0]), _quantise_harmonics(sh[:, 4:], harmonic_bits[1])],
            axis=1,
        ),
    ]
    return [np.ascontiguousarray(column) for column in columns if column.size]


def _quantise_harmonics(values: np.ndarray, bits: int) -> np.ndarray:
    """Quantises spherical harmonics to bytes in which only the `bits` most significant bits can differ from 0."""
    # zero low bits compress better
    step = 1 << (8 - bits)
    return rounded_bytes(np.floor((np.rint(values * 128 + 128) + step / 2) / step) * step)


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
