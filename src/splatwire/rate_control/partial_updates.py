"""Updates of a scene that is trained: each contains only the Gaussians whose change matters most."""

# A training step changes all Gaussians, so an update with all changes is as large as the scene.

import logging
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int64

from splatwire.bitstream import PRESETS
from splatwire.codec.encoding import encode_scene
from splatwire.codec.update.chain import UpdateChain
from splatwire.errors import InvalidValueError
from splatwire.ops.knn import NeighborTree
from splatwire.render.importance import footprint_importance, surrounding_cameras
from splatwire.types.anchors import MIN_SIZE
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
SHARE = 0.1
"""Default maximum share of the Gaussians in an update."""
NUM_VIEWS, VIEW_SIZE = 4, 192
"""Number and size (pixels) of the views in which the footprints of Gaussians are measured."""
NEW_CHANGE = 2.0
"""Change of a Gaussian that the receivers do not have, in the unit of `changes`."""
MAX_GROWTH = 2.0
"""Ratio of the numbers of Gaussians, or of the sizes of the scene, now and when the whole scene was sent, above which
the whole scene is sent again: lattice, quantisation steps and context tables no longer fit.
"""


def changes(before: Splats, after: Splats) -> Float[np.ndarray, "G"]:
    """Measures how much each Gaussian has changed in a training.

    Args:
        before: Gaussians before the change.
        after: The same Gaussians in the same order, after the change.
    """
    # Sum of the displacement in multiples of the Gaussian's mean size, and of the mean absolute changes of the
    # logarithms of the axes, of the coefficients of spherical harmonics, and of the opacity.
    log_axes = [np.log(np.maximum(splats.scales, np.float32(MIN_SIZE))) for splats in (before, after)]
    size = np.exp(log_axes[1].mean(axis=1, keepdims=True))
    moved = np.linalg.norm((after.means - before.means) / size, axis=1)
    resized = np.abs(log_axes[1] - log_axes[0]).mean(axis=1)
    recoloured = np.abs(after.sh - before.sh).mean(axis=(1, 2))
    return np.asarray(moved + resized + recoloured + np.abs(after.opacities - before.opacities))


@dataclass(frozen=True, eq=False)
class PartialUpdates:
    """Sender of updates to receivers of a scene in training; each update contains a share of the changes.

    Attributes:
        chain: Stream that the receivers got first, and its updates.
        newest: Gaussians of the newest scene.
        held: Gaussians as the receivers have them, without rounding, in the order of `newest`.
        known: Mask of the Gaussians that the receivers have.
        num_at_first: Number of drawable Gaussians when the whole scene was sent.
        size_at_first: Size of the scene when the whole scene was sent, world units.
        antialiased: True if the scene was trained with an antialiased renderer.
    """

    # Rows of `held` outside of `known` are undefined. Sizes are from `_scene_size`.

    chain: UpdateChain
    newest: Splats
    held: Splats
    known: Bool[np.ndarray, "G"]
    num_at_first: int
    size_at_first: float
    antialiased: bool = False

    @staticmethod
    def start(splats: Splats, antialiased: bool = False) -> "PartialUpdates":
        """Encodes a whole scene.

        Args:
            splats: The Gaussians.
            antialiased: True if they were trained with an antialiased renderer.

        Raises:
            InvalidValueError: If no Gaussian can be drawn, or values are too large.
        """
        stream = encode_scene(SplatScene(splats, antialiased=antialiased), PRESETS["datagram"])
        known = SplatScene(splats).drawable.copy()
        size = _scene_size(splats.select(known))
        return PartialUpdates(UpdateChain(stream, stream), splats, splats, known, int(known.sum()), size, antialiased)

    def pushed(self, splats: Splats, share: float = SHARE) -> "PartialUpdates":
        """Encodes the largest changes of the Gaussians as an update; the others remain for later calls.

        If the number of Gaussians is unchanged, their order must be, too. Otherwise, Gaussians are matched by position,
        and those without a match are new or removed. The whole scene is encoded again if an update cannot express the
        change.

        Args:
            splats: The newest Gaussians.
            share: Maximum share of the Gaussians to send, above 0, at most 1.

        Raises:
            InvalidValueError: If no Gaussian can be drawn, or values are too large.
        """
        # After `1 / share` calls with the same Gaussians, the receivers have all changes. Removed Gaussians do
        # not count towards the share. An update cannot express another degree of spherical harmonics, positions
        # outside the lattice, or more than twice or less than half the number of Gaussians or the size.
        count = splats.num_gaussians
        drawable = SplatScene(splats).drawable
        if not drawable.any():
            raise InvalidValueError("no Gaussian can be drawn")
        ratios = drawable.sum() / self.num_at_first, _scene_size(splats.select(drawable)) / self.size_at_first
        if splats.degree != self.newest.degree or any(not 1 / MAX_GROWTH <= ratio <= MAX_GROWTH for ratio in ratios):
            return PartialUpdates.start(splats, self.antialiased)
        held, known = self._held_rows(splats)
        known &= drawable
        chosen = _most_changed(held, known, splats, drawable, max(1, round(share * count)))
        mixed = Splats(**{name: values.copy() for name, values in vars(held).items()})
        for name, values in vars(mixed).items():
            values[chosen] = getattr(splats, name)[chosen]
        known[chosen] = True
        try:
            chain = self.chain.edited(SplatScene(mixed.select(known), antialiased=self.antialiased))
        except InvalidValueError as error:
            LOG.warning("update: %s; the whole scene is sent again", error)
            return PartialUpdates.start(splats, self.antialiased)
        return replace(self, chain=chain, newest=splats, held=mixed, known=known)

    def _held_rows(self, splats: Splats) -> tuple[Splats, Bool[np.ndarray, "G"]]:
        """Finds the version of each Gaussian of a new scene that the receivers have.

        Args:
            splats: Gaussians of the new scene.

        Returns:
            The receivers' versions, arbitrary for new Gaussians; and a mask of the Gaussians that receivers have.
        """
        if splats.num_gaussians == self.newest.num_gaussians:
            return self.held, self.known.copy()
        match = match_by_position(self.newest.means, splats.means)
        return self.held.select(np.maximum(match, 0)), (match >= 0) & self.known[match]


def _scene_size(splats: Splats) -> float:
    """Returns the median distance of Gaussians from their median position, world units."""
    return float(np.median(np.linalg.norm(splats.means - np.median(splats.means, axis=0), axis=1))) + MIN_SIZE


def match_by_position(before: Float[np.ndarray, "F 3"], after: Float[np.ndarray, "G 3"]) -> Int64[np.ndarray, "G"]:
    """Matches points that are each other's nearest neighbours.

    Args:
        before: Points before a change, at least one.
        after: Points after the change, at least one.

    Returns:
        Index of each point's match in `before`; -1 without a match.
    """
    before, after = (np.nan_to_num(points, nan=0.0, posinf=0.0, neginf=0.0) for points in (before, after))
    nearest, back = NeighborTree(before).query(after, 1)[0][:, 0], NeighborTree(after).query(before, 1)[0][:, 0]
    return np.where(back[nearest] == np.arange(len(after)), nearest, -1)


def _most_changed(
    held: Splats, known: np.ndarray, newest: Splats, drawable: np.ndarray, most: int
) -> Int64[np.ndarray, "K"]:
    """Returns the indices of at most `most` changed Gaussians, largest change first."""
    rows = np.flatnonzero(drawable)
    before, scene = held.select(rows), SplatScene(newest.select(rows))
    area = footprint_importance(scene, surrounding_cameras(scene, NUM_VIEWS, VIEW_SIZE)).share
    with np.errstate(invalid="ignore", over="ignore"):  # rows that the receivers do not have are undefined
        change = np.where(known[rows], changes(before, scene.splats), NEW_CHANGE)
    differs = ~known[rows]
    for name, values in vars(scene.splats).items():
        differs |= (values != getattr(before, name)).reshape(len(rows), -1).any(axis=1)
    # Gaussians outside of all views come last, in the order of their change.
    order = np.lexsort((-change, -change * np.sqrt(area)))
    return rows[order[differs[order]][:most]]
