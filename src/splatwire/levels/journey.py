"""What somebody sees who walks through a scene while it arrives: PSNR of the view over time."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from splatwire.codec import decode_stream
from splatwire.levels.delivery import Delivery, Link, deliver
from splatwire.levels.tiles import tiles_of
from splatwire.levels.walk import Walk, look_of
from splatwire.metrics import psnr
from splatwire.model.appearance import Scene, explicit_gaussians
from splatwire.packets import SceneStream, arrived_blocks
from splatwire.packets.tiles import Tiles
from splatwire.packets.view import Look, cut_of, stands_for
from splatwire.render import Renderer, render_scene

SETTLED_DB = 1.0
"""A view has settled when it is so near to what it is with everything there, decibels."""
OnPicture = Callable[[float, Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W 3"]], None]
"""Called with a time, the picture and that of the reference."""


@runtime_checkable
class Show(Protocol):
    """What is drawn of a scene while it arrives."""

    def shown(self, seconds: float, look: Look) -> Scene:
        """What is drawn at a time."""

    def complete(self, look: Look) -> Scene:
        """What is drawn when everything is there."""

    def bytes_at(self, seconds: float) -> int:
        """What came until a time."""


@dataclass(frozen=True)
class Moment:
    """What is seen at a time.

    Attributes:
        seconds: Since somebody asked for the scene.
        psnr: Of the picture against that of the reference, decibels; infinite where they are equal.
        complete_psnr: The same if everything were there.
        num_bytes: What came until then.
        num_gaussians: Gaussians that are drawn.
    """

    seconds: float
    psnr: float
    complete_psnr: float
    num_bytes: int
    num_gaussians: int


def score_walk(
    show: Show, reference: Scene, walk: Walk, times: Sequence[float], *, renderer: str | Renderer = "cpu",
    background: Float[np.ndarray, "3"] | None = None, on_picture: OnPicture | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Moment]:  # fmt: skip
    """Compares what is drawn along a walk with a reference.

    Args:
        show: What is drawn.
        reference: What ought to be seen.
        walk: Where from.
        times: When, seconds.
        renderer: A renderer or its name.
        background: RGB behind everything; that of the reference where absent.
        on_picture: Gets the pictures.
        progress: Called with the share of the work that is done.
    """
    moments, behind = [], np.array(reference.background) if background is None else background
    for number, seconds in enumerate(times):
        camera = walk.at(seconds)
        look = look_of(camera)
        here = show.shown(seconds, look)
        scenes = (reference, here, show.complete(look))
        pictures = [render_scene(scene, camera, renderer=renderer, background=behind) for scene in scenes]
        now, later = (float(psnr(picture, pictures[0])[0]) for picture in pictures[1:])
        moments.append(Moment(seconds, now, later, show.bytes_at(seconds), here.num_elements))
        if on_picture:
            on_picture(seconds, pictures[1][0], pictures[0][0])
        if progress:
            progress((number + 1) / len(times))
    return moments


def settled(moments: Sequence[Moment]) -> float | None:
    """The time from which on every picture is within `SETTLED_DB` of the complete one; None if the last one is not."""
    found = None
    for moment in reversed(moments):
        if moment.psnr < moment.complete_psnr - SETTLED_DB:
            break
        found = moment.seconds
    return found


@dataclass(frozen=True, eq=False)
class Journey:
    """A stream with levels that arrives while somebody walks; see `Show`.

    Attributes:
        scene: All of its Gaussians, decoded.
        tiles: Its tiles.
        packet_of: Packet of each Gaussian, int64 (N).
        instead_of: Finer tile that each Gaussian stands for, int64 (N); -1 of the finest level.
        delivery: When they come.
        head_bytes: Of manifest and side information.
    """

    scene: Scene
    tiles: Tiles
    packet_of: np.ndarray
    instead_of: np.ndarray
    delivery: Delivery
    head_bytes: int

    @staticmethod
    def of(stream: SceneStream, walk: Walk, link: Link, progress: Callable[[float], None] | None = None) -> "Journey":
        """Sends a complete stream along a walk; see `deliver`."""
        tiles, delivery = tiles_of(stream), deliver(stream, walk.look, walk.seconds, link, progress)
        packet_of, first = np.empty(stream.manifest.num_elements, dtype=np.int64), 0
        for block in arrived_blocks(stream.manifest.plan, stream.packets):  # by their ids, as deliveries have them
            for run in block.runs:
                packet_of[block.ranks[run]] = first
                first += 1
        scene = replace(decode_stream(stream).scene, hints=None)
        instead_of = _instead_of(tiles, delivery.blocks[packet_of], scene)
        return Journey(scene, tiles, packet_of, instead_of, delivery, stream.num_bytes - int(tiles.sizes.sum()))

    def shown(self, seconds: float, look: Look) -> Scene:
        """See `Show.shown`."""
        return self._drawn(self.delivery.there(self.tiles, seconds), self.delivery.arrivals <= seconds, look)

    def complete(self, look: Look) -> Scene:
        """See `Show.complete`."""
        everything = np.ones(self.tiles.num_tiles, dtype=bool), np.ones(len(self.delivery.arrivals), dtype=bool)
        return self._drawn(*everything, look)

    def bytes_at(self, seconds: float) -> int:
        """See `Show.bytes_at`."""
        return (self.head_bytes if seconds >= self.delivery.head else 0) + self.delivery.bytes_at(seconds)

    @property
    def whole_at(self) -> float:
        """When every part of the scene was there at some level, seconds; infinite if it never was."""
        return float(self.delivery.arrivals[self.tiles.parents[self.delivery.blocks] < 0].max())

    def _drawn(self, there: np.ndarray, came: np.ndarray, look: Look) -> Scene:
        drawn = np.zeros(self.tiles.num_tiles + 1, dtype=bool)  # the last one is what the finest level stands for
        drawn[list(cut_of(self.tiles, there, look).drawn)] = True
        shown = (drawn[self.delivery.blocks] & came)[self.packet_of] & ~drawn[self.instead_of]
        return self.scene.select(shown)


def _instead_of(tiles: Tiles, tile_of: np.ndarray, scene: Scene) -> np.ndarray:
    """Finer tile that each Gaussian stands for."""
    splats = explicit_gaussians(scene)
    assert splats is not None  # nothing else has levels
    order, means = np.argsort(tile_of, kind="stable"), splats.means.astype(np.float64)
    found, edges = np.empty(len(order), dtype=np.int64), np.searchsorted(tile_of[order], np.arange(tiles.num_tiles + 1))
    for tile, (first, end) in enumerate(itertools.pairwise(edges.tolist())):
        found[order[first:end]] = stands_for(tiles, tile, means[order[first:end]])
    return found
