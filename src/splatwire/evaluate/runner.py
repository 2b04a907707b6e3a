"""Runs a protocol: send, decode, conceal, draw, score."""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.channel import transmit
from splatwire.codec import decode_stream
from splatwire.conceal import conceal
from splatwire.evaluate.lossmap import draw_loss_map
from splatwire.evaluate.protocol import Method, Protocol
from splatwire.evaluate.results import LPIPS_OF_MASKED, Evaluation, LossMap, Picture, Run, Scores
from splatwire.evaluate.total_bytes import bytes_needed
from splatwire.evaluate.views import Compared, ReferenceViews, spread, views_of
from splatwire.metrics import Lpips
from splatwire.model import AnchorScene, PartialScene
from splatwire.packets import SceneStream
from splatwire.scene import Erasures

Progress = Callable[[str, float], None]
Decode = Callable[[SceneStream], PartialScene]
_MAX_CACHED_BYTES = 1 << 30
"""LPIPS features of references that are kept; those of one 800x600 picture take a quarter of this."""


def evaluate_streams(
    protocol: Protocol,
    streams: Mapping[str, SceneStream],
    views: ReferenceViews,
    *,
    lpips: Lpips | None = None,
    decode: Decode = decode_stream,
    progress: Progress | None = None,
) -> Evaluation:
    """Runs a protocol on streams of one scene.

    A received stream is decoded once for all its methods. Streams with equally many packets meet the same losses.

    Args:
        protocol: What is compared.
        streams: The stream of each name that a method uses. They may have lost packets before.
        views: Cameras and references.
        lpips: LPIPS with its weights; None if they are absent.
        decode: How a received stream becomes a scene; by default in this process.
        progress: Called with the method and the share of its views that is done.

    Returns:
        All scores, and pictures of the hardest views.

    Raises:
        UnknownNameError: If there is no such concealer, renderer or stream.
        BitstreamError: If a stream cannot be decoded.
    """
    session = _Session(protocol, views, lpips, progress or _silent)
    runs: list[Run] = []
    for name, seed, methods in _transmissions(protocol):
        sent = received = streams[name]
        if seed is not None:
            received, _ = transmit(sent, protocol.loss, seed=seed, send_order=protocol.send_order)
        started = time.perf_counter()
        partial = decode(received)
        delivery = Delivery(
            seconds={"decode": time.perf_counter() - started},
            num_lost=partial.erasures.num_lost,
            num_lost_packets=sent.manifest.num_packets - len(received.packets),
            num_bytes_received=received.num_bytes,
        )
        keep = seed in (None, protocol.seeds[0])
        runs += [session.run(method, partial, delivery, seed=seed, keep=keep) for method in methods]
        if seed == protocol.seeds[0]:
            session.map_losses(name, partial.scene, partial.erasures)
    used = {name: streams[name] for name in dict.fromkeys(method.stream for method in protocol.methods)}
    return session.evaluation(
        runs,
        parts={name: stream.parts() for name, stream in used.items()},
        total_bytes={
            method.name: bytes_needed(streams[method.stream], "drop" if method.lossless else method.concealer)
            for method in protocol.methods
        },
        num_packets={name: stream.manifest.num_packets for name, stream in used.items()},
        num_anchors=next(iter(used.values())).manifest.num_anchors,
    )


def evaluate_scene(
    protocol: Protocol,
    scene: AnchorScene | PartialScene,
    erasures: Erasures | None,
    parts: Mapping[str, int],
    views: ReferenceViews,
    *,
    lpips: Lpips | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Scores a scene as it is, without sending it; gaps, if it has some, are concealed by each method.

    Args:
        protocol: The methods; the loss is not used.
        scene: A decoded scene with gaps, or one that can be drawn.
        erasures: What of it was received; None if it was never sent.
        parts: Bytes of the scene by part.
        views: Cameras and references.
        lpips: LPIPS with its weights; None if they are absent.
        progress: Called with the method and the share of its views that is done.

    Returns:
        All scores, and pictures of the hardest views.
    """
    session = _Session(protocol, views, lpips, progress or _silent)
    num_lost = 0 if erasures is None else erasures.num_lost
    delivery = Delivery({}, num_lost, 0, sum(parts.values()))
    runs = [session.run(method, scene, delivery, seed=None, keep=True) for method in protocol.methods]
    whole = scene.scene if isinstance(scene, PartialScene) else scene
    if num_lost and erasures is not None:
        session.map_losses("stream", whole, erasures)
    return session.evaluation(
        runs,
        parts={"stream": dict(parts)},
        total_bytes={method.name: sum(parts.values()) for method in protocol.methods},
        num_packets={"stream": 0},
        num_anchors=whole.anchors.num_anchors,
    )


@dataclass(frozen=True)
class Delivery:
    """What is known about a scene before anything is concealed; the fields are those of `Run`."""

    seconds: Mapping[str, float]
    num_lost: int
    num_lost_packets: int
    num_bytes_received: int


def _silent(task: str, share: float) -> None:
    """Shows nothing."""


def _transmissions(protocol: Protocol) -> Iterator[tuple[str, int | None, list[Method]]]:
    """Which stream is sent with which seed for which methods; the concealers come first, they name the hard views."""
    names = list(dict.fromkeys(method.stream for method in reversed(protocol.methods)))
    for name in names:
        lossy = [method for method in protocol.lossy_methods if method.stream == name]
        for seed in protocol.seeds if lossy else ():
            yield name, seed, lossy
        if lossless := [method for method in protocol.methods if method.lossless and method.stream == name]:
            yield name, None, lossless


@dataclass(eq=False)
class _Session:
    """Scores scenes and keeps the pictures of the hardest views; the views of the first run decide which those are."""

    protocol: Protocol
    views: ReferenceViews
    lpips: Lpips | None
    progress: Progress
    pictures: list[Picture] = field(default_factory=list)
    loss_maps: list[LossMap] = field(default_factory=list)
    hard_views: list[int] | None = None
    _lpips_references: dict[int, tuple[Tensor, ...]] = field(default_factory=dict)

    def run(
        self, method: Method, decoded: AnchorScene | PartialScene, delivery: Delivery, *, seed: int | None, keep: bool
    ) -> Run:
        """Conceals, draws and scores."""
        started = time.perf_counter()
        scene = conceal(decoded, method.concealer) if isinstance(decoded, PartialScene) else decoded
        seconds = {**delivery.seconds, "conceal": time.perf_counter() - started, "render": 0.0}
        wanted = spread(self.views.cameras.num_views, self.protocol.lpips_views) if self.lpips else []
        psnrs, ssims, distances = [], [], []
        kept: dict[int, Picture] = {}
        for view, image in enumerate(self._draw(scene, seconds)):
            both = self.views.compared(view, image)
            psnrs.append(both.psnr())
            equal = math.isinf(psnrs[-1])  # then the slower metrics need not be computed
            ssims.append(1.0 if equal else both.ssim())
            if view in wanted:
                distances.append(0.0 if equal else self._distance(view, both))
            if keep and (self.hard_views is None or view in self.hard_views):
                kept[view] = Picture(view, method.name, to_pixels(both.image[0]), psnrs[-1])
            self.progress(method.name, (view + 1) / self.views.cameras.num_views)
        if self.hard_views is None and keep:
            self.hard_views = sorted(range(len(psnrs)), key=psnrs.__getitem__)[: self.protocol.picture_views]
        self.pictures += [kept[view] for view in self.hard_views or () if view in kept]
        lpips = tuple(distances) if self.lpips else None
        scores = Scores(tuple(psnrs), tuple(ssims), lpips, tuple(wanted))
        return Run(
            method, seed, scores, seconds, delivery.num_lost, delivery.num_lost_packets, delivery.num_bytes_received
        )

    def map_losses(self, stream: str, scene: AnchorScene, erasures: Erasures) -> None:
        """Draws the loss map of the hardest view."""
        view = (self.hard_views or [0])[0]
        reference = self.views.reference(view)
        pixels = draw_loss_map(scene.anchors, erasures.known, self.views.cameras, view, reference)
        self.loss_maps.append(LossMap(view, stream, pixels))

    def evaluation(
        self,
        runs: list[Run],
        *,
        parts: Mapping[str, Mapping[str, int]],
        total_bytes: Mapping[str, int],
        num_packets: Mapping[str, int],
        num_anchors: int,
    ) -> Evaluation:
        """Puts the result together."""
        order = [method.name for method in self.protocol.methods]
        return Evaluation(
            protocol=self.protocol,
            runs=tuple(sorted(runs, key=lambda run: order.index(run.method.name))),
            view_names=self.views.cameras.names,
            reference=self.views.source,
            stream_parts=parts,
            total_bytes=total_bytes,
            num_anchors=num_anchors,
            num_packets=num_packets,
            references={view: to_pixels(self.views.reference(view)) for view in self.hard_views or ()},
            pictures=tuple(sorted(self.pictures, key=lambda picture: order.index(picture.method))),
            loss_maps=tuple(reversed(self.loss_maps)),
            lpips_note=self._lpips_note(),
            unit=self.protocol.loss.unit,
            masked=self.views.masked,
        )

    def _draw(self, scene: AnchorScene, seconds: dict[str, float]) -> Iterator[Float[Tensor, "H W 3"]]:
        """Draws view after view and counts the seconds that drawing takes."""
        images = iter(views_of(scene, self.views.cameras, self.protocol.renderer, self.views.background))
        while True:
            started = time.perf_counter()
            image = next(images, None)
            seconds["render"] += time.perf_counter() - started
            if image is None:
                return
            yield image

    def _distance(self, view: int, both: Compared) -> float:
        """LPIPS; the features of a reference are computed once."""
        assert self.lpips is not None
        features = self._lpips_references.get(view)
        if features is None:
            features = self.lpips.features(both.reference)
            size = sum(tensor.nbytes for tensor in features)
            if (len(self._lpips_references) + 1) * size <= _MAX_CACHED_BYTES:
                self._lpips_references[view] = features
        return float(self.lpips.distance(self.lpips.features(both.image), features)[0])

    def _lpips_note(self) -> str:
        if self.lpips is None:
            return "weights absent"
        count, total = self.protocol.lpips_views, self.views.cameras.num_views
        notes = [] if count is None or count >= total else [f"mean of {count} of {total} views"]
        return ", ".join([*notes, *([LPIPS_OF_MASKED] if self.views.masked else [])])


def to_pixels(image: Float[Tensor, "H W 3"]) -> np.ndarray:
    """Rounds RGB in [0, 1] to bytes."""
    return (image.clamp(0, 1) * 255 + 0.5).to(torch.uint8).cpu().numpy()
