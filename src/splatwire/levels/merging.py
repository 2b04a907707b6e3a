"""Few Gaussians in the place of many: the large ones stay, and the rest are merged with those beside them."""

import numpy as np

from splatwire.ops.kd_order import kd_order
from splatwire.ops.quaternions import quaternions_of, rotation_matrices
from splatwire.ops.rising import rising
from splatwire.scene.splats import Splats

COLOUR = 0.085
"""How far apart a difference in colour puts two Gaussians, harmonics of degree 0 against the radius of their region."""
MOST_OPAQUE = 0.99
SMALLEST = 1e-12
"""Variance along an axis, relative to the largest of a merged Gaussian."""


def footprints(splats: Splats) -> np.ndarray:
    """What each Gaussian covers from its broad side, times its opacity: float64 (N), square world units."""
    return masses(splats.opacities, splats.scales)


def masses(opacities: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """`footprints` of plain arrays, (N) and (N, 3)."""
    _, middle, largest = rising(scales.astype(np.float64))
    return opacities.astype(np.float64) * largest * middle


def reduced(splats: Splats, count: int, mass: np.ndarray | None = None) -> tuple[Splats, int, float]:
    """Stands in for Gaussians that are seen from far away.

    What covers more than a group does stays as it is. A group of neighbours, the leaf of a k-d tree, becomes one
    Gaussian with their mean, covariance and colour, each weighted by what it covers; together they cover as much.

    Args:
        splats: Gaussians of one region.
        count: How many are wanted, at least 1 and at most as many as there are.
        mass: Their `footprints`; None where nobody asked for them before.

    Returns:
        They; how many of them, the first ones, are old ones; and the error: root of the mean square distance between a
        Gaussian's centre and that of what stands for it, by what each covers, world units.
    """
    mass = footprints(splats) if mass is None else mass
    kept = _kept(mass, count)
    by_mass = np.argpartition(-mass, kept) if kept else np.arange(len(mass))
    large, rest = np.sort(by_mass[:kept]), np.sort(by_mass[kept:])
    edges = np.arange(count - kept + 1) * len(rest) // (count - kept)
    alike = np.concatenate([_relative(splats.means[rest]), COLOUR * splats.sh[rest, 0]], axis=1)
    rest = rest[kd_order(alike, [edges.astype(np.int64)])]
    merged, squares = _merged(splats.select(rest), mass[rest], edges[:-1])
    both = (splats.select(large), merged)
    joined = {name: np.concatenate([getattr(part, name) for part in both]) for name in vars(splats)}
    return Splats(**joined), kept, float(np.sqrt(squares / max(mass.sum(), 1e-300)))


def _kept(mass: np.ndarray, count: int) -> int:
    """How many stay: those that cover more than a group of the rest would, at least one if there is to be a second."""
    ordered = -np.sort(-mass)[:count]
    left = np.maximum(mass.sum() - np.append(0, np.cumsum(ordered)[:-1]), 0)
    return min(max(int((ordered > left / (count - np.arange(count))).sum()), 1), count - 1)


def _relative(means: np.ndarray) -> np.ndarray:
    """Places from the middle of all, in units of the root of their mean square distance from it."""
    apart = means - means.mean(axis=0)
    return apart / max(float(np.sqrt((apart.astype(np.float64) ** 2).sum(axis=1).mean())), 1e-30)


def _merged(splats: Splats, mass: np.ndarray, starts: np.ndarray) -> tuple[Splats, float]:
    """One Gaussian for each run that begins at `starts`, and the sum of mass times squared distance from it."""
    weight = np.maximum(mass, 1e-30)
    total = np.add.reduceat(weight, starts)
    sizes = np.diff(np.append(starts, len(mass)))

    def mean(values: np.ndarray) -> np.ndarray:
        shape = (-1, *[1] * (values.ndim - 1))
        return np.add.reduceat(values * weight.reshape(shape), starts) / total.reshape(shape)

    means = splats.means.astype(np.float64)
    centres = mean(means)
    apart = means - np.repeat(centres, sizes, axis=0)
    own = _covariances(splats)
    spread = mean(own + apart[:, :, None] * apart[:, None, :])
    values, vectors = np.linalg.eigh(spread)
    values = np.maximum(values, SMALLEST * values[:, 2:].clip(min=1e-30))
    scales = np.sqrt(values)
    covered = scales[:, 2] * scales[:, 1]
    opacities = np.minimum(total / covered, MOST_OPAQUE)
    new = {
        "means": centres, "quats": _quaternions(vectors), "scales": scales, "opacities": opacities,
        "sh": mean(splats.sh.astype(np.float64)),
    }  # fmt: skip
    squares = float((mass * (apart**2).sum(axis=1)).sum())
    return Splats(**{name: column.astype(np.float32) for name, column in new.items()}), squares


def _covariances(splats: Splats) -> np.ndarray:
    """Covariance of each Gaussian, float64 (N, 3, 3)."""
    axes = rotation_matrices(splats.quats.astype(np.float64)) * splats.scales.astype(np.float64)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def _quaternions(axes: np.ndarray) -> np.ndarray:
    """Unit quaternions of orthonormal columns, (N, 3, 3), mirrored where they are left-handed."""
    return quaternions_of(axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None])
