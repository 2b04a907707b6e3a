"""Runs a protocol: send, decode, conceal, draw, score."""

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
from splatwire.evaluate.results import Evaluation, LossMap, Picture, Run, Scores
from splatwire.evaluate.views import ReferenceViews, spread, views_of
from splatwire.metrics import Lpips, psnr, ssim
from splatwire.model import AnchorScene, PartialScene
from splatwire.packets import SceneStream

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
    session = _Session(protocol, views, lpips, progress or (lambda task, share: None))
    runs: list[Run] = []
    for name, seed, methods in _transmissions(protocol):
        sent = streams[name]
        received = sent if seed is None else transmit(
            sent, protocol.loss, seed=seed, send_order=protocol.send_order
        )[0]  # fmt: skip
        started = time.perf_counter()
        partial = decode(received)
        seconds = time.perf_counter() - started
        lost_packets = sent.manifest.num_packets - len(received.packets)
        for method in methods:
            scores, times = session.run(method, partial, keep=seed in (None, protocol.seeds[0]))
            times = {"decode": seconds, **times}
            runs.append(Run(method, seed, scores, times, partial.erasures.num_lost, lost_packets, received.num_bytes))
        if seed == protocol.seeds[0]:
            session.map_losses(name, partial)
    order = {method: index for index, method in enumerate(protocol.methods)}
    runs.sort(key=lambda run: order[run.method])
    used = {method.stream for method in protocol.methods}
    return session.evaluation(tuple(runs), {name: stream for name, stream in streams.items() if name in used})


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

    def run(self, method: Method, partial: PartialScene, *, keep: bool) -> tuple[Scores, dict[str, float]]:
        """Conceals, draws and scores; returns seconds by phase as well."""
        started = time.perf_counter()
        scene = conceal(partial, method.concealer)
        seconds = {"conceal": time.perf_counter() - started, "render": 0.0}
        wanted = spread(self.views.cameras.num_views, self.protocol.lpips_views) if self.lpips else []
        psnrs, ssims, distances = [], [], []
        kept: dict[int, Picture] = {}
        for view, image in enumerate(self._draw(scene, seconds)):
            reference = self.views.reference(view)
            psnrs.append(float(psnr(image[None], reference[None])[0]))
            ssims.append(float(ssim(image[None], reference[None])[0]))
            if view in wanted:
                distances.append(self._distance(view, image, reference))
            if keep and (self.hard_views is None or view in self.hard_views):
                kept[view] = Picture(view, method.name, to_pixels(image), psnrs[-1])
            self.progress(method.name, (view + 1) / self.views.cameras.num_views)
        if self.hard_views is None and keep:
            self.hard_views = sorted(range(len(psnrs)), key=psnrs.__getitem__)[: self.protocol.picture_views]
        self.pictures += [kept[view] for view in self.hard_views or () if view in kept]
        lpips = tuple(distances) if self.lpips else None
        return Scores(tuple(psnrs), tuple(ssims), lpips, tuple(wanted)), seconds

    def map_losses(self, stream: str, partial: PartialScene) -> None:
        """Draws the loss map of the hardest view."""
        view = (self.hard_views or [0])[0]
        pixels = draw_loss_map(
            partial.scene.anchors, partial.erasures.known, self.views.cameras, view, self.views.reference(view)
        )
        self.loss_maps.append(LossMap(view, stream, pixels))

    def evaluation(self, runs: tuple[Run, ...], streams: Mapping[str, SceneStream]) -> Evaluation:
        """Puts the result together."""
        first = next(iter(streams.values()))
        order = [method.name for method in self.protocol.methods]
        return Evaluation(
            protocol=self.protocol,
            runs=runs,
            view_names=self.views.cameras.names,
            reference=self.views.source,
            stream_parts={name: stream.parts() for name, stream in streams.items()},
            num_anchors=first.manifest.num_anchors,
            num_packets={name: stream.manifest.num_packets for name, stream in streams.items()},
            references={view: to_pixels(self.views.reference(view)) for view in self.hard_views or ()},
            pictures=tuple(sorted(self.pictures, key=lambda picture: order.index(picture.method))),
            loss_maps=tuple(reversed(self.loss_maps)),
            lpips_note=self._lpips_note(),
            unit=self.protocol.loss.unit,
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

    def _distance(self, view: int, image: Tensor, reference: Tensor) -> float:
        """LPIPS; the features of a reference are computed once."""
        assert self.lpips is not None
        if torch.equal(image, reference):
            return 0.0
        features = self._lpips_references.get(view)
        if features is None:
            features = self.lpips.features(reference[None])
            size = sum(tensor.nbytes for tensor in features)
            if (len(self._lpips_references) + 1) * size <= _MAX_CACHED_BYTES:
                self._lpips_references[view] = features
        return float(self.lpips.distance(self.lpips.features(image[None]), features)[0])

    def _lpips_note(self) -> str:
        if self.lpips is None:
            return "weights absent"
        count, total = self.protocol.lpips_views, self.views.cameras.num_views
        return "" if count is None or count >= total else f"mean of {count} of {total} views"


def to_pixels(image: Float[Tensor, "H W 3"]) -> np.ndarray:
    """Rounds RGB in [0, 1] to bytes."""
    return (image.clamp(0, 1) * 255 + 0.5).to(torch.uint8).cpu().numpy()
