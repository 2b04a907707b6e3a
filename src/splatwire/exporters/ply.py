"""Writes the PLY files of 3DGS, which nearly every splat viewer opens."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.exporters._files import complete_file
from splatwire.scene.splats import Splats

_COUNT_DIGITS = 12
_MIN_OPACITY = 1e-6
"""Opacities are kept this far from 0 and 1, where the logit is infinite."""


def write_ply(parts: Iterable[Splats], path: Path) -> int:
    """Writes Gaussians part by part, so that they never have to be in memory together.

    Properties, all float32: `x y z nx ny nz f_dc_0..2 f_rest_0.. opacity scale_0..2 rot_0..3`. Normals are 0, `f_rest`
    holds all coefficients of red, then green, then blue, `opacity` is a logit, `scale` a natural logarithm and `rot` a
    quaternion (w, x, y, z). Axes stay those of the scene.

    Args:
        parts: The Gaussians, all of one degree; may be a generator.
        path: The file; it appears under its name when it is complete.

    Returns:
        How many Gaussians were written.

    Raises:
        InvalidValueError: If there is none, a number is not finite, or degrees differ.
        OSError: If the file cannot be written.
    """
    count, degree = 0, None
    with complete_file(path) as file:
        for part in parts:
            if degree is None:
                degree = part.degree
                file.write(_header(0, degree))
            if part.degree != degree:
                raise InvalidValueError(f"Gaussians of degree {part.degree} after those of degree {degree}")
            file.write(_rows(part).astype("<f4").tobytes())
            count += part.num_gaussians
        if degree is None or not count:
            raise InvalidValueError(f"{path}: there is no Gaussian to write")
        file.seek(0)
        file.write(_header(count, degree))
    return count


def property_names(degree: int) -> list[str]:
    """Returns the names of the properties, in the order of the file."""
    rest = 3 * ((degree + 1) ** 2 - 1)
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def _header(count: int, degree: int) -> bytes:
    """The header; a comment fills it up, so that it is equally long whatever the count."""
    digits = str(count)
    lines = ["ply", "format binary_little_endian 1.0", "comment splatwire" + "." * (_COUNT_DIGITS - len(digits))]
    lines += [f"element vertex {digits}", *(f"property float {name}" for name in property_names(degree))]
    return ("\n".join(lines) + "\nend_header\n").encode("ascii")


def _rows(part: Splats) -> np.ndarray:
    means, quats, scales, sh = (t.detach().cpu().numpy() for t in (part.means, part.quats, part.scales, part.sh))
    opacities = part.opacities.detach().cpu().double().clamp(_MIN_OPACITY, 1 - _MIN_OPACITY)
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(len(means), -1)
    logits = opacities.logit().numpy()[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(scales)
    rows = np.concatenate([means, np.zeros_like(means), sh[:, 0], rest, logits, logs, quats], axis=1)
    if not np.isfinite(rows).all():
        raise InvalidValueError("a Gaussian has a number that is not finite, or a size that is not positive")
    return rows
