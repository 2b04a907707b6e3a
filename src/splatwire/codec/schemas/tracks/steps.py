"""Steps of what moves: as fine as those of the track's base."""

import numpy as np

from splatwire.codec.schemas.gaussians.layout import (
    CLASS,
    DIRECTION_BITS,
    OPACITY,
    SCALE0,
    SCALE1,
    SCALE2,
)
from splatwire.codec.schemas.gaussians.side_info import SideInfo as BaseInfo
from splatwire.codec.schemas.gaussians.tables import thinness_table
from splatwire.codec.schemas.tracks.layout import KIND_OF, NUM_CHANNELS

LARGEST_SHIFT = 30


def motion_shifts(rows: np.ndarray, info: BaseInfo, coarser: np.ndarray) -> np.ndarray:
    """log2 of the steps of every channel of some tracks, int64 (n, C), in the channels' units (`layout.CHANNELS`).

    Args:
        rows: Decoded integers of the bases, int64 (n, COLUMNS).
        info: Side information of the bases.
        coarser: Octaves by which steps are larger than the base's, by kind of channel.
    """
    from splatwire.codec.schemas.tracks import _step_kernels as kernels

    shifts = np.zeros((len(rows), NUM_CHANNELS), dtype=np.int64)
    columns = np.ascontiguousarray(rows[:, [CLASS, OPACITY, SCALE0, SCALE1, SCALE2]])
    kernels.base_shifts(columns, info.bases, info.unit, max(info.coarsest, 0), thinness_table(), shifts)
    return np.clip(shifts + coarser[KIND_OF], 0, LARGEST_SHIFT)


assert DIRECTION_BITS == 14, "rotations are out of 2**14, as axes are"
