"""Limits extreme values of single Gaussians (outliers), which would reduce the precision of all other Gaussians."""

import logging
from dataclasses import replace

import numpy as np

from splatwire.codec.gaussians.attributes import scene_middle
from splatwire.codec.gaussians.blocks import chunks, float64_chunks
from splatwire.codec.gaussians.layout import BITS, MAX_COLOUR, MAX_LATTICE_BITS
from splatwire.ops.threads import parallel_map
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
MAX_COORDINATE_BITS = MAX_LATTICE_BITS - 2
"""Maximum number of bits of a coordinate: integer bits for the farthest Gaussian, and fractional bits for the finest
quantisation step.
"""
MAX_DISTANCE_OCTAVES = 12
"""Largest coded distance, in octaves of the scene size. The index of a cell has at most 21 bits per axis
(`MAX_CELL_BITS`). With 12
octaves of distance, 9 bits are left for the Gaussians near the centre, as many as `choose_cell_shift` chooses for some
hundreds of Gaussians.
"""

_TOLERANCE = 1.001
"""Relative tolerance: Gaussians that were moved, encoded and decoded are not moved again because of rounding by half a
step.
"""


def pull_in_outliers(splats: Splats, size_log: int) -> Splats:
    """Moves very distant Gaussians (outliers) closer to the centre of the scene, and logs a warning.

    The scales of a moved Gaussian are reduced by the same factor as its distance from the centre.

    Args:
        splats: The Gaussians.
        size_log: log2 of the scene size in world units.

    Returns:
        All Gaussians in the order of `splats`; `splats` itself if none was moved.
    """
    max_coordinate = 2.0 ** (MAX_DISTANCE_OCTAVES + size_log)
    means = splats.means
    farthest = max(float(np.abs(piece).max()) for piece in chunks(means))
    if farthest <= max_coordinate:
        return splats
    middle = scene_middle(splats)
    # A scene far from the origin is not moved.
    max_coordinate = max(max_coordinate, 4 * float(np.abs(middle).max()))
    max_distance = max_coordinate - float(np.abs(middle).max())
    distance = np.concatenate([np.abs(piece - middle).max(axis=1) for piece in float64_chunks(means)])
    far = np.flatnonzero(distance > _TOLERANCE * max_distance)
    if not len(far):
        return splats
    # With scales reduced by the same factor, an outlier looks the same from the centre.
    factor = max_distance / distance[far]
    LOG.warning(
        "encoding: %s of %s Gaussians are up to %.3g times the scene size away and are moved nearer, to %.3g",
        f"{len(far):,}", f"{splats.num_gaussians:,}", float(distance.max()) / 2.0**size_log,
        max_distance / 2.0**size_log,
    )  # fmt: skip
    means, scales = splats.means.copy(), splats.scales.copy()
    means[far] = middle + (means[far].astype(np.float64) - middle) * factor[:, None]
    scales[far] = np.maximum(scales[far] * factor[:, None], np.finfo(np.float32).tiny)
    return replace(splats, means=means, scales=scales)


def log_clipped_colours(splats: Splats) -> None:
    """Logs the number of Gaussians with colours or harmonics beyond the range of the format."""
    max_magnitude = MAX_COLOUR / (1 << BITS)
    parts = list(chunks(splats.sh.reshape(splats.num_gaussians, -1)))
    if max(parallel_map(lambda piece: max(piece.max(), -piece.min()), parts)) > max_magnitude:
        largest = [np.abs(piece).max(axis=1) for piece in parts]
        num_clipped = sum(int((piece > max_magnitude).sum()) for piece in largest)
        LOG.warning(
            "encoding: %s of %s Gaussians have harmonics up to %.3g, which are cut to %g",
            f"{num_clipped:,}", f"{splats.num_gaussians:,}", float(max(piece.max() for piece in largest)),
            max_magnitude,
        )  # fmt: skip
