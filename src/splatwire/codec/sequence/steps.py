"""Quantisation steps of a track's motion, computed from the decoded attributes of the track's keyframe Gaussian."""

import numpy as np

from splatwire.codec.gaussians.layout import CLASS, DIRECTION_BITS, ELONGATION, FLATNESS, OPACITY, SCALE0
from splatwire.codec.gaussians.side_info import SideInfo as KeyframeInfo
from splatwire.codec.gaussians.tables import flatness_table
from splatwire.codec.sequence import _step_kernels as kernels
from splatwire.codec.sequence.layout import KIND_OF, MAX_COORD, NUM_CHANNELS

MAX_SHIFT = 30


def motion_shifts(
    rows: np.ndarray, info: KeyframeInfo, log_step_ratios: np.ndarray, lattice_shift: int = 0
) -> np.ndarray:
    """Returns log2 of the quantisation steps of the motion of tracks (Gaussians over time).

    Args:
        rows: Decoded integers of the tracks' keyframe Gaussians, int64 (n, columns).
        info: Side information of the keyframe Gaussians.
        log_step_ratios: For each kind of channel, log2 of the ratio of the quantisation steps of motion to those of the
            keyframe Gaussian, int64 (kinds).
        lattice_shift: log2 of half the lattice spacing of `info`, relative to the unit of motion.

    Returns:
        log2 of the step of each channel, int64 (n, channels), in the units that `layout.CHANNELS` lists.
    """
    shifts = np.zeros((len(rows), NUM_CHANNELS), dtype=np.int64)
    columns = np.ascontiguousarray(rows[:, [CLASS, OPACITY, SCALE0, ELONGATION, FLATNESS]])
    kernels.keyframe_shifts(
        columns, info.base_exponents, info.lattice_bits, max(info.max_position_shift, 0), flatness_table(), shifts
    )
    shifts[:, :3] += lattice_shift
    return np.clip(shifts + log_step_ratios[KIND_OF], 0, MAX_SHIFT)


def in_other_units(positions: np.ndarray, shifts: np.ndarray, log2_ratios: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Converts the positions of tracks, and the quantisation steps of their motion, to another unit of motion.

    The unit may change after a scene cut.

    Args:
        positions: Positions of the keyframe Gaussians in the old unit, int64 (n, 3), at most `MAX_COORD` in magnitude.
        shifts: log2 of the quantisation steps of motion in the old unit, int64 (n, channels).
        log2_ratios: log2 of the ratio of the old to the new unit for each track, int64 (n).

    Returns:
        Positions in the new unit, int64 (n, 3); and log2 of the quantisation steps of motion in the new unit, int64 (n,
        channels).
    """
    if not log2_ratios.any():
        return positions, shifts
    moved, steps = np.floor(np.ldexp(positions.astype(np.float64), log2_ratios[:, None])), shifts.copy()
    steps[:, :3] = np.clip(steps[:, :3] + log2_ratios[:, None], 0, MAX_SHIFT)
    return np.clip(moved, -MAX_COORD, MAX_COORD).astype(np.int64), steps


assert DIRECTION_BITS == 14, "rotations are out of 2**14, as axes are"
