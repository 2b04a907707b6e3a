"""Axis conventions of the file formats; this package uses the axes of a 3DGS PLY.

Conventions are named by the directions of x, y and z for a camera that looks at the scene: right or left, up or down,
forward or back. A 3DGS PLY is RDF (right, down, forward), as are compressed PLY, SOG, `.splat` and `.ksplat`. SPZ is
RUB, glTF is LUF.
"""

import numpy as np

from splatwire.io.formats._columns import MIN_SIZE
from splatwire.ops.quaternions import quaternions_of, rotation_matrices
from splatwire.ops.spherical_harmonics import sh_basis
from splatwire.types.splats import Splats

SPZ_FLIPS = (1.0, -1.0, -1.0)
"""Signs of x, y and z that convert between RDF and RUB, in both directions."""
GLTF_FLIPS = (-1.0, -1.0, 1.0)
"""Signs of x, y and z that convert between RDF and LUF, in both directions."""


def harmonic_signs(flips: tuple[float, float, float], degree: int) -> np.ndarray:
    """Returns the sign change of each spherical harmonics coefficient if two axes are mirrored, float32 (D).

    Args:
        flips: 1 or -1 for x, y and z, with two of them -1.
        degree: Degree of the harmonics, which have D = (degree + 1) ** 2 coefficients.
    """
    somewhere = np.array([0.36, 0.48, 0.8])  # no basis function is 0 there
    signs = np.rint(sh_basis(somewhere * np.array(flips), degree) / sh_basis(somewhere, degree))
    return signs.astype(np.float32)


def flip_axes(splats: Splats, flips: tuple[float, float, float]) -> Splats:
    """Mirrors Gaussians along two of the three world axes.

    Args:
        splats: The Gaussians.
        flips: 1 or -1 for x, y and z, with two of them -1.
    """
    signs, harmonics = np.array(flips, np.float32), harmonic_signs(flips, splats.degree)
    return Splats(
        means=splats.means * signs,
        quats=splats.quats * np.concatenate([np.ones(1, np.float32), signs]),
        scales=splats.scales,
        opacities=splats.opacities,
        sh=splats.sh * harmonics[:, None],
    )


_TO_RDF = {"R": (0, 1), "L": (0, -1), "D": (1, 1), "U": (1, -1), "F": (2, 1), "B": (2, -1)}
"""Axis of RDF and its sign for each direction letter."""
_SIMILAR = 1e-5
"""Maximum relative difference of a matrix's singular values for it to count as a uniform scaling."""
_ROWS = 1 << 16
"""Number of Gaussians transformed per batch, to bound memory."""


def frame_to_rdf(letters: str) -> np.ndarray:
    """Returns the orthogonal matrix that converts an axis convention to RDF (right, down, forward), float64 (3, 3).

    Args:
        letters: Directions of x, y and z, such as `RUB`.
    """
    matrix = np.zeros((3, 3))
    for column, letter in enumerate(letters):
        row, sign = _TO_RDF[letter]
        matrix[row, column] = sign
    return matrix


def harmonic_transform(orthogonal: np.ndarray, degree: int) -> np.ndarray:
    """Returns the matrix that rotates or mirrors spherical harmonics coefficients, float64 (D, D).

    Args:
        orthogonal: float64 (3, 3), a rotation or a reflection.
        degree: Degree of the harmonics.
    """
    directions = np.random.default_rng(0).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    after = sh_basis(directions, degree)
    before = sh_basis(directions @ orthogonal, degree)
    return np.asarray(np.linalg.lstsq(after, before, rcond=None)[0])


def is_similarity(matrix: np.ndarray) -> bool:
    """True if a matrix (3, 3) scales all directions equally."""
    stretch = np.linalg.svd(matrix, compute_uv=False)
    return bool(stretch[0] - stretch[2] <= _SIMILAR * stretch[0])


def transform_splats(splats: Splats, matrix: np.ndarray, translation: np.ndarray | None = None) -> Splats:
    """Applies an affine transform to Gaussians; spherical harmonics are rotated with the nearest orthogonal matrix.

    Args:
        splats: The Gaussians.
        matrix: Linear part of the transform, float64 (3, 3); must have an element other than 0.
        translation: Translation after the linear part, float64 (3), world units; None for no translation.
    """
    left, stretch, right = np.linalg.svd(matrix)
    orthogonal = left @ right
    harmonics = harmonic_transform(orthogonal, splats.degree)
    similar = is_similarity(matrix)
    transformed = Splats.empty(splats.num_gaussians, splats.degree)
    for begin in range(0, splats.num_gaussians, _ROWS):
        part = splats.slice_range(begin, min(begin + _ROWS, splats.num_gaussians))
        means = part.means.astype(np.float64) @ matrix.T
        if similar:
            # Covariances are invariant to point reflection, so a reflection rotates Gaussians like its negative.
            turn = quaternions_of(orthogonal[None] * np.sign(np.linalg.det(orthogonal)))[0]
            quats, scales = quaternion_product(turn, part.quats.astype(np.float64)), part.scales.astype(np.float64)
            scales = scales * stretch.mean()
        else:
            axes = rotation_matrices(part.quats.astype(np.float64)) * part.scales.astype(np.float64)[:, None, :]
            finite: np.ndarray = np.asarray(np.isfinite(axes).all(axis=(1, 2)))
            turned, scales, _ = np.linalg.svd(np.where(finite[:, None, None], matrix @ axes, 0))
            turned *= np.sign(np.linalg.det(turned))[:, None, None]
            quats = np.where(finite[:, None], quaternions_of(turned), np.nan)
        sh = np.einsum("ij,njc->nic", harmonics, part.sh.astype(np.float64))
        scales = np.maximum(scales, MIN_SIZE)
        moved = means if translation is None else means + translation
        arrays = (moved, quats, scales, part.opacities, sh)
        transformed.fill(begin, Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays)))
    return transformed


def quaternion_product(turn: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """Multiplies quaternions (N, 4) by the quaternion `turn` (4) from the left."""
    w, x, y, z = turn
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(quats @ left.T)
