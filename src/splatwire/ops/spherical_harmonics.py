"""Real spherical harmonics up to degree 3, in the order and with the signs of the 3DGS file format."""

import math
import operator
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.errors import InvalidValueError, shown

MAX_DEGREE = 3
DC = 0.5 / math.sqrt(math.pi)
"""Value of the constant basis function."""


def num_functions(degree: int) -> int:
    """Returns the number of basis functions of spherical harmonics up to `degree`.

    Raises:
        InvalidValueError: If the degree is not 0 to 3.
    """
    try:
        number = -1 if isinstance(degree, bool) else operator.index(degree)
    except TypeError:
        number = -1
    if not 0 <= number <= MAX_DEGREE:
        raise InvalidValueError(f"spherical harmonics of degree 0 to {MAX_DEGREE} are supported, not {shown(degree)}")
    return (number + 1) ** 2


def degree_of(functions: int) -> int:
    """Returns the degree of spherical harmonics with a given number of basis functions.

    Raises:
        InvalidValueError: If no supported degree has this number.
    """
    degree = math.isqrt(max(functions, 0)) - 1
    if not 0 <= degree <= MAX_DEGREE or (degree + 1) ** 2 != functions:
        raise InvalidValueError(f"{functions} coefficients are not those of a degree from 0 to {MAX_DEGREE}")
    return degree


def sh_basis(directions: Float[np.ndarray, "*batch 3"], degree: int) -> Float[np.ndarray, "*batch D"]:
    """Evaluates the basis functions of spherical harmonics in given directions, with the order and signs of 3DGS.

    The functions are ordered by l, and then by m from -l to l.

    Args:
        directions: Unit vectors; in 3DGS from the camera to the Gaussian, world axes.
        degree: 0 to 3.

    Raises:
        InvalidValueError: If the degree is not supported.
    """
    num_functions(degree)
    parts = sh_functions(directions[..., 0], directions[..., 1], directions[..., 2], degree)
    return np.stack(parts, axis=-1)


def sh_functions(x: Any, y: Any, z: Any, degree: int) -> list[Any]:
    """Evaluates the basis functions of spherical harmonics (`sh_basis`) for numpy arrays or torch tensors.

    Args:
        x: First components of unit vectors.
        y: Second components, of the same shape.
        z: Third components, of the same shape.
        degree: 0 to 3.

    Returns:
        `(degree + 1) ** 2` arrays of the shape of `x`.
    """
    parts = [x * 0 + DC]
    if degree >= 1:
        first = math.sqrt(3 / (4 * math.pi))
        parts += [-first * y, first * z, -first * x]
    if degree >= 2:
        cross, polar = math.sqrt(15 / (4 * math.pi)), math.sqrt(5 / (16 * math.pi))
        parts += [cross * x * y, -cross * y * z, polar * (2 * z * z - x * x - y * y)]
        parts += [-cross * x * z, cross / 2 * (x * x - y * y)]
    if degree >= 3:
        outer, middle = math.sqrt(35 / (32 * math.pi)), math.sqrt(21 / (32 * math.pi))
        mixed, polar = math.sqrt(105 / (4 * math.pi)), math.sqrt(7 / (16 * math.pi))
        parts += [-outer * y * (3 * x * x - y * y), mixed * x * y * z, -middle * y * (4 * z * z - x * x - y * y)]
        parts += [polar * z * (2 * z * z - 3 * x * x - 3 * y * y), -middle * x * (4 * z * z - x * x - y * y)]
        parts += [mixed / 2 * z * (x * x - y * y), -outer * x * (x * x - 3 * y * y)]
    return parts
