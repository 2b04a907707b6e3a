"""Axes of the formats: ours are those of a 3DGS PLY.

Formats are named by where x, y and z point for a camera that looks at the scene: right or left, up or down, forward or
back. A 3DGS PLY is RDF, as are compressed PLY, SOG, `.splat` and `.ksplat`; SPZ is RUB, glTF is LUF. Between two of
these are two flipped axes, that is half a turn. Frames that a file names itself, and the nodes of a glTF, may also
turn, reflect, scale and stretch Gaussians.
"""

import numpy as np

from splatwire.ops.quaternions import quaternions_of, rotation_matrices
from splatwire.ops.spherical_harmonics import sh_basis
from splatwire.scene.splats import Splats

SPZ_FLIPS = (1.0, -1.0, -1.0)
"""From RDF to RUB and back."""
GLTF_FLIPS = (-1.0, -1.0, 1.0)
"""From RDF to LUF and back."""


def harmonic_signs(flips: tuple[float, float, float], degree: int) -> np.ndarray:
    """What flipping two axes does to the coefficients of a degree: 1 or -1 for each, float32."""
    somewhere = np.array([0.36, 0.48, 0.8])  # no basis function is 0 there
    signs = np.rint(sh_basis(somewhere * np.array(flips), degree) / sh_basis(somewhere, degree))
    return signs.astype(np.float32)


def flip_axes(splats: Splats, flips: tuple[float, float, float]) -> Splats:
    """Flips two of three axes of the world; its own inverse.

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
"""Axis of RDF and sign on it for each direction that a letter names."""
_SIMILAR = 1e-5
"""Relative difference of singular values below which a matrix scales all directions alike."""
_ROWS = 1 << 16
"""Gaussians that are transformed at a time."""


def frame_to_rdf(letters: str) -> np.ndarray:
    """Matrix from a frame to RDF, float64 (3, 3), orthogonal; a reflection where the frame has the other handedness.

    Args:
        letters: Directions of x, y and z, such as `RUB`.
    """
    matrix = np.zeros((3, 3))
    for column, letter in enumerate(letters):
        row, sign = _TO_RDF[letter]
        matrix[row, column] = sign
    return matrix


def harmonic_transform(orthogonal: np.ndarray, degree: int) -> np.ndarray:
    """Matrix that turns harmonics' coefficients with the world, float64 (D, D).

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
    """True if a matrix (3, 3) scales all directions alike."""
    stretch = np.linalg.svd(matrix, compute_uv=False)
    return bool(stretch[0] - stretch[2] <= _SIMILAR * stretch[0])


def transform_splats(splats: Splats, matrix: np.ndarray, translation: np.ndarray | None = None) -> Splats:
    """Applies an affine map of the world to Gaussians.

    Covariances are exact for every matrix. Harmonics turn with the nearest orthogonal matrix, which is exact
    for rotations, reflections and equal scales on all axes.

    Args:
        splats: The Gaussians.
        matrix: float64 (3, 3), not 0.
        translation: float64 (3), world units; none where absent.
    """
    left, stretch, right = np.linalg.svd(matrix)
    orthogonal = left @ right
    harmonics = harmonic_transform(orthogonal, splats.degree)
    similar = is_similarity(matrix)
    found = Splats.empty(splats.num_gaussians, splats.degree)
    for begin in range(0, splats.num_gaussians, _ROWS):
        part = splats.run(begin, min(begin + _ROWS, splats.num_gaussians))
        means = part.means.astype(np.float64) @ matrix.T
        if similar:
            # A point reflection changes no covariance, so a reflection turns Gaussians as its negative does.
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
        moved = means if translation is None else means + translation
        arrays = (moved, quats, scales, part.opacities, sh)
        found.fill(begin, Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays)))
    return found


def quaternion_product(turn: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """Quaternions (w, x, y, z) of the rotations `quats` (N, 4) followed by `turn` (4), float64 (N, 4)."""
    w, x, y, z = turn
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(quats @ left.T)
