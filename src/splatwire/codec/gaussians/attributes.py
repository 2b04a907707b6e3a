"""Converts the attributes of Gaussians to fixed-point integers and back."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatwire.codec.gaussians import _source_kernels as sources
from splatwire.codec.gaussians.blocks import CACHE_GAUSSIANS, chunks
from splatwire.codec.gaussians.layout import (
    BITS,
    COLUMNS,
    MAX_COLOUR,
    TRANSFORM_UNIT,
)
from splatwire.codec.gaussians.tables import exponentials, flatness_table
from splatwire.files.mmap_array import large_empty
from splatwire.ops.order_statistics import middle_ranks, order_statistics
from splatwire.ops.quaternions import rotation_matrices
from splatwire.ops.spherical_harmonics import DC
from splatwire.ops.threads import parallel_map
from splatwire.types.splats import Splats

LUMA_CHROMA = np.array([[1, 1, 1], [1, 0, -1], [-1, 2, -1]]) / np.sqrt([[3.0], [2.0], [6.0]])
"""Orthonormal transform from RGB to brightness (row 0), orange-blue (row 1) and green-purple (row 2), called Y Co Cg in
this package.
"""
GREY = LUMA_CHROMA.sum(axis=1) / 2
"""Y Co Cg of the colour of a Gaussian whose harmonics are 0, float64 (3)."""
_LEAST_SIZE = 2.0**-12
"""Smallest scene size, relative to the median of the Gaussians' largest scales."""


@dataclass(frozen=True, eq=False)
class Sources:
    """Attributes of N Gaussians for rounding without encoding (`rounding`), mostly in fixed point.

    Attributes:
        logs: int64 (N, 4), base-2 logarithms of the opacity and of the scales (relative to the scene size, largest
            first), with `BITS` fractional bits.
        axes: float64 (N, 3, 3), principal axes as columns, in the order of decreasing scale.
        colours: int64 (N, 3), base colour as Y Co Cg, with `BITS` fractional bits.
    """

    logs: np.ndarray
    axes: np.ndarray
    colours: np.ndarray


def scene_middle(splats: Splats) -> np.ndarray:
    """Returns the centre of a scene, float64 (3): on each axis the median of the Gaussians' positions."""
    ranks = middle_ranks(splats.num_gaussians)
    middle = parallel_map(
        lambda column: order_statistics(functools.partial(chunks, column), ranks).mean(), list(splats.means.T)
    )
    return np.array(middle)


def log2_scene_size(splats: Splats) -> int:
    """Returns log2 of the scene size, from -32 to 32.

    The scene size is the median distance of the Gaussians from the centre (`scene_middle`) in world units, rounded
    down to a power of two. If most Gaussians are at the centre, it is the median of the others. It is at least
    `_LEAST_SIZE` times the median of the Gaussians' largest scales.
    """
    means, middle, squares = splats.means, scene_middle(splats), large_empty((splats.num_gaussians,), np.float64)

    def square(begin: int) -> None:
        positions = means[begin : begin + CACHE_GAUSSIANS]
        x, y, z = (column.astype(np.float64) - m for column, m in zip(positions.T, middle, strict=True))
        squares[begin : begin + CACHE_GAUSSIANS] = x * x + y * y + z * z

    parallel_map(square, range(0, len(squares), CACHE_GAUSSIANS))
    distance = np.sqrt(order_statistics(lambda: chunks(squares), middle_ranks(len(squares)))).mean()
    if distance == 0 and len(elsewhere := squares[squares > 0]):
        distance = float(np.sqrt(np.median(elsewhere)))
    # Gaussians at nearly one place may fly apart in a clip, which a lattice that is fitted to them could not express.
    if distance < _LEAST_SIZE * splats.scales.max():
        distance = max(distance, _LEAST_SIZE * float(np.median(splats.scales.max(axis=1))))
    # Gaussians without a spread, such as a single one, can be far from 0: their lattice has to reach them.
    distance = max(distance, float(np.abs(middle).max()) * 2.0**-36, 1e-12)
    return int(np.clip(np.floor(np.log2(distance)), -32, 32))


def to_sources(splats: Splats, size_log: int) -> Sources:
    """Converts Gaussians to fixed-point attributes and sorted principal axes.

    Args:
        splats: The Gaussians.
        size_log: log2 of the scene size in world units, from `log2_scene_size`.
    """
    axes = np.empty((splats.num_gaussians, 3, 3))
    sources.write_axes(kernel_array(splats.scales), kernel_array(splats.quats), axes)
    return Sources(to_logs(splats, size_log), axes, to_colours(splats))


def to_logs(splats: Splats, size_log: int) -> np.ndarray:
    """Returns base-2 logarithms of opacity and scales (largest first) in fixed point, int64 (N, 4).

    Args:
        splats: The Gaussians.
        size_log: log2 of the scene size in world units; scales are relative to this size.
    """
    return logs_of(splats.opacities, splats.scales, size_log)


def logs_of(opacities: np.ndarray, scales: np.ndarray, size_log: int) -> np.ndarray:
    """Returns base-2 logarithms of opacity and scales (largest first) in fixed point, int64 (n, 4).

    Args:
        opacities: float32 (n).
        scales: Standard deviations, float32 (n, 3).
        size_log: log2 of the scene size in world units; scales are relative to this size.
    """
    logs = np.empty((len(opacities), 4), np.int64)
    sources.write_logs(kernel_array(opacities), kernel_array(scales), size_log, logs)
    return logs


def to_colours(splats: Splats) -> np.ndarray:
    """Converts base colours to Y Co Cg in fixed point with `BITS` fractional bits, int64 (N, 3)."""
    return colours_of(splats.sh[:, 0])


def colours_of(base: np.ndarray) -> np.ndarray:
    """Converts spherical harmonics of degree 0 to base colours as Y Co Cg in fixed point, int64 (n, 3).

    Args:
        base: float32 (n, 3).
    """
    colours = np.empty((len(base), 3), np.int64)
    sources.write_colours(kernel_array(base), LUMA_CHROMA * DC, GREY, colours)
    return colours


def to_harmonics(splats: Splats) -> np.ndarray:
    """Converts spherical harmonics above degree 0 to the colour space Y Co Cg, times `2**BITS`, float64 (N, K, 3)."""
    # Not rounded, so that the transform maps the harmonics of a decoded scene to exactly the integers of its stream.
    harmonics = np.empty((splats.num_gaussians, splats.sh.shape[1] - 1, 3))
    sources.write_harmonics(kernel_array(splats.sh), LUMA_CHROMA * (1 << BITS), harmonics)
    return harmonics


def fit_transform(harmonics: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Fits the decorrelating transform of spherical harmonics (Karhunen-Loeve transform).

    Args:
        harmonics: (n, K, 3), K harmonics above degree 0 of n Gaussians.
        weights: (n), weight of each Gaussian's quantisation error.

    Returns:
        int64 (K, K), one axis per row, by decreasing variance, in fixed point with denominator `TRANSFORM_UNIT`.
    """
    values = (harmonics * weights[:, None, None]).swapaxes(1, 2).reshape(-1, harmonics.shape[1])
    covariance = values.T @ values
    # Axes without variance, and all signs, are ambiguous. A slope along the diagonal and a positive largest entry make
    # the result identical on all machines.
    slope = np.diag(np.linspace(1.0, 0.0, len(covariance)))
    axes = np.linalg.eigh(covariance + (1e-7 * np.trace(covariance) + 1e-9) * slope)[1].T[::-1]
    axes = axes * np.sign(axes[np.arange(len(axes)), np.abs(axes).argmax(axis=1)])[:, None]
    return np.rint(axes * TRANSFORM_UNIT).astype(np.int64)


def transform_harmonics(splats: Splats, transform: np.ndarray) -> np.ndarray:
    """Applies the decorrelating transform to spherical harmonics above degree 0; returns integers.

    Args:
        splats: The n Gaussians, with K harmonics above degree 0.
        transform: int64 (K, K), from `fit_transform`.

    Returns:
        int32 (n, 3 K): Y, Co and Cg of the first transformed harmonic, then of the second, and so on.
    """
    count = splats.num_gaussians
    if not transform.size:
        return np.zeros((count, 0), dtype=np.int32)
    inverse, higher_harmonics = np.linalg.inv(transform / TRANSFORM_UNIT), splats.sh[:, 1:]
    # One product with a large matrix is several times as fast as a product with a 3 x 3 matrix before it. Only values
    # that `to_harmonics` limits need the slow way: each is at most sqrt(3) times the largest coefficient.
    if max(higher_harmonics.max(initial=0), -higher_harmonics.min(initial=0)) * (2 << BITS) < MAX_COLOUR:
        matrix = np.kron(inverse, LUMA_CHROMA.T * (1 << BITS))
        transformed = higher_harmonics.reshape(count, -1).astype(np.float64) @ matrix
    else:
        transformed = to_harmonics(splats).reshape(count, -1) @ np.kron(inverse, np.eye(3))
    np.clip(np.rint(transformed, out=transformed), -sources.MAX_TRANSFORMED, sources.MAX_TRANSFORMED, out=transformed)
    return transformed.astype(np.int32)


def to_splats(
    rows: np.ndarray,
    harmonics: np.ndarray,
    corners: np.ndarray,
    lattice_bits: int,
    size_log: int,
    transform: np.ndarray,
) -> Splats:
    """Converts decoded integers to Gaussians with float attributes.

    Args:
        rows: int64 (n, columns), decoded integers of each Gaussian except the harmonics.
        harmonics: int32 (n, 3 K), decoded integers of the K transformed spherical harmonics, three colour components
            each.
        corners: int64 (n, 3), lower corner of the bounding box of each Gaussian's block, in lattice spacings.
        lattice_bits: `-log2` of the lattice spacing of positions, relative to the scene size.
        size_log: log2 of the scene size in world units.
        transform: int64 (K, K), transform of the K harmonics, from `fit_transform`.
    """
    count = len(rows)
    shapes = (count, 3), (count, 4), (count, 3), (count,), (count, 1 + harmonics.shape[1] // 3, 3)
    splats = Splats(*(np.empty(shape, np.float32) for shape in shapes))
    fill_splats(splats, np.arange(count), rows, harmonics, corners, lattice_bits, size_log, transform)
    return splats


def fill_splats(
    splats: Splats, indices: np.ndarray, rows: np.ndarray, harmonics: np.ndarray, corners: np.ndarray,
    lattice_bits: int, size_log: int, transform: np.ndarray,
) -> None:  # fmt: skip
    """Converts decoded integers of Gaussians to floats, and writes them into the scene.

    Args:
        splats: All Gaussians of the scene, changed in place.
        indices: int64 (n), indices of the converted Gaussians in `splats`.
        rows: int64 (n, columns), decoded integers of each Gaussian except the harmonics.
        harmonics: int32 (n, harmonics), decoded integers of the transformed spherical harmonics.
        corners: int64 (n, 3), lower corner of the bounding box of each Gaussian's block, in lattice spacings.
        lattice_bits: `-log2` of the lattice spacing of positions, relative to the scene size.
        size_log: log2 of the scene size in world units.
        transform: int64 (K, K), transform of the harmonics, from `fit_transform`.
    """
    from splatwire.codec.gaussians import _splat_kernels as kernels

    width = harmonics.shape[1]
    scratch = np.empty(max(9, width))
    # Contiguous arrays only, because a kernel is compiled again for each layout of its arguments.
    kernels.convert(
        np.ascontiguousarray(rows), indices, np.ascontiguousarray(corners), size_log, lattice_bits, flatness_table(),
        exponentials(), LUMA_CHROMA / DC, GREY, splats.means, splats.quats, splats.scales,
        splats.opacities, splats.sh, scratch,
    )  # fmt: skip
    if width:
        kernels.convert_harmonics(
            np.ascontiguousarray(harmonics), indices, transform.astype(np.float64),
            LUMA_CHROMA * (2.0**-BITS / TRANSFORM_UNIT), scratch, splats.sh,
        )  # fmt: skip


def empty_rows(count: int, num_harmonic_columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Allocates zero arrays for the decoded integers of Gaussians.

    Args:
        count: Number of Gaussians.
        num_harmonic_columns: Number of quantised harmonic coefficients per Gaussian.

    Returns:
        Two arrays: one for all attributes except harmonics, int64 (count, columns), and one for the harmonics, int32
        (count, num_harmonic_columns).
    """
    return np.zeros((count, COLUMNS), dtype=np.int64), np.zeros((count, num_harmonic_columns), dtype=np.int32)


def update_digest(digest: Any, rows: tuple[np.ndarray, ...]) -> None:
    """Adds the decoded integers of one block to a hash, with which receivers verify their decoding.

    Args:
        digest: hashlib object that is updated.
        rows: Decoded integers of the block: an array of all attributes except harmonics, and an array of harmonics.
    """
    digest.update(np.ascontiguousarray(rows[0], "<i8").data)
    if rows[1].size:
        digest.update(np.ascontiguousarray(rows[1], "<i4").data)


def kernel_array(values: np.ndarray) -> np.ndarray:
    """Returns an array in the memory layout for which kernels are compiled: contiguous and writeable.

    The result is the array itself if possible, otherwise a copy. float16 is converted to float32.
    """
    # For each memory layout of its arguments, and for read-only arrays, numba compiles a kernel again. numba does not
    # support float16.
    values = values.astype(np.float32) if values.dtype == np.float16 else values
    return np.require(values, requirements=["C", "W"])


def matrices_of(quats: np.ndarray) -> np.ndarray:
    """Normalises quaternions (w, x, y, z), and converts them to rotation matrices, (n, 3, 3)."""
    return rotation_matrices(quats / np.linalg.norm(quats, axis=1, keepdims=True))
