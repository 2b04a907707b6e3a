"""The encoder's conversion of Gaussians to fixed-point attributes, with whole arrays of numpy instead of kernels."""

import numpy as np

from splatwire.codec.gaussians.attributes import LUMA_CHROMA, matrices_of
from splatwire.codec.gaussians.layout import BITS, MAX_COLOUR, MAX_LOG, MAX_LOG_OPACITY, MIN_LOG_OPACITY, SLOT_BITS
from splatwire.ops.spherical_harmonics import DC
from splatwire.types.splats import Splats


def reference_logs(splats: Splats, size_log: int) -> np.ndarray:
    """Base-2 logarithms of opacity and scales (largest first) in fixed point, int64 (N, 4)."""
    scales = np.log2(-np.sort(-splats.scales, axis=1).astype(np.float64)) - size_log
    opacity = fixed(np.log2(splats.opacities.astype(np.float64)), MIN_LOG_OPACITY, MAX_LOG_OPACITY)
    return np.concatenate([opacity[:, None], fixed(scales, -MAX_LOG, MAX_LOG)], axis=1)


def reference_axes(splats: Splats) -> np.ndarray:
    """Principal axes as columns, in the order of decreasing scale, float64 (N, 3, 3)."""
    order = np.argsort(-splats.scales, axis=1, kind="stable")
    return np.take_along_axis(matrices_of(splats.quats.astype(np.float64)), order[:, None, :], axis=2)


def reference_colours(splats: Splats) -> np.ndarray:
    """Base colours as Y Co Cg in fixed point, int64 (N, 3)."""
    base = splats.sh[:, 0].astype(np.float64) @ LUMA_CHROMA.T
    return fixed(LUMA_CHROMA.sum(axis=1) / 2 + DC * base, -MAX_COLOUR, MAX_COLOUR)


def reference_centres(means: np.ndarray, shifts: np.ndarray, lattice_bits: int, size_log: int) -> np.ndarray:
    """Positions moved to the centres of their cells, float32 (N, 3); cells are `2**shifts` lattice spacings wide."""
    centres = means.astype(np.float32)
    for _ in range(2):
        cells = (
            np.floor(np.ldexp(centres.astype(np.float64), lattice_bits - size_log)).astype(np.int64) >> shifts[:, None]
        )
        centres = np.ldexp(((2 * cells + 1) << shifts[:, None]).astype(np.float64), size_log - lattice_bits - 1)
        centres = centres.astype(np.float32)
    return centres


def fixed(values: np.ndarray, low: int, high: int) -> np.ndarray:
    """Rounds numbers to fixed point with `BITS` fractional bits, within limits, int64."""
    return np.clip(np.rint(values * (1 << BITS)), low, high).astype(np.int64)


def reference_means(splats: Splats, size_log: int) -> np.ndarray:
    """Mean opacity, scales and colour of a block in the form of the bitstream, float64 (7), in fixed point."""
    logs = reference_logs(splats, size_log)
    thin = (1 - np.exp2((logs[:, 3] - logs[:, 2]) / (1 << BITS))) / np.log(2) * (1 << BITS)
    values = [logs[:, 0], logs[:, 1], logs[:, 1] - logs[:, 2], thin, *reference_colours(splats).T]
    return np.array([column.mean() for column in values])


def reference_arrangement(codes: np.ndarray, contiguous: bool) -> np.ndarray:
    """Indices of a block's Gaussians in the order of packets, computed from the codes of their cells."""
    slots = np.zeros_like(codes)
    for bit in range(0 if contiguous else SLOT_BITS):
        slots |= ((codes >> bit) & 1) << (SLOT_BITS - 1 - bit)
    return np.lexsort((codes, slots))


def reference_extent(positions: np.ndarray) -> int:
    """Largest extent of positions along an axis; 2 % of outliers at either end count for at most half of it."""
    omitted = (len(positions) - 1) // 50
    inside = np.sort(positions, axis=0)[omitted : len(positions) - omitted]
    return int(np.minimum(np.ptp(positions, axis=0), 2 * np.ptp(inside, axis=0)).max())
