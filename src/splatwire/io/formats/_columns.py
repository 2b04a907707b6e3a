"""Conversion of file columns to Gaussians: validation and memory limits shared by all readers."""

import logging
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.ops.spherical_harmonics import num_functions
from splatwire.types.splats import CHUNK_GAUSSIANS, Splats
from splatwire.types.validity import invalid_fields, validity_of_splats

LOG = logging.getLogger(__name__)
MAX_GAUSSIANS = 20_000_000
FREE_GAUSSIANS = 1 << 18
"""Number of Gaussians accepted for a file of any size; with harmonics of degree 3 they take 62 MB of memory."""
BYTES_PER_GAUSSIAN = 4
"""Minimum file size per Gaussian beyond `FREE_GAUSSIANS`, bytes; the densest known files have 7. A Gaussian with
harmonics of degree 3 takes 236 bytes of memory, 59 times this size."""

MAX_LOG_SCALE = 60.0
"""Limit of log scales: smaller sizes are raised to `exp(-60)`, larger ones than `exp(60)` are invalid."""
MIN_SIZE = np.float32(np.exp(-MAX_LOG_SCALE))
"""Minimum size; smaller sizes are raised to it."""
_ROUNDING = 1e-3
"""Largest distance of opacities from the range 0 to 1 that is attributed to rounding; above it a warning is logged."""
_OPACITY_ERROR = 1e-6
"""Largest rounding error of opacities to be written, which are clipped to 0 to 1."""
_MIN_LENGTH = 1e-12
"""Length below which a quaternion has no direction, as in 3DGS."""


def check_count(path: Path, count: int, num_bytes: int) -> int:
    """Checks the number of Gaussians in a header before memory is allocated.

    Args:
        path: The file, for messages.
        count: Number of Gaussians according to the header.
        num_bytes: Number of bytes that hold the Gaussians: size of the file before decompression; for PLY, of its rows.

    Raises:
        DatasetError: If the number is 0, above the limit, or too large for the number of bytes.
    """
    if not 0 < count <= MAX_GAUSSIANS:
        raise DatasetError(f"{path}: a count of {count} Gaussians is not in 1 to {MAX_GAUSSIANS}")
    if count > max(FREE_GAUSSIANS, num_bytes // BYTES_PER_GAUSSIAN):
        raise DatasetError(f"{path}: a count of {count} Gaussians is more than {num_bytes} bytes of file can hold")
    return count


def build_splats(
    path: Path,
    *,
    means: np.ndarray,
    quats: np.ndarray,
    opacities: np.ndarray,
    sh: np.ndarray,
    log_scales: np.ndarray | None = None,
    scales: np.ndarray | None = None,
) -> Splats:
    """Builds Gaussians from the arrays of a file with one row per Gaussian.

    Quaternions are normalised and opacities are clipped to [0, 1]. Invalid values become NaN or infinite, or stay so;
    `validity_of_splats` finds them.

    Args:
        path: The file, for messages.
        means: (N, 3).
        quats: (N, 4), w first, of any length.
        opacities: (N), 0 to 1.
        sh: (N, D, 3) coefficients.
        log_scales: (N, 3) natural logarithms of the standard deviations; None if `scales` is given instead.
        scales: (N, 3) standard deviations; None if `log_scales` is given instead.

    Raises:
        DatasetError: If columns have different lengths.
    """
    sizes = _sizes(scales) if log_scales is None else _sizes_of_logs(log_scales)
    named = (("rotation", quats), ("opacity", opacities), ("harmonics", sh), ("scale", sizes))
    for name, values in named:
        if len(values) != len(means):
            raise DatasetError(f"{path}: {len(values)} Gaussians have a {name}, {len(means)} a position")
    quats64 = quats.astype(np.float64)
    lengths = np.linalg.norm(quats64, axis=1, keepdims=True)
    lengths[lengths < _MIN_LENGTH] = np.nan
    return Splats(
        means=_column(means),
        quats=_column(quats64 / lengths),
        scales=_column(sizes),
        opacities=_column(np.clip(opacities, 0, 1)),
        sh=_column(sh),
    )


def warn_of_logits(path: Path, opacities: np.ndarray, kind: str) -> None:
    """Logs a warning if opacities are outside of 0 to 1, because they are then probably logits.

    Args:
        path: The file.
        opacities: Opacities (N).
        kind: Name of the format.
    """
    outside = int(((opacities < -_ROUNDING) | (opacities > 1 + _ROUNDING)).sum())
    if outside:
        LOG.warning(
            "%s: %s of %s opacities are outside of 0 to 1, so they may be logits: they are clipped to 0 to 1, as "
            "%s has opacities themselves", path, f"{outside:,}", f"{len(opacities):,}", kind,
        )  # fmt: skip


def _sizes(scales: np.ndarray | None) -> np.ndarray:
    """Returns standard deviations, with small ones raised to `MIN_SIZE` and negative ones replaced by NaN."""
    assert scales is not None
    wide = np.asarray(scales, np.float32)
    return np.where(wide < 0, np.nan, np.maximum(wide, MIN_SIZE))


def _sizes_of_logs(logs: np.ndarray) -> np.ndarray:
    """Converts natural logarithms of standard deviations to standard deviations."""
    return np.exp(np.where(logs > MAX_LOG_SCALE, np.inf, np.maximum(logs, -MAX_LOG_SCALE)).astype(np.float32))


def _column(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float32)


def concatenate(parts: Sequence[Splats]) -> Splats:
    """Concatenates Gaussians, with spherical harmonics of the highest degree among them."""
    if len(parts) == 1:
        return parts[0]
    joined = Splats.empty(sum(part.num_gaussians for part in parts), max(part.degree for part in parts))
    offset = 0
    for part in parts:
        for begin in range(0, part.num_gaussians, CHUNK_GAUSSIANS):
            rows = part.slice_range(begin, min(begin + CHUNK_GAUSSIANS, part.num_gaussians))
            joined.fill(offset, of_degree(rows, joined.degree))
            offset += rows.num_gaussians
    return joined


def of_degree(splats: Splats, degree: int) -> Splats:
    """Returns Gaussians with harmonics padded with zeros to a higher degree."""
    missing = num_functions(degree) - splats.sh.shape[1]
    return splats if not missing else replace(splats, sh=np.pad(splats.sh, ((0, 0), (0, missing), (0, 0))))


def checked_batches(path: Path, batches: Iterable[Splats]) -> Iterator[Splats]:
    """Yields the non-empty batches of Gaussians, after checking their values and normalising their quaternions.

    Args:
        path: Path of the output, for messages.
        batches: Batches of Gaussians, all of one degree of spherical harmonics.

    Raises:
        InvalidValueError: If there is no Gaussian, degrees differ, or a value is invalid, such as an opacity above 1.
    """
    degree, count = None, 0
    for part in batches:
        if not part.num_gaussians:
            continue
        degree = part.degree if degree is None else degree
        if part.degree != degree:
            raise InvalidValueError(f"Gaussians of degree {part.degree} after those of degree {degree}")
        part = _with_rounded_opacities(part)
        validity = validity_of_splats(part)
        first = int((part.opacities < 0).argmax()) if (part.opacities < 0).any() else part.num_gaussians
        first = first if validity.first_invalid is None else min(first, validity.first_invalid)
        if first < part.num_gaussians:
            names = dict.fromkeys(invalid_fields(part) + ["opacities"] * bool((part.opacities < 0).any()))
            raise InvalidValueError(
                f"{path}: {' and '.join(names)} of Gaussians are invalid (the first is row {count + first}): numbers "
                "must be finite, scales above 0, rotations not 0, and opacities from 0 to 1, not logits"
            )
        count += part.num_gaussians
        yield part.with_unit_quats()
    if degree is None:
        raise InvalidValueError(f"{path}: there is no Gaussian to write")


def _with_rounded_opacities(splats: Splats) -> Splats:
    """Clips opacities that differ from the range 0 to 1 by a rounding error only."""
    opacities = splats.opacities
    outside = (opacities < 0) | (opacities > 1)
    rounding_error = outside & (opacities >= -_OPACITY_ERROR) & (opacities <= 1 + _OPACITY_ERROR)
    return (
        replace(splats, opacities=np.where(rounding_error, opacities.clip(0, 1), opacities))
        if rounding_error.any()
        else splats
    )


def join(path: Path, batches: Iterable[Splats]) -> Splats:
    """Concatenates batches of Gaussians for a format that needs all of them at once.

    Args:
        path: Path of the output, for messages.
        batches: Batches of Gaussians, all of one degree of spherical harmonics.

    Raises:
        InvalidValueError: If there is no Gaussian, degrees differ, or a value is invalid.
    """
    pieces = list(checked_batches(path, batches))
    return Splats(**{f.name: np.concatenate([getattr(p, f.name) for p in pieces]) for f in fields(Splats)})


def rounded_bytes(values: np.ndarray) -> np.ndarray:
    """Rounds values to integers and clips them to 0 to 255, uint8."""
    return np.rint(values).clip(0, 255).astype(np.uint8)
