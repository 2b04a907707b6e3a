"""The encoder's conversion of Gaussians to fixed-point attributes, with whole arrays of numpy instead of kernels."""

import numpy as np

from splatwire.codec.gaussians.attributes import LUMA_CHROMA, matrices_of
from splatwire.codec.gaussians.layout import BITS, MAX_COLOUR, MAX_LOG, MAX_OPACITY, MIN_OPACITY
from splatwire.ops.spherical_harmonics import DC
from splatwire.types.splats import Splats


def reference_logs(splats: Splats, size_log: int) -> np.ndarray:
    """Base-2 logarithms of opacity and scales (largest first) in fixed point, int64 (N, 4)."""
    scales = np.log2(-np.sort(-splats.scales, axis=1).astype(np.float64)) - size_log
    opacity = fixed(np.log2(splats.opacities.astype(np.float64)), MIN_OPACITY, MAX_OPACITY)
    return np.concatenate([opacity[:, None], fixed(scales, -MAX_LOG, MAX_LOG)], axis=1)


def reference_axes(splats: Splats) -> np.ndarray:
    """Principal axes as columns, in the order of decreasing scale, float64 (N, 3, 3)."""
    order = np.argsort(-splats.scales, axis=1, kind="stable")
    return np.take_along_axis(matrices_of(splats.quats.astype(np.float64)), order[:, None, :], axis=2)


def reference_colours(splats: Splats) -> np.ndarray:
    """Base colours as Y Co Cg in fixed point, int64 (N, 3)."""
    base = splats.sh[:, 0].astype(np.float64) @ LUMA_CHROMA.T
    return fixed(LUMA_CHROMA.sum(axis=1) / 2 + DC * base, -MAX_COLOUR, MAX_COLOUR)


def reference_centres(means: np.ndarray, shifts: np.ndarray, unit: int, size_log: int) -> np.ndarray:
    """Positions moved to the centres of their cells, float32 (N, 3); cells are `2**shifts` lattice spacings wide."""
    centres = means.astype(np.float32)
    for _ in range(2):
        cells = np.floor(np.ldexp(centres.astype(np.float64), unit - size_log)).astype(np.int64) >> shifts[:, None]
        centres = np.ldexp(((2 * cells + 1) << shifts[:, None]).astype(np.float64), size_log - unit - 1)
        centres = centres.astype(np.float32)
    return centres


def fixed(values: np.ndarray, low: int, high: int) -> np.ndarray:
    """Rounds numbers to fixed point with `BITS` fractional bits, within limits, int64."""
    return np.clip(np.rint(values * (1 << BITS)), low, high).astype(np.int64)
