"""Single Gaussians with absurd numbers: they are coded so that all others keep their precision, and said."""

import logging
from dataclasses import replace

import numpy as np

from splatwire.codec.schemas.gaussians.attributes import scene_middle
from splatwire.codec.schemas.gaussians.blocks import pieces, runs
from splatwire.codec.schemas.gaussians.layout import BITS, MAX_COLOUR, MAX_LATTICE_BITS
from splatwire.scene.splats import Splats

LOG = logging.getLogger(__name__)
ROOM = MAX_LATTICE_BITS - 2
"""Bits of a place: those before the point are for how far away the farthest is, those behind for the finest step."""
REACH = 12
"""Octaves of the scene's size within which places are coded. Cells of a packet's first grid have `MAX_CELL_BITS` bits
to a side: these are left for what lies near, as many as `cell_shift` wants for some hundreds of Gaussians."""

_SLACK = 1.001
"""What was moved once and decoded is not moved again for the half step that coding moved it."""


def within_reach(splats: Splats, size_log: int) -> Splats:
    """Brings near what is so far away that its place would leave too few bits to those of all others.

    What is moved towards the middle of the scene and made smaller by the same factor looks the same from there.

    Args:
        splats: The Gaussians.
        size_log: log2 of the scene's size.

    Returns:
        The same Gaussians, or some of them nearer, which is logged.
    """
    reach = 2.0 ** (REACH + size_log)
    means = splats.means
    farthest = max(float(np.abs(some).max()) for some in runs(means))
    if farthest <= reach:
        return splats
    middle = scene_middle(splats)
    reach = max(reach, 4 * float(np.abs(middle).max()))  # a scene that lies far from the origin stays there
    left = reach - float(np.abs(middle).max())
    distance = np.concatenate([np.abs(some - middle).max(axis=1) for some in pieces(means)])
    far = np.flatnonzero(distance > _SLACK * left)
    if not len(far):
        return splats
    share = left / distance[far]
    LOG.warning(
        "encoding: %s of %s Gaussians are up to %.3g times the scene's size away and are moved nearer, to %.3g",
        f"{len(far):,}", f"{splats.num_gaussians:,}", float(distance.max()) / 2.0**size_log, left / 2.0**size_log,
    )  # fmt: skip
    means, scales = splats.means.copy(), splats.scales.copy()
    means[far] = middle + (means[far].astype(np.float64) - middle) * share[:, None]
    scales[far] = np.maximum(scales[far] * share[:, None], np.finfo(np.float32).tiny)
    return replace(splats, means=means, scales=scales)


def tell_cut_colours(splats: Splats) -> None:
    """Logs how many Gaussians have colours or harmonics that no stream holds: they are cut."""
    most = MAX_COLOUR / (1 << BITS)
    sh = splats.sh.reshape(splats.num_gaussians, -1)
    largest = [np.abs(some).max(axis=1) for some in runs(sh)]
    cut = sum(int((some > most).sum()) for some in largest)
    if cut:
        LOG.warning(
            "encoding: %s of %s Gaussians have harmonics up to %.3g, which are cut to %g",
            f"{cut:,}", f"{splats.num_gaussians:,}", float(max(some.max() for some in largest)), most,
        )  # fmt: skip
