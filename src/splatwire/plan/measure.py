"""What losing each tier of importance does to the picture: the numbers that a planner splits a budget by."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from splatwire.codec.preview import SECTION as PREVIEW
from splatwire.codec.preview import preview_scene
from splatwire.codec.tiers import arrange_stream, read_tiers
from splatwire.conceal import conceal, create_concealer
from splatwire.conceal.grow import Grow
from splatwire.errors import InvalidValueError
from splatwire.model.appearance import Partial, Scene, origin_of
from splatwire.ops.arrays import to_numpy
from splatwire.ops.twister import Twister
from splatwire.packets import SceneStream, send_sequence
from splatwire.packets.sections import sections_of
from splatwire.plan.damage import BLANK_PSNR, Damage, Offer
from splatwire.plan.outline import StreamLoad
from splatwire.render import iterate_views
from splatwire.scene import Cameras

SHARES = (0.0, 0.05, 0.15, 0.3, 0.6, 1.0)
ASSUMED_BASE_MSE = 1e-3
"""Of a scene that shows its photos at 30 dB; taken where nobody has photos."""


class LossyPictures:
    """Pictures of a scene that lost some elements, compared with the complete one or with photos.

    Who is near whom is found once, where that does not depend on what is lost.

    Args:
        complete: A decoded stream that lost nothing; its concealment sections are what the concealer sees.
        cameras: Where from; a few views are enough.
        concealer: What the receiver does about gaps.
        photos: One for each camera; without them pictures are compared with the complete scene's, the base is added.
        base_mse: Mean squared error of the complete scene against photos that are not there.

    Raises:
        InvalidValueError: If the stream lost something, or photos and cameras do not fit.
        UnknownNameError: No concealer has that name.
    """

    def __init__(
        self,
        complete: Partial,
        cameras: Cameras,
        concealer: str,
        *,
        photos: Sequence[Any] = (),
        base_mse: float = ASSUMED_BASE_MSE,
    ) -> None:
        lost = complete.erasures.num_lost
        if lost:
            raise InvalidValueError(f"damage needs a complete stream, and {lost} {complete.scene.ELEMENTS} are lost")
        if photos and len(photos) != cameras.num_views:
            raise InvalidValueError(f"{len(photos)} photos of {cameras.num_views} views")
        self.num_elements = complete.scene.num_elements
        self._complete, self._cameras = complete, cameras
        self._references = [to_numpy(photo) for photo in photos] or list(iterate_views(complete.scene, cameras))
        self._base = 0.0 if photos else base_mse
        chosen = create_concealer(concealer)
        self._concealer = chosen.knowing(complete) if isinstance(chosen, Grow) else chosen

    def scene(self, known: Bool[np.ndarray, "N"]) -> Scene:
        """The concealed scene."""
        return self._complete.scene if bool(known.all()) else conceal(self._complete.without(known), self._concealer)

    def errors(self, known: Bool[np.ndarray, "N"]) -> np.ndarray:
        """Mean squared error of each view for the elements that are there, float64 (views)."""
        pictures = iterate_views(self.scene(known), self._cameras)
        pairs = zip(pictures, self._references, strict=True)
        return self._base + np.array([_mean_square(image - truth) for image, truth in pairs])

    def psnr(self, known: Bool[np.ndarray, "N"]) -> float:
        """Mean PSNR of the views, decibels."""
        return float((-10 * np.log10(self.errors(known))).mean())

    def preview_psnr(self, preview: bytes) -> float:
        """Mean PSNR of what a receiver shows that has nothing but a preview, decibels.

        Raises:
            BitstreamError: If the bytes are no preview.
        """
        scene = replace(preview_scene(preview), origin=origin_of(self._complete.scene))
        pictures = iterate_views(scene, self._cameras)
        errors = [_mean_square(a - b) for a, b in zip(pictures, self._references, strict=True)]
        return float((-10 * np.log10(self._base + np.array(errors))).mean())


def _mean_square(error: np.ndarray) -> float:
    return float((error.astype(np.float64) ** 2).mean())


def measure_damage(
    pictures: LossyPictures,
    tiers: UInt8[np.ndarray, "N"],
    *,
    shares: tuple[float, ...] = SHARES,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Damage:
    """Loses shares of a tier and of all less important ones, conceals, draws, and compares.

    Args:
        pictures: Of the scene.
        tiers: Tier of every element.
        shares: Lost shares that are tried, ascending from 0.
        seed: Which anchors are lost.
        progress: Called with the share of the work that is done.

    Returns:
        The damage; what measured less than a smaller loss is raised to it.
    """
    draw, num_tiers = Twister(seed).uniform(len(tiers)), int(tiers.max()) + 1
    place = np.empty(len(tiers), np.float32)
    for tier in range(num_tiers):  # a share of each tier, not of all anchors
        members = np.flatnonzero(tiers == tier)
        place[members[draw[members].argsort(kind="stable")]] = np.arange(len(members)) / len(members)
    base = float(pictures.errors(np.ones(len(tiers), np.bool_)).mean())
    mse = np.zeros((num_tiers, len(shares)))
    for tier in range(num_tiers):
        for s, share in enumerate(shares[1:], start=1):
            mse[tier, s] = float(pictures.errors((tiers < tier) | (place >= share)).mean()) - base
            if progress:
                progress((tier * (len(shares) - 1) + s) / (num_tiers * (len(shares) - 1)))
    return Damage(np.array(shares), np.maximum.accumulate(mse, axis=1), base)


def offer_of(
    stream: SceneStream,
    pictures: LossyPictures,
    *,
    concealment_bytes: int = 0,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Offer:
    """What a planner has to know about a complete stream of the preset `datagram`.

    Args:
        stream: The stream.
        pictures: Of what it decodes to.
        concealment_bytes: Bytes of its side information that count as protection; those of a preview are added.
        seed: Of the losses that the damage is measured with.
        progress: Called with the share of the work that is done.
    """
    sections = sections_of(stream)
    tiers, preview = read_tiers(sections, stream.manifest), sections.get(PREVIEW, b"")
    damage = measure_damage(pictures, tiers, seed=seed, progress=progress)
    members = packet_members(stream)

    def picture(packets: np.ndarray) -> float:
        return pictures.psnr(known_elements(members, packets, pictures.num_elements))

    blank = pictures.preview_psnr(preview) if preview else BLANK_PSNR
    # it travels twice, in the welcome and with the side information
    return Offer(StreamLoad.of_stream(stream), damage, picture, concealment_bytes + len(preview), len(preview), blank)


def packet_members(stream: SceneStream) -> list[np.ndarray]:
    """Elements of each packet of a complete stream, by rank, in sending order."""
    groups, packets = arrange_stream(stream)
    cuts = [groups.ranks[a:b].copy() for a, b in itertools.pairwise(groups.starts)]
    ranks = {p.id: cut for p, cut in zip(packets, cuts, strict=True) if p is not None}
    return [ranks[packet.id] for packet in send_sequence(stream, "tiers")]


def known_elements(members: Sequence[np.ndarray], packets: np.ndarray, num_elements: int) -> Bool[np.ndarray, "N"]:
    """Elements that are there if some packets are.

    Args:
        members: Of `packet_members`.
        packets: Which packets are there, bool (P).
        num_elements: N.
    """
    known = np.zeros(num_elements, np.bool_)
    for place in np.flatnonzero(packets).tolist():
        known[members[place]] = True
    return known
