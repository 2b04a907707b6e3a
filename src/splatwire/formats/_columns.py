"""From the columns of a file to Gaussians: what every reader checks, and how much memory a file may ask for."""

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path

import numpy as np
import torch

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.scene.splats import Splats

MAX_GAUSSIANS = 20_000_000
FREE_GAUSSIANS = 1 << 16
"""So many Gaussians are believed of a file of any size; beyond, each needs at least a byte of file. The densest format
needs ten times that, so that what a file makes a reader hold is at most some 250 times its size."""

MAX_LOG_SCALE = 60.0
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
    if count > max(FREE_GAUSSIANS, file_bytes):
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
    """Checks columns and makes Gaussians of them; quaternions are normalised.

    Args:
        path: The file, for messages.
        means: (N, 3).
        quats: (N, 4), w first, of any length but 0.
        opacities: (N), 0 to 1.
        sh: (N, D, 3) coefficients.
        log_scales: (N, 3) natural logarithms of the standard deviations; or
        scales: (N, 3) the standard deviations.

    Raises:
        DatasetError: If a number is not finite, a size not positive, or a rotation has no direction; the message
            names the Gaussian and the column.
    """
    sizes = scales if log_scales is None else log_scales
    assert sizes is not None
    named = (("position", means), ("rotation", quats), ("opacity", opacities), ("harmonics", sh), ("scale", sizes))
    for name, values in named:
        if len(values) != len(means):
            raise DatasetError(f"{path}: {len(values)} Gaussians have a {name}, {len(means)} a position")
        _refuse(path, name, values, ~np.isfinite(values))
    _refuse(path, "opacity", opacities, (opacities < 0) | (opacities > 1))
    if log_scales is not None:
        _refuse(path, "logarithm of a scale", log_scales, np.abs(log_scales) > MAX_LOG_SCALE)
        sizes = np.exp(log_scales.astype(np.float32))
    _refuse(path, "scale", sizes, sizes <= 0)
    return Splats(
        means=_tensor(means),
        quats=_tensor(unit_quaternions(path, quats)),
        scales=_tensor(sizes),
        opacities=_tensor(opacities),
        sh=_tensor(sh),
    )


def unit_quaternions(path: Path, quats: np.ndarray) -> np.ndarray:
    """Normalises rotations, (N, 4) float64.

    Raises:
        DatasetError: If one has no direction.
    """
    wide = quats.astype(np.float64)
    lengths = np.linalg.norm(wide, axis=1, keepdims=True)
    _refuse(path, "rotation", quats, lengths < _MIN_LENGTH, "of length 0")
    return np.asarray(wide / lengths)


def _refuse(path: Path, name: str, values: np.ndarray, bad: np.ndarray, why: str = "") -> None:
    if not bad.any():
        return
    row = int(np.argwhere(bad)[0, 0])
    found = np.array2string(values[row].ravel()[:4], precision=6, separator=", ")
    raise DatasetError(f"{path}: Gaussian {row} has {found} as {name}{' ' if why else ''}{why}")


def _tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))


def join(path: Path, parts: Iterable[Splats]) -> Splats:
    """Puts parts together for a format that needs to see all Gaussians at once.

    Args:
        path: The file to be, for messages.
        parts: Gaussians of one degree.

    Raises:
        InvalidValueError: If there is no Gaussian, degrees differ, or a number is not one of a Gaussian.
    """
    pieces = list(parts)
    if not sum(part.num_gaussians for part in pieces):
        raise InvalidValueError(f"{path}: there is no Gaussian to write")
    for part in pieces:
        if part.degree != pieces[0].degree:
            raise InvalidValueError(f"Gaussians of degree {part.degree} after those of degree {pieces[0].degree}")
    whole = Splats(**{f.name: torch.cat([getattr(p, f.name) for p in pieces]).detach().cpu() for f in fields(Splats)})
    if not all(torch.isfinite(value).all() for value in vars(whole).values()) or not (whole.scales > 0).all():
        raise InvalidValueError("a Gaussian has a number that is not finite, or a size that is not positive")
    return whole
