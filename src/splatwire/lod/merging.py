"""Replaces Gaussians by fewer ones: the largest are kept, the others are merged with their neighbours."""

import numpy as np

from splatwire.ops.kd_order import kd_order
from splatwire.ops.quaternions import quaternions_of, rotation_matrices
from splatwire.ops.sort3 import sort3
from splatwire.types.splats import Splats

COLOUR = 0.085
"""Weight of colour (harmonics of degree 0) in the distance, relative to the radius of the region."""
MAX_OPAQUE = 0.99
SMALLEST = 1e-12
"""Minimum variance of a merged Gaussian along an axis, relative to its largest variance."""


def footprints(splats: Splats) -> np.ndarray:
    """Returns the largest cross-section area of each Gaussian times its opacity, float64 (N), square world units."""
    return masses(splats.opacities, splats.scales)


def masses(opacities: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Returns the weight of each Gaussian for merging: largest cross-section area times opacity, (N).

    Args:
        opacities: Opacities, (N).
        scales: Standard deviations along the three axes, (N, 3).
    """
    _, middle, largest = sort3(scales.astype(np.float64))
    return opacities.astype(np.float64) * largest * middle


def reduce_gaussians(splats: Splats, count: int, mass: np.ndarray | None = None) -> tuple[Splats, int, float]:
    """Replaces the Gaussians of a region by fewer ones, for views from far away.

    The largest Gaussians are kept; the others are merged with their neighbours.

    Args:
        splats: Gaussians of one region.
        count: Number of Gaussians after reduction, from 1 to the current number.
        mass: Result of `footprints` for these Gaussians; None to compute it.

    Returns:
        Three items: the reduced Gaussians, kept ones first; the number of kept Gaussians; and the error, world units.
        The error is the root mean square distance between the centres of the Gaussians and the centres of their
        replacements, weighted by `mass`.
    """
    mass = footprints(splats) if mass is None else mass
    kept = _num_unchanged(mass, count)
    by_mass = np.argpartition(-mass, kept) if kept else np.arange(len(mass))
    large, rest = np.sort(by_mass[:kept]), np.sort(by_mass[kept:])
    edges = np.arange(count - kept + 1) * len(rest) // (count - kept)
    sort_columns = np.concatenate([_relative(splats.means[rest]), COLOUR * splats.sh[rest, 0]], axis=1)
    rest = rest[kd_order(sort_columns, [edges.astype(np.int64)])]
    merged, squares = _merge_runs(splats.select(rest), mass[rest], edges[:-1])
    both = (splats.select(large), merged)
    joined = {name: np.concatenate([getattr(part, name) for part in both]) for name in vars(splats)}
    return Splats(**joined), kept, float(np.sqrt(squares / max(mass.sum(), 1e-300)))


def _num_unchanged(mass: np.ndarray, count: int) -> int:
    """Returns how many of the largest Gaussians are kept unchanged; all others are merged.

    Args:
        mass: Area times opacity of each Gaussian.
        count: Number of Gaussians after the reduction, kept and merged ones together.
    """
    ordered = -np.sort(-mass)[:count]
    # A Gaussian stays unchanged if it is larger than an average merged Gaussian would be.
    mass_left = np.maximum(mass.sum() - np.append(0, np.cumsum(ordered)[:-1]), 0)
    return min(max(int((ordered > mass_left / (count - np.arange(count))).sum()), 1), count - 1)


def _relative(means: np.ndarray) -> np.ndarray:
    """Normalises positions to mean 0 and a root mean square distance of 1."""
    offsets = means - means.mean(axis=0)
    return offsets / max(float(np.sqrt((offsets.astype(np.float64) ** 2).sum(axis=1).mean())), 1e-30)


def _merge_runs(splats: Splats, mass: np.ndarray, starts: np.ndarray) -> tuple[Splats, float]:
    """Merges groups of consecutive Gaussians, each into one Gaussian.

    Args:
        splats: The Gaussians.
        mass: Weight of each Gaussian in the means: its area times its opacity.
        starts: Index of the first Gaussian of each group.

    Returns:
        The merged Gaussians; and the sum of the weighted squared distances between the centre of each Gaussian and that
        of its replacement.
    """
    weight = np.maximum(mass, 1e-30)
    total = np.add.reduceat(weight, starts)
    sizes = np.diff(np.append(starts, len(mass)))

    def mean(values: np.ndarray) -> np.ndarray:
        shape = (-1, *[1] * (values.ndim - 1))
        return np.add.reduceat(values * weight.reshape(shape), starts) / total.reshape(shape)

    means = splats.means.astype(np.float64)
    centres = mean(means)
    offsets = means - np.repeat(centres, sizes, axis=0)
    covariances = _covariances(splats)
    spread = mean(covariances + offsets[:, :, None] * offsets[:, None, :])
    values, vectors = np.linalg.eigh(spread)
    values = np.maximum(values, SMALLEST * values[:, 2:].clip(min=1e-30))
    scales = np.sqrt(values)
    covered = scales[:, 2] * scales[:, 1]
    opacities = np.minimum(total / covered, MAX_OPAQUE)
    new = {
        "means": centres, "quats": _quaternions(vectors), "scales": scales, "opacities": opacities,
        "sh": mean(splats.sh.astype(np.float64)),
    }  # fmt: skip
    squares = float((mass * (offsets**2).sum(axis=1)).sum())
    return Splats(**{name: column.astype(np.float32) for name, column in new.items()}), squares


def _covariances(splats: Splats) -> np.ndarray:
    """Returns the 3D covariance matrix of each Gaussian, float64 (N, 3, 3)."""
    axes = rotation_matrices(splats.quats.astype(np.float64)) * splats.scales.astype(np.float64)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def _quaternions(axes: np.ndarray) -> np.ndarray:
    """Converts matrices with orthonormal columns, (N, 3, 3), to unit quaternions."""
    # Left-handed matrices are mirrored.
    return quaternions_of(axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None])
