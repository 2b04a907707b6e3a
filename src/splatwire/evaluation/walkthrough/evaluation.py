"""Image quality along a camera path while a scene is streamed: PSNR of the view over time."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from splatwire.anchors.appearance import explicit_gaussians
from splatwire.bitstream import SceneStream, arrived_blocks
from splatwire.bitstream.tile_selection import Viewpoint, cut_of, finer_tile_of
from splatwire.bitstream.tiles import Tiles
from splatwire.codec import decode_stream
from splatwire.evaluation.walkthrough.delivery import Delivery, Link, deliver
from splatwire.evaluation.walkthrough.path import Walk, viewpoint_of
from splatwire.lod.tiles import tiles_of
from splatwire.metrics import psnr
from splatwire.render import Renderer, iterate_views
from splatwire.types.scene import Scene

SETTLED_DB = 1.0
"""Maximum PSNR deficit against the complete scene at which the view counts as complete, decibels."""
OnPicture = Callable[[float, Float[np.ndarray, "H W 3"], Float[np.ndarray, "H W 3"]], None]
"""Called with a time in seconds, the rendered image and the reference image."""


@runtime_checkable
class ProgressiveSource(Protocol):
    """Typing protocol (structural type) for a scene that is received over time and can be drawn at any time."""

    def shown(self, seconds: float, viewpoint: Viewpoint) -> Scene:
        """Returns the scene as a receiver draws it at a given time.

        Args:
            seconds: Time since the request for the scene, seconds.
            viewpoint: Viewpoint of the receiver, which determines the drawn tiles.
        """

    def complete(self, viewpoint: Viewpoint) -> Scene:
        """Returns the scene that a receiver draws for a viewpoint once the full stream has been received."""

    def bytes_at(self, seconds: float) -> int:
        """Returns the number of bytes received up to a time. The time is given in seconds since the request."""


@dataclass(frozen=True)
class QualitySample:
    """Image quality at one time of a camera path.

    Attributes:
        seconds: Time since the request, seconds.
        psnr: PSNR against the reference image, decibels; infinite if equal.
        complete_psnr: PSNR of the completely received scene at the same viewpoint, decibels.
        num_bytes: Bytes received until this time.
        num_gaussians: Number of Gaussians drawn.
    """

    seconds: float
    psnr: float
    complete_psnr: float
    num_bytes: int
    num_gaussians: int


def score_walk(
    source: ProgressiveSource, reference: Scene, walk: Walk, times: Sequence[float], *,
    renderer: str | Renderer = "cpu", background: Float[np.ndarray, "3"] | None = None,
    on_picture: OnPicture | None = None, progress: Callable[[float], None] | None = None,
) -> list[QualitySample]:  # fmt: skip
    """Compares images of a partially received scene along a camera path with images of a reference scene.

    Args:
        source: The scene that is received over time.
        reference: Reference scene.
        walk: Camera path.
        times: Times of the comparison, seconds since the request.
        renderer: A renderer or its name.
        background: RGB of the background; None for the background of the reference scene.
        on_picture: Receives the compared images.
        progress: Called with the finished share, 0 to 1.
    """
    moments, behind = [], np.array(reference.background) if background is None else background
    for number, seconds in enumerate(times):
        camera = walk.at(seconds)
        viewpoint = viewpoint_of(camera)
        shown = source.shown(seconds, viewpoint)
        scenes = (reference, shown, source.complete(viewpoint))
        pictures = [
            np.stack(list(iterate_views(scene, camera, renderer=renderer, background=behind))) for scene in scenes
        ]
        now, later = (float(psnr(picture, pictures[0])[0]) for picture in pictures[1:])
        moments.append(QualitySample(seconds, now, later, source.bytes_at(seconds), shown.num_elements))
        if on_picture:
            on_picture(seconds, pictures[1][0], pictures[0][0])
        if progress:
            progress((number + 1) / len(times))
    return moments


def time_to_quality(moments: Sequence[QualitySample]) -> float | None:
    """Returns the time after which every picture is nearly as good as that of the complete scene.

    A picture is nearly as good if its PSNR is at most `SETTLED_DB` lower.

    Args:
        moments: Quality of the pictures at several times, ascending by time.

    Returns:
        Seconds since the request; None if the last picture is not nearly as good.
    """
    # From then on, the PSNR of each picture is at most `SETTLED_DB` below that of the completely received scene.
    reached_at = None
    for moment in reversed(moments):
        if moment.psnr < moment.complete_psnr - SETTLED_DB:
            break
        reached_at = moment.seconds
    return reached_at


@dataclass(frozen=True, eq=False)
class StreamedWalkthrough:
    """A scene with levels of detail that is received along a camera path, by simulated transmission.

    Attributes:
        scene: The decoded scene with all levels.
        tiles: The tiles of the scene.
        packet_of: Index of each Gaussian's packet, int64 (N).
        replaced_tile: Index of the finer tile that replaces each Gaussian, int64 (N); -1 for Gaussians of the finest
            level.
        delivery: Arrival times of the packets.
        head_bytes: Bytes of the manifest and the side information.
    """

    scene: Scene
    tiles: Tiles
    packet_of: np.ndarray
    replaced_tile: np.ndarray
    delivery: Delivery
    head_bytes: int

    @staticmethod
    def of(
        stream: SceneStream, walk: Walk, link: Link, progress: Callable[[float], None] | None = None
    ) -> "StreamedWalkthrough":
        """Simulates how a viewer who moves along a camera path receives a stream.

        Args:
            stream: Complete stream with levels of detail.
            walk: Camera path of the viewer.
            link: Network link to the viewer.
            progress: Called with the simulated share of the duration.
        """
        tiles, delivery = tiles_of(stream), deliver(stream, walk.viewpoint, walk.seconds, link, progress)
        packet_of, first = np.empty(stream.manifest.num_elements, dtype=np.int64), 0
        for block in arrived_blocks(stream.manifest.plan, stream.packets):  # ordered by id, as in `Delivery`
            for members in block.members:
                packet_of[members] = first
                first += 1
        scene = replace(decode_stream(stream).scene, hints=None)
        replaced_tile = _replaced_tile(tiles, delivery.tile_of_packet[packet_of], scene)
        return StreamedWalkthrough(
            scene, tiles, packet_of, replaced_tile, delivery, stream.num_bytes - int(tiles.sizes.sum())
        )

    def shown(self, seconds: float, viewpoint: Viewpoint) -> Scene:
        """Returns the scene as a receiver draws it at a given time.

        Args:
            seconds: Time since the request for the scene, seconds.
            viewpoint: Viewpoint of the receiver, which determines the drawn tiles.
        """
        return self._drawn(self.delivery.drawable(self.tiles, seconds), self.delivery.arrivals <= seconds, viewpoint)

    def complete(self, viewpoint: Viewpoint) -> Scene:
        """Returns the scene that a receiver draws for a viewpoint once the full stream has been received."""
        everything = np.ones(self.tiles.num_tiles, dtype=bool), np.ones(len(self.delivery.arrivals), dtype=bool)
        return self._drawn(*everything, viewpoint)

    def bytes_at(self, seconds: float) -> int:
        """Returns the number of bytes received up to a time. The time is given in seconds since the request."""
        return (self.head_bytes if seconds >= self.delivery.head else 0) + self.delivery.bytes_at(seconds)

    @property
    def time_to_coarsest_level(self) -> float:
        """Returns the time since the request at which the coarsest level of detail is completely received, seconds.

        From this time on, every part of the scene can be drawn. The time is infinite if a packet of the level never
        arrives.
        """
        return float(self.delivery.arrivals[self.tiles.parents[self.delivery.tile_of_packet] < 0].max())

    def _drawn(self, drawable: np.ndarray, received: np.ndarray, viewpoint: Viewpoint) -> Scene:
        drawn = np.zeros(self.tiles.num_tiles + 1, dtype=bool)  # the last entry is for index -1, the finest level
        drawn[list(cut_of(self.tiles, drawable, viewpoint).drawn)] = True
        shown = (drawn[self.delivery.tile_of_packet] & received)[self.packet_of] & ~drawn[self.replaced_tile]
        return self.scene.select(shown)


def _replaced_tile(tiles: Tiles, tile_of: np.ndarray, scene: Scene) -> np.ndarray:
    """Finds, for each Gaussian, the tile of the next finer level of detail that replaces it.

    Args:
        tiles: All tiles.
        tile_of: Index of each Gaussian's own tile, (N).
        scene: The scene with all N Gaussians.

    Returns:
        Index of the finer tile for each Gaussian, int64 (N); -1 for Gaussians of the finest level.
    """
    splats = explicit_gaussians(scene)
    assert splats is not None  # only explicit Gaussians have levels
    order, means = np.argsort(tile_of, kind="stable"), splats.means.astype(np.float64)
    replaced, edges = (
        np.empty(len(order), dtype=np.int64),
        np.searchsorted(tile_of[order], np.arange(tiles.num_tiles + 1)),
    )
    for tile, (first, end) in enumerate(itertools.pairwise(edges.tolist())):
        replaced[order[first:end]] = finer_tile_of(tiles, tile, means[order[first:end]])
    return replaced
