"""Gaussians as integers, and integers as Gaussians.

Only an encoder computes with floats before there are symbols; a decoder turns integers into floats once, at the end.
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatwire.codec.schemas.gaussians.blocks import runs
from splatwire.codec.schemas.gaussians.layout import (
    AXIS,
    BITS,
    COLUMNS,
    LATTICE,
    LUMA,
    MAX_COLOUR,
    MAX_LOG,
    MAX_OPACITY,
    MIN_OPACITY,
    OPACITY,
    PRIMARY,
    SCALE0,
    SCALE1,
    SCALE2,
    SPIN,
    SPIN_BITS,
    TRANSFORM_UNIT,
)
from splatwire.codec.schemas.gaussians.tables import power_of_two, thinness_table
from splatwire.ops.order_statistics import middle_ranks, order_statistics
from splatwire.ops.quaternions import quaternions_of, rotation_matrices
from splatwire.ops.rising import rising
from splatwire.ops.spherical_harmonics import DC
from splatwire.scene.splats import Splats

LUMA_CHROMA = np.array([[1, 1, 1], [1, 0, -1], [-1, 2, -1]]) / np.sqrt([[3.0], [2.0], [6.0]])
"""Orthonormal: brightness, orange to blue, green to purple."""


@dataclass(frozen=True, eq=False)
class Sources:
    """What an encoder quantises: N Gaussians in fixed point, principal axes sorted by falling scale.

    Attributes:
        logs: int64 (N, 4), opacity and the three scales, logarithms to base 2; scales are relative to the scene's.
        axes: float64 (N, 3, 3), the axes in columns.
        colours: int64 (N, 3), Y Co Cg.
        harmonics: float64 (N, K, 3), Y Co Cg of each, in units of the fixed point, not rounded.
    """

    logs: np.ndarray
    axes: np.ndarray
    colours: np.ndarray
    harmonics: np.ndarray


def scene_middle(splats: Splats) -> np.ndarray:
    """Middle of a scene: the median of its Gaussians on each axis, float64 (3)."""
    ranks = middle_ranks(splats.num_gaussians)
    columns = splats.means.T
    return np.array([order_statistics(functools.partial(runs, column), ranks).mean() for column in columns])


def scene_log(splats: Splats) -> int:
    """Size of a scene: log2 of the median distance of the Gaussians from its middle, rounded down."""
    means, ranks, middle = splats.means, middle_ranks(splats.num_gaussians), scene_middle(splats)

    def squares(some: np.ndarray) -> np.ndarray:
        x, y, z = (column.astype(np.float64) - m for column, m in zip(some.T, middle, strict=True))
        return x * x + y * y + z * z

    distance = np.sqrt(order_statistics(lambda: map(squares, runs(means)), ranks)).mean()
    return int(np.clip(np.floor(np.log2(max(distance, 1e-12))), -32, 32))


def to_sources(splats: Splats, size_log: int) -> Sources:
    """Turns Gaussians into fixed point.

    Args:
        splats: The Gaussians.
        size_log: `scene_log` of the scene.
    """
    order = np.argsort(-splats.scales, axis=1, kind="stable")
    axes = np.take_along_axis(matrices_of(splats.quats.astype(np.float64)), order[:, None, :], axis=2)
    return Sources(to_logs(splats, size_log), axes, to_colours(splats), to_harmonics(splats))


def to_logs(splats: Splats, size_log: int) -> np.ndarray:
    """Opacity and scales by falling size as logarithms in fixed point, int64 (N, 4); `size_log` as in `to_sources`."""
    logs = np.empty((splats.num_gaussians, 4), np.int64)
    logs[:, 0] = _fixed(np.log2(splats.opacities.astype(np.float64)), MIN_OPACITY, MAX_OPACITY)
    for place, scales in zip((3, 2, 1), rising(splats.scales), strict=True):
        logs[:, place] = _fixed(np.log2(scales.astype(np.float64)) - size_log, -MAX_LOG, MAX_LOG)
    return logs


def to_colours(splats: Splats) -> np.ndarray:
    """Y Co Cg in fixed point, int64 (N, 3)."""
    base = splats.sh[:, 0].astype(np.float64) @ LUMA_CHROMA.T
    return _fixed(LUMA_CHROMA.sum(axis=1) / 2 + DC * base, -MAX_COLOUR, MAX_COLOUR)


def to_harmonics(splats: Splats) -> np.ndarray:
    """Y Co Cg of each harmonic in units of the fixed point, float64 (N, K, 3).

    Not rounded: what the transform of whole numbers gives is none, and its inverse has to find them again.
    """
    flat = splats.sh[:, 1:].astype(np.float64).reshape(-1, 3) @ LUMA_CHROMA.T * (1 << BITS)
    return np.clip(flat, -MAX_COLOUR, MAX_COLOUR, out=flat).reshape(splats.num_gaussians, -1, 3)


def fit_transform(harmonics: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Axes of harmonics by falling variance, alike for all channels (Karhunen-Loeve), out of `TRANSFORM_UNIT`.

    Args:
        harmonics: (n, K, 3).
        weights: (n), how much an error of each counts.

    Returns:
        int64 (K, K), an axis to a row.
    """
    values = (harmonics * weights[:, None, None]).swapaxes(1, 2).reshape(-1, harmonics.shape[1])
    covariance = values.T @ values
    # Axes without variance are free, and so is every sign: a slope along the diagonal and the largest number positive
    # settle both, so that machines agree.
    slope = np.diag(np.linspace(1.0, 0.0, len(covariance)))
    axes = np.linalg.eigh(covariance + (1e-7 * np.trace(covariance) + 1e-9) * slope)[1].T[::-1]
    axes = axes * np.sign(axes[np.arange(len(axes)), np.abs(axes).argmax(axis=1)])[:, None]
    return np.rint(axes * TRANSFORM_UNIT).astype(np.int64)


def transformed(harmonics: np.ndarray, transform: np.ndarray) -> np.ndarray:
    """Numbers that packets hold of harmonics, int64 (n, 3 K), Y Co Cg of the first axis, then of the next.

    Args:
        harmonics: float64 (n, K, 3).
        transform: See `fit_transform`.
    """
    if not transform.size:
        return np.zeros((len(harmonics), 0), dtype=np.int64)
    inverse = np.linalg.inv(transform / TRANSFORM_UNIT)
    numbers = harmonics.reshape(len(harmonics), -1) @ np.kron(inverse, np.eye(3))
    return np.rint(numbers, out=numbers).astype(np.int64)


def to_splats(
    rows: np.ndarray, harmonics: np.ndarray, origins: np.ndarray, unit: int, size_log: int, transform: np.ndarray
) -> Splats:
    """Turns decoded integers into Gaussians.

    Args:
        rows: int64 (n, COLUMNS).
        harmonics: int32 (n, M).
        origins: int64 (n, 3), in lattice units.
        unit: `-log2` of the lattice's unit, relative to the scene's size.
        size_log: log2 of the scene's size.
        transform: int64 (K, K), of the harmonics, out of `TRANSFORM_UNIT`.
    """
    means = np.ldexp((2 * origins + rows[:, LATTICE : LATTICE + 3]).astype(np.float64), size_log - unit - 1)
    s0 = rows[:, SCALE0] + (size_log << BITS)
    s1 = s0 - rows[:, SCALE1]
    scales = power_of_two(np.stack([s0, s1, s1 - thinness_table()[rows[:, SCALE2]]], axis=1))
    sh = np.empty((len(rows), 3 + harmonics.shape[1]))
    grey = LUMA_CHROMA.sum(axis=1) / 2
    sh[:, :3] = ((rows[:, LUMA : LUMA + 3] * 2.0**-BITS - grey) / DC) @ LUMA_CHROMA
    # One product of matrices for the transform and for Y Co Cg.
    sh[:, 3:] = harmonics.astype(np.float64) @ np.kron(transform * (2.0**-BITS / TRANSFORM_UNIT), LUMA_CHROMA)
    return Splats(
        means.astype(np.float32),
        quaternions_of(_frames(rows)).astype(np.float32),
        scales.astype(np.float32),
        power_of_two(rows[:, OPACITY]).astype(np.float32),
        sh.astype(np.float32).reshape(len(rows), -1, 3),
    )


def empty_rows(count: int, num_harmonics: int) -> tuple[np.ndarray, np.ndarray]:
    """Arrays for decoded integers: rows int64 (count, COLUMNS), harmonics int32 (count, M)."""
    return np.zeros((count, COLUMNS), dtype=np.int64), np.zeros((count, num_harmonics), dtype=np.int32)


def update_digest(digest: Any, rows: tuple[np.ndarray, ...]) -> None:
    """Adds the integers of one block, in the order of the plan, to a hashlib object.

    Args:
        digest: The object.
        rows: As `empty_rows` makes them.
    """
    digest.update(np.ascontiguousarray(rows[0].astype("<i8")).data)
    if rows[1].size:
        digest.update(np.ascontiguousarray(rows[1].astype("<i4")).data)


def _fixed(values: np.ndarray, low: int, high: int) -> np.ndarray:
    return np.clip(np.rint(values * (1 << BITS)), low, high).astype(np.int64)


def _frames(rows: np.ndarray) -> np.ndarray:
    """Principal axes in columns, float64 (n, 3, 3): the primary one as decoded, the next one turned about it."""
    here, u = np.arange(len(rows)), rows[:, AXIS : AXIS + 3].astype(np.float64)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    least = np.argmin(np.abs(u), axis=1)
    t = -u[here, least][:, None] * u
    t[here, least] += 1
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    angle = rows[:, SPIN] * np.ldexp(np.pi, -rows[:, SPIN_BITS].astype(np.int32))
    v = np.cos(angle)[:, None] * t + np.sin(angle)[:, None] * np.cross(u, t)
    axes, primary = np.empty((len(rows), 3, 3)), rows[:, PRIMARY]
    axes[here, :, primary], axes[here, :, (primary + 1) % 3] = u, v
    axes[here, :, (primary + 2) % 3] = np.cross(u, v)
    return axes


def matrices_of(quats: np.ndarray) -> np.ndarray:
    """Rotation matrices of quaternions (w, x, y, z) of any length."""
    return rotation_matrices(quats / np.linalg.norm(quats, axis=1, keepdims=True))
