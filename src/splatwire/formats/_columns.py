"""From the columns of a file to Gaussians: what every reader checks, and how much memory a file may ask for."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.ops.spherical_harmonics import num_functions
from splatwire.scene.splats import ROWS, Splats

MAX_GAUSSIANS = 20_000_000
FREE_GAUSSIANS = 1 << 18
"""So many Gaussians are believed of a file of any size: with harmonics of degree 3 they take 62 MB."""
BYTES_PER_GAUSSIAN = 4
"""So many bytes of file each needs beyond; the densest files that programs write have 7. With harmonics of degree 3 one
takes 236 in memory, so that what a file makes a reader hold is at most some 120 times its size."""

MAX_LOG_SCALE = 60.0
"""Sizes are `exp` of minus this at least; what is larger than `exp` of this is no size."""
_MIN_LENGTH = 1e-6


def check_count(path: Path, count: int, file_bytes: int) -> int:
    """Checks the number of Gaussians that a header promises before memory is taken for them.

    Args:
        path: The file, for messages.
        count: What its header says.
        file_bytes: How large the file is, packed.

    Raises:
        DatasetError: If it is 0, above the limit, or more than such a file can hold.
    """
    if not 0 < count <= MAX_GAUSSIANS:
        raise DatasetError(f"{path}: a count of {count} Gaussians is not in 1 to {MAX_GAUSSIANS}")
    if count > max(FREE_GAUSSIANS, file_bytes // BYTES_PER_GAUSSIAN):
        raise DatasetError(f"{path}: a count of {count} Gaussians is more than {file_bytes} bytes of file can hold")
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
    """Makes Gaussians of the columns of a file, a row for each of its own; quaternions are normalised.

    Numbers at the end of what can be are moved to it: opacities into 0 to 1, sizes of 0 to the smallest. Which rows
    are Gaussians that can be drawn is not asked here (`splatwire.scene.rows`); what is impossible becomes NaN.

    Args:
        path: The file, for messages.
        means: (N, 3).
        quats: (N, 4), w first, of any length.
        opacities: (N), 0 to 1.
        sh: (N, D, 3) coefficients.
        log_scales: (N, 3) natural logarithms of the standard deviations; or
        scales: (N, 3) the standard deviations.

    Raises:
        DatasetError: If columns have different lengths.
    """
    sizes = _sizes(scales) if log_scales is None else _sizes_of_logs(log_scales)
    named = (("rotation", quats), ("opacity", opacities), ("harmonics", sh), ("scale", sizes))
    for name, values in named:
        if len(values) != len(means):
            raise DatasetError(f"{path}: {len(values)} Gaussians have a {name}, {len(means)} a position")
    wide = quats.astype(np.float64)
    lengths = np.linalg.norm(wide, axis=1, keepdims=True)
    lengths[lengths < _MIN_LENGTH] = np.nan
    return Splats(
        means=_column(means),
        quats=_column(wide / lengths),
        scales=_column(sizes),
        opacities=_column(np.clip(opacities, 0, 1)),
        sh=_column(sh),
    )


def _sizes(scales: np.ndarray | None) -> np.ndarray:
    """Standard deviations, those of 0 the smallest that there are."""
    assert scales is not None
    wide = np.asarray(scales, np.float32)
    return np.where(wide < 0, np.nan, np.maximum(wide, np.float32(np.exp(-MAX_LOG_SCALE))))


def _sizes_of_logs(logs: np.ndarray) -> np.ndarray:
    """The same of logarithms, of which those of -inf are sizes of 0."""
    return np.exp(np.where(logs > MAX_LOG_SCALE, np.inf, np.maximum(logs, -MAX_LOG_SCALE)).astype(np.float32))


def _column(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float32)


def concatenate(parts: Sequence[Splats]) -> Splats:
    """All Gaussians of some parts, at least one, with harmonics of the highest degree among them.

    Missing harmonics are 0, so that Gaussians of a lower degree look as they did.
    """
    if len(parts) == 1:
        return parts[0]
    found = Splats.empty(sum(part.num_gaussians for part in parts), max(part.degree for part in parts))
    at = 0
    for part in parts:
        for begin in range(0, part.num_gaussians, ROWS):
            run = part.run(begin, min(begin + ROWS, part.num_gaussians))
            found.fill(at, of_degree(run, found.degree))
            at += run.num_gaussians
    return found


def of_degree(splats: Splats, degree: int) -> Splats:
    """Gaussians with harmonics of a degree that is not lower than theirs; new ones are 0."""
    missing = num_functions(degree) - splats.sh.shape[1]
    return splats if not missing else replace(splats, sh=np.pad(splats.sh, ((0, 0), (0, missing), (0, 0))))


def filled(path: Path, parts: Iterable[Splats]) -> Iterator[Splats]:
    """The parts that have any Gaussians, for writers, as they come.

    Args:
        path: The file to be, for messages.
        parts: Gaussians of one degree.

    Raises:
        InvalidValueError: If there is no Gaussian, or degrees differ.
    """
    degree = None
    for part in parts:
        if not part.num_gaussians:
            continue
        degree = part.degree if degree is None else degree
        if part.degree != degree:
            raise InvalidValueError(f"Gaussians of degree {part.degree} after those of degree {degree}")
        yield part
    if degree is None:
        raise InvalidValueError(f"{path}: there is no Gaussian to write")


def join(path: Path, parts: Iterable[Splats]) -> Splats:
    """Puts parts together for a format that needs to see all Gaussians at once.

    Args:
        path: The file to be, for messages.
        parts: Gaussians of one degree.

    Raises:
        InvalidValueError: If there is no Gaussian, degrees differ, or a number is not one of a Gaussian.
    """
    pieces = list(filled(path, parts))
    whole = Splats(**{f.name: np.concatenate([getattr(p, f.name) for p in pieces]) for f in fields(Splats)})
    if not all(np.isfinite(value).all() for value in vars(whole).values()) or not (whole.scales > 0).all():
        raise InvalidValueError("a Gaussian has a number that is not finite, or a size that is not positive")
    return whole
