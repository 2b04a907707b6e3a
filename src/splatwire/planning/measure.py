"""Measures by how much the loss of each importance tier degrades the rendered pictures."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from splatwire.anchors.appearance import origin_of
from splatwire.arguments import array_of, checked
from splatwire.bitstream import SceneStream, send_sequence
from splatwire.bitstream.limits import MAX_ELEMENTS
from splatwire.bitstream.sections import sections_of
from splatwire.codec import decode_stream
from splatwire.codec.preview import SECTION as PREVIEW
from splatwire.codec.preview import preview_scene
from splatwire.codec.tiers import assign_stream_packets, read_tiers
from splatwire.concealment import conceal, create_concealer
from splatwire.concealment.grow import Grow
from splatwire.concealment.sketch import SECTION as SKETCH
from splatwire.errors import InvalidValueError, shown, whole_number
from splatwire.evaluation.views import spread
from splatwire.ops.arrays import to_numpy
from splatwire.ops.twister import Twister
from splatwire.planning.distortion import BLANK_PSNR, DistortionModel, StreamVariant
from splatwire.planning.transfer_model import StreamLoad
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.types import Cameras
from splatwire.types.received_scene import ReceivedScene
from splatwire.types.scene import Scene

MAX_SEED = (1 << 32) - 1
SHARES = (0.0, 0.05, 0.15, 0.3, 0.6, 1.0)
ASSUMED_BASE_MSE = 1e-3
"""Mean squared error of the complete scene that is assumed without photos, as for a scene with 30 dB PSNR."""


class LossyPictures:
    """Renders a scene after losses and concealment, and measures the error of the pictures.

    The error is measured against photos, or against pictures of the complete scene if there are no photos.

    Args:
        complete: The decoded scene without losses.
        cameras: Views to render.
        concealer: Name of the concealer.
        photos: Photos of the views; empty to compare with the complete scene.
        base_mse: Assumed mean squared error of the complete scene against photos. It is added to all measured errors if
            `photos` is empty.

    Raises:
        InvalidValueError: If the stream is incomplete, `base_mse` is not positive, or numbers of photos and cameras
            differ.
        UnknownNameError: If the concealer is unknown.
    """

    @checked
    def __init__(
        self,
        complete: ReceivedScene,
        cameras: Cameras,
        concealer: str,
        *,
        photos: Sequence[Any] = (),
        base_mse: float = ASSUMED_BASE_MSE,
    ) -> None:
        lost = complete.loss_mask.num_lost
        if lost:
            raise InvalidValueError(f"damage needs a complete stream, and {lost} {complete.scene.ELEMENTS} are lost")
        if not 0 < base_mse < math.inf:
            raise InvalidValueError(f"base_mse must be positive, not {shown(base_mse)}")
        if len(photos) not in (0, cameras.num_views):
            raise InvalidValueError(f"{len(photos)} photos of {cameras.num_views} views")
        self.num_elements = complete.scene.num_elements
        self._complete, self._cameras = complete, cameras
        self._references = [to_numpy(photo) for photo in photos] or list(iterate_views(complete.scene, cameras))
        self._base = 0.0 if len(photos) else base_mse
        chosen = create_concealer(concealer)
        self._concealer = chosen.with_neighbors(complete) if isinstance(chosen, Grow) else chosen

    def scene(self, fully_received: Bool[np.ndarray, "N"]) -> Scene:
        """Returns the scene after losses and concealment.

        Args:
            fully_received: Mask of the received elements, bool (N).
        """
        return (
            self._complete.scene
            if bool(fully_received.all())
            else conceal(self._complete.masked(fully_received), self._concealer)
        )

    def errors(self, fully_received: Bool[np.ndarray, "N"]) -> np.ndarray:
        """Returns the mean squared error of each view after losses and concealment, float64 (views).

        Args:
            fully_received: Mask of the received elements, bool (N).
        """
        pictures = iterate_views(self.scene(fully_received), self._cameras)
        pairs = zip(pictures, self._references, strict=True)
        return self._base + np.array([_mean_square(image - truth) for image, truth in pairs])

    def psnr(self, fully_received: Bool[np.ndarray, "N"]) -> float:
        """Returns the mean PSNR of the views after losses and concealment, decibels.

        Args:
            fully_received: Mask of the received elements, bool (N).
        """
        return float((-10 * np.log10(self.errors(fully_received))).mean())

    def preview_psnr(self, preview: bytes) -> float:
        """Returns the mean PSNR, decibels, if the receiver has only the preview.

        A preview is a small, coarse version of the scene, which is sent before all other data.

        Args:
            preview: Encoded preview.

        Raises:
            BitstreamError: If the preview is malformed.
        """
        scene = replace(preview_scene(preview), origin=origin_of(self._complete.scene))
        pictures = iterate_views(scene, self._cameras)
        errors = [_mean_square(a - b) for a, b in zip(pictures, self._references, strict=True)]
        return float((-10 * np.log10(self._base + np.array(errors))).mean())


def _mean_square(error: np.ndarray) -> float:
    return float((error.astype(np.float64) ** 2).mean())


@checked
def measure_distortion(
    pictures: LossyPictures,
    tiers: UInt8[np.ndarray, "N"],
    *,
    loss_shares: tuple[float, ...] = SHARES,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> DistortionModel:
    """Measures how the loss of each importance tier degrades the pictures, by rendering simulated losses.

    Args:
        pictures: Renders the scene with losses.
        tiers: Importance tier of each element, 0 for the most important.
        loss_shares: Shares of lost elements to simulate, ascending from 0.
        seed: Seed of the losses.
        progress: Called with the completed fraction.
    """
    tiers = array_of(tiers, "tiers", (pictures.num_elements,), "i", 0, 255)
    _check_shares(loss_shares)
    whole_number(seed, "seed", 0, MAX_SEED)
    draw, num_tiers = Twister(seed).uniform(len(tiers)), int(tiers.max()) + 1
    sending_position = np.empty(len(tiers), np.float32)
    for tier in range(num_tiers):  # stratified: a share of each tier, not of all anchors
        members = np.flatnonzero(tiers == tier)
        sending_position[members[draw[members].argsort(kind="stable")]] = np.arange(len(members)) / len(members)
    base = float(pictures.errors(np.ones(len(tiers), np.bool_)).mean())
    mse = np.zeros((num_tiers, len(loss_shares)))
    for tier in range(num_tiers):
        for s, share in enumerate(loss_shares[1:], start=1):
            mse[tier, s] = float(pictures.errors((tiers < tier) | (sending_position >= share)).mean()) - base
            if progress:
                progress((tier * (len(loss_shares) - 1) + s) / (num_tiers * (len(loss_shares) - 1)))
    return DistortionModel(np.array(loss_shares), np.maximum.accumulate(mse, axis=1), base)


def _check_shares(shares: tuple[float, ...]) -> None:
    rising = len(shares) > 1 and all(before < after for before, after in itertools.pairwise(shares))
    if not rising or shares[0] != 0 or not shares[-1] <= 1:
        raise InvalidValueError(f"loss_shares: expected lost shares that ascend from 0, up to 1, not {shown(shares)}")


@checked
def variant_of_stream(
    stream: SceneStream,
    pictures: LossyPictures,
    *,
    concealment_bytes: int = 0,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> StreamVariant:
    """Measures how packet loss degrades the pictures of a stream, and returns the stream as a variant for the planner.

    Args:
        stream: Complete stream.
        pictures: Renders the decoded scene with losses.
        concealment_bytes: Bytes of the side information that only loss concealment uses. The preview is not included.
        seed: Seed of the losses.
        progress: Called with the completed fraction.
    """
    whole_number(concealment_bytes, "concealment_bytes")
    sections = sections_of(stream)
    tiers, preview = read_tiers(sections, stream.manifest), sections.get(PREVIEW, b"")
    distortion = measure_distortion(pictures, tiers, seed=seed, progress=progress)
    members = packet_members(stream)

    def picture(packets: np.ndarray) -> float:
        return pictures.psnr(received_elements(members, packets, pictures.num_elements))

    blank = pictures.preview_psnr(preview) if preview else BLANK_PSNR
    # The preview is sent twice: in the welcome and with the side information.
    return StreamVariant(
        StreamLoad.of_stream(stream), distortion, picture, concealment_bytes + len(preview), len(preview), blank
    )


@checked
def measured_variant(
    stream: SceneStream, *, cameras: Cameras | None, num_views: int, concealer: str | None, seed: int,
    progress: Callable[[float], None],
) -> StreamVariant:  # fmt: skip
    """Measures how packet loss degrades the pictures of a stream, and returns the stream as a variant for the planner.

    Args:
        stream: Complete stream.
        cameras: Cameras of the scene; None for generated cameras around it.
        num_views: Maximum number of cameras to render.
        concealer: Name of the receiver's concealer; None for the default. Not used for streams with redundant copies.
        seed: Seed of the losses.
        progress: Called with the completed fraction.

    Raises:
        InvalidValueError: If `num_views` is not positive, or the seed is out of range.
    """
    whole_number(num_views, "num_views", 1)
    complete, copies = decode_stream(stream), sections_of(stream).get(SKETCH, b"")
    seen = surrounding_cameras(complete.scene) if cameras is None else cameras
    seen = seen.select(spread(seen.num_views, num_views))
    pictures = LossyPictures(complete, seen, "sketch" if copies else concealer or "grow")
    return variant_of_stream(stream, pictures, concealment_bytes=len(copies), seed=seed, progress=progress)


@checked
def packet_members(stream: SceneStream) -> list[np.ndarray]:
    """Returns the indices of the elements in each packet; packets are in sending order.

    Indices are those before sorting by importance tier.
    """
    members, packets = assign_stream_packets(stream)
    parts = [members.indices[a:b].copy() for a, b in itertools.pairwise(members.starts)]
    indices = {p.id: part for p, part in zip(packets, parts, strict=True) if p is not None}
    return [indices[packet.id] for packet in send_sequence(stream, "tiers")]


@checked
def received_elements(
    packet_members: Sequence[np.ndarray], packets: np.ndarray, num_elements: int
) -> Bool[np.ndarray, "N"]:
    """Returns the mask of the elements that are received if only some packets arrive, bool (N).

    Args:
        packet_members: Indices of the elements in each packet, from `packet_members`.
        packets: Mask of available packets, bool (P).
        num_elements: Number of elements, N.
    """
    packets = array_of(packets, "packets", ("P",), "b")
    if len(packet_members) != len(packets):
        raise InvalidValueError(
            f"packet_members: expected one array for each of {len(packets)} packets, not {len(packet_members)}"
        )
    received = np.zeros(whole_number(num_elements, "num_elements", 0, MAX_ELEMENTS), np.bool_)
    try:
        for index in np.flatnonzero(packets).tolist():
            received[packet_members[index]] = True
    except IndexError as error:
        raise InvalidValueError(f"packet_members: an index is not below num_elements, {num_elements}") from error
    return received
