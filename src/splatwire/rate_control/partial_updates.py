"""Updates of a scene in training: each update contains only the Gaussians with the largest visible changes."""

# A training step changes all Gaussians, so an update with all changes is as large as the scene.

import logging
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int64

from splatwire.bitstream import PRESETS
from splatwire.codec.decoding import decode_stream
from splatwire.codec.encoding import encode_scene
from splatwire.codec.update.chain import UpdateChain
from splatwire.errors import InvalidValueError
from splatwire.ops.knn import NeighborTree
from splatwire.render.importance import surrounding_cameras
from splatwire.render.picture_changes import picture_changes
from splatwire.types.anchors import MIN_SIZE
from splatwire.types.background import BLACK, Background
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
SHARE = 0.077
"""Default maximum share of the Gaussians in an update."""
COARSE_CLASS = -1
"""Class offset of the sent Gaussians while more Gaussians have changed than an update may contain."""
VIEWS, VIEW_SIZE = (13, 14, 16, 17), 192
"""Numbers of views for measuring changes, used in turn, and size of the views in pixels. The poses of the views depend
on their number. A Gaussian that is hidden in the views of one update is visible in the views of a later update.
"""
NEW_CHANGE = 2.0
"""Change of a Gaussian that the receivers do not have, in the unit of `changes`."""
MAX_GROWTH = 2.0
"""Maximum factor by which the number of Gaussians or the size of the scene may grow or shrink after the whole scene was
sent. Beyond this factor, the whole scene is sent again, because lattice, quantisation steps and context tables no
longer fit.
"""


def changes(before: Splats, after: Splats) -> Float[np.ndarray, "G"]:
    """Returns how much each Gaussian has changed during training, as a number without unit; 0 for no change.

    Args:
        before: Gaussians before the change.
        after: These Gaussians after the change; Gaussian i of `before` is Gaussian i of `after`.
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
        finest: Number of the finest precision class (set of quantisation steps) in the first stream. The coarsest class
            has the number 0.
        newest: Gaussians of the newest scene.
        held: Values of the Gaussians at the receivers, before quantisation, in the order of `newest`; undefined where
            `known` is False.
        known: Mask of the Gaussians that the receivers have.
        coarse: Mask of the Gaussians that were last sent with larger quantisation steps (class `COARSE_CLASS`).
        num_at_first: Number of drawable Gaussians when the whole scene was sent.
        size_at_first: Size of the scene when the whole scene was sent, world units.
        num_pushed: Number of scenes pushed since the whole scene was sent.
        antialiased: True if the scene was trained with an antialiased renderer.
        origin: World coordinates that the Gaussians' positions are relative to.
        background: Colour of the background.
    """

    # Sizes are from `_scene_size`.

    chain: UpdateChain
    finest: int
    newest: Splats
    held: Splats
    known: Bool[np.ndarray, "G"]
    coarse: Bool[np.ndarray, "G"]
    num_at_first: int
    size_at_first: float
    num_pushed: int = 0
    antialiased: bool = False
    origin: Origin = NO_ORIGIN
    background: Background = BLACK

    @staticmethod
    def start(
        splats: Splats, antialiased: bool = False, origin: Origin = NO_ORIGIN, background: Background = BLACK
    ) -> "PartialUpdates":
        """Encodes all Gaussians of a scene as the first stream, the base of later updates.

        Args:
            splats: The Gaussians.
            antialiased: True if the Gaussians were trained with an antialiased renderer.
            origin: World coordinates that the positions are relative to.
            background: Colour of the background.

        Returns:
            The sender, with the first stream in `chain`.

        Raises:
            InvalidValueError: If no Gaussian can be drawn, or values are too large.
        """
        scene = SplatScene(splats, background=background, antialiased=antialiased, origin=origin)
        stream = encode_scene(scene, PRESETS["datagram"])
        known = SplatScene(splats).drawable.copy()
        size = _scene_size(splats.select(known))
        chain, coarse = UpdateChain(stream, stream), np.zeros(len(known), bool)
        finest, count = int(decode_stream(stream).scene.coding.precision_classes.max()), int(known.sum())
        return PartialUpdates(
            chain, finest, splats, splats, known, coarse, count, size,
            antialiased=antialiased, origin=origin, background=background,
        )  # fmt: skip

    def _restarted(self, splats: Splats) -> "PartialUpdates":
        return PartialUpdates.start(splats, self.antialiased, self.origin, self.background)

    def pushed(self, splats: Splats, share: float = SHARE) -> "PartialUpdates":
        """Encodes the largest changes of the Gaussians as an update, and leaves smaller changes for later calls.

        If `splats` has as many Gaussians as the newest scene so far, both must have the same order. Otherwise,
        Gaussians are matched by position. Gaussians without a match are new or removed. The whole scene is encoded
        again if an update cannot express the change.

        Args:
            splats: The newest Gaussians.
            share: Maximum share of the Gaussians to send, above 0, at most 1.

        Returns:
            The sender after this update, with the update in `chain`; this object does not change.

        Raises:
            InvalidValueError: If no Gaussian can be drawn, or values are too large.
        """
        # While more Gaussians have changed than the share allows, they are sent with a coarser class. They are sent
        # again once all changes have been sent: after at most `2 / share` calls with the same Gaussians, the receivers
        # have them in full precision. Removed Gaussians do not count towards the share. An update cannot express
        # another degree of spherical harmonics, positions outside the lattice, or more than twice or less than half the
        # number of Gaussians or the size.
        count = splats.num_gaussians
        drawable = SplatScene(splats).drawable
        if not drawable.any():
            raise InvalidValueError("no Gaussian can be drawn")
        ratios = drawable.sum() / self.num_at_first, _scene_size(splats.select(drawable)) / self.size_at_first
        if splats.degree != self.newest.degree or any(not 1 / MAX_GROWTH <= ratio <= MAX_GROWTH for ratio in ratios):
            return self._restarted(splats)
        held, known, coarse = self._receiver_versions(splats)
        known &= drawable
        most = max(1, round(share * count))
        chosen = _changed(held, known, splats, drawable)
        in_motion = len(chosen) > most
        if in_motion:
            order = _by_change(held, known, splats, drawable, VIEWS[self.num_pushed % len(VIEWS)])
            chosen = order[np.isin(order, chosen)]
        if not in_motion:
            chosen = np.concatenate([chosen, np.setdiff1d(np.flatnonzero(coarse & known), chosen)])
        chosen = chosen[:most]
        mixed = Splats(**{name: values.copy() for name, values in vars(held).items()})
        for name, values in vars(mixed).items():
            values[chosen] = getattr(splats, name)[chosen]
        known[chosen], coarse[chosen] = True, in_motion
        classes = np.where(coarse[known], COARSE_CLASS, 0).astype(np.int8)
        try:
            sent = SplatScene(
                mixed.select(known), background=self.background, antialiased=self.antialiased, origin=self.origin
            )
            chain = self.chain.edited(sent, self.finest, classes)
        except InvalidValueError as error:
            LOG.warning("update: %s; the whole scene is sent again", error)
            return self._restarted(splats)
        count = self.num_pushed + 1
        return replace(self, chain=chain, newest=splats, held=mixed, known=known, coarse=coarse, num_pushed=count)

    def _receiver_versions(self, splats: Splats) -> tuple[Splats, Bool[np.ndarray, "G"], Bool[np.ndarray, "G"]]:
        """Finds, for each Gaussian of a new scene, the version of this Gaussian that the receivers have.

        Args:
            splats: Gaussians of the new scene.

        Returns:
            Three items: the receivers' versions, arbitrary for new Gaussians; mask of the Gaussians that the receivers
            have; and mask of the Gaussians that were last sent with larger quantisation steps (class `COARSE_CLASS`).
        """
        if splats.num_gaussians == self.newest.num_gaussians:
            return self.held, self.known.copy(), self.coarse.copy()
        match = match_by_position(self.newest.means, splats.means)
        known = (match >= 0) & self.known[match]
        return self.held.select(np.maximum(match, 0)), known, known & self.coarse[match]


def _scene_size(splats: Splats) -> float:
    """Returns the median distance of Gaussians from their median position, world units."""
    return float(np.median(np.linalg.norm(splats.means - np.median(splats.means, axis=0), axis=1))) + MIN_SIZE


def match_by_position(before: Float[np.ndarray, "F 3"], after: Float[np.ndarray, "G 3"]) -> Int64[np.ndarray, "G"]:
    """Matches points that are each other's nearest neighbours.

    Args:
        before: Points before a change, at least one.
        after: Points after the change, at least one.

    Returns:
        For each point of `after`, index of its match in `before`; -1 without a match.
    """
    before, after = (np.nan_to_num(points, nan=0.0, posinf=0.0, neginf=0.0) for points in (before, after))
    nearest, back = NeighborTree(before).query(after, 1)[0][:, 0], NeighborTree(after).query(before, 1)[0][:, 0]
    return np.where(back[nearest] == np.arange(len(after)), nearest, -1)


def _changed(at_receivers: Splats, known: np.ndarray, newest: Splats, drawable: np.ndarray) -> Int64[np.ndarray, "K"]:
    """Returns the indices of the Gaussians that are new to the receivers, or have changed since the last sending.

    Args:
        at_receivers: Values of the Gaussians at the receivers.
        known: Mask of the Gaussians that the receivers have.
        newest: The newest values of the same Gaussians.
        drawable: Mask of the Gaussians that can be drawn. Only these are returned.
    """
    differs = ~known
    for name, values in vars(newest).items():
        differs |= (values != getattr(at_receivers, name)).reshape(len(differs), -1).any(axis=1)
    return np.flatnonzero(differs & drawable)


def _by_change(
    at_receivers: Splats, known: np.ndarray, newest: Splats, drawable: np.ndarray, num_views: int
) -> Int64[np.ndarray, "K"]:
    """Sorts the drawable Gaussians by the visible change in rendered pictures; returns their indices.

    The largest change comes first. Gaussians outside of all pictures come last.

    Args:
        at_receivers: Versions of the Gaussians that the receivers have.
        known: Mask of the Gaussians that the receivers have.
        newest: The newest Gaussians.
        drawable: Mask of the Gaussians that can be drawn.
        num_views: Number of views for measuring changes of the pictures.
    """
    rows = np.flatnonzero(drawable)
    before, after, new = at_receivers.select(rows), newest.select(rows), ~known[rows]
    for name, values in vars(before).items():  # rows that the receivers do not have are undefined
        values[new] = 0 if name == "opacities" else getattr(after, name)[new]
    change = np.where(new, NEW_CHANGE, changes(before, after))
    seen = picture_changes(before, after, surrounding_cameras(SplatScene(after), num_views, VIEW_SIZE))
    # Gaussians outside of all views come last, in the order of their change.
    return rows[np.lexsort((-change, -seen))]
