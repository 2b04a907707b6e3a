"""What a viewer shows under which settings: pictures and figures, no browser."""

import dataclasses
import math
import time
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from splatwire.channel import Bernoulli, GilbertElliott, LossModel
from splatwire.conceal.grow import lost_share
from splatwire.errors import InvalidValueError
from splatwire.metrics import psnr
from splatwire.model import SplatScene
from splatwire.model.appearance import Scene, spawned_gaussians
from splatwire.render import render_scene
from splatwire.render.backends import create_renderer
from splatwire.scene import Cameras
from splatwire.scene.background import Background
from splatwire.view.looks import heat
from splatwire.view.progressive_scene import ProgressiveScene

LAYERS = ("received", "lossless", "difference", "losses")
"""What can be shown: the concealed scene, the reference, the error of each pixel, the loss around each element."""
LIVE_LAYERS = ("received", "losses")
"""Of these, what needs no reference."""
ERROR_AT_FULL_HEAT = 0.1
LOST_NEIGHBORS = 16


@dataclass(frozen=True)
class Settings:
    """What a person chose.

    Attributes:
        loss: Share of packets that are lost, 0 to 1.
        burst: Mean length of a burst, packets; 1 loses each on its own.
        seed: Seed of the losses.
        concealer: Name of the concealer.
        progress: Share of the packets' bytes that has been sent, 0 to 1.
        layer: One of `LAYERS`.
    """

    loss: float | int = 0.2
    burst: float | int = 1.0
    seed: int = 0
    concealer: str = "grow"
    progress: float | int = 1.0
    layer: str = LAYERS[0]

    def loss_model(self) -> LossModel:
        """The loss model; a burst too short for the rate becomes the shortest possible one.

        Raises:
            InvalidValueError: If a number is out of range.
        """
        if self.burst <= 1:
            return Bernoulli(float(self.loss))
        shortest = self.loss / (1 - self.loss) if self.loss < 1 else 1.0
        return GilbertElliott(float(self.loss), max(float(self.burst), math.ceil(shortest * 1e6) / 1e6))


@dataclass(frozen=True)
class Status:
    """What is known about what is shown.

    Attributes:
        bytes_sent: Manifest, side information and packets sent (live: received) by now.
        bytes_total: Of the whole transfer; None where that is not known.
        seconds: Since the beginning of the transfer.
        packets_received: Packets that are there.
        packets_total: Packets of the complete stream.
        known: Elements that are exact.
        total: Elements of the complete scene.
        psnr: Against the lossless render of the same view, dB; None where there is none or it was not asked for.
        draw_ms: Time for the picture.
        note: Something that a person should know, or nothing.
    """

    bytes_sent: int
    bytes_total: int | None
    seconds: float
    packets_received: int
    packets_total: int
    known: int
    total: int
    psnr: float | None = None
    draw_ms: float = 0.0
    note: str = ""


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture and what is known about it."""

    image: UInt8[Tensor, "H W 3"]
    status: Status


@runtime_checkable
class Source(Protocol):
    """Where the scene comes from: a file whose transfer is played, or a server that sends it now."""

    @property
    def live(self) -> bool:
        """Whether losses are real, so that nobody may choose them."""

    @property
    def positions(self) -> Float[Tensor, "N 3"]:
        """Where the scene is: the places of its elements, or of its preview's Gaussians."""

    @property
    def preview(self) -> SplatScene | None:
        """What there is to look at before there is a scene."""

    @property
    def progressive(self) -> ProgressiveScene | None:
        """The scene, as `scene` left it; None while there is only a preview."""

    def advance(self) -> bool:
        """Goes over to the scene when it is time; says whether anything is to be drawn anew."""

    def scene(self, settings: Settings) -> Scene:
        """The concealed scene under these settings; tensors may be changed by the next call."""

    def reference(self) -> Scene | None:
        """The scene without loss, once it is known."""

    def status(self) -> Status:
        """What the last call of `scene` showed."""


class Viewer:
    """Draws a source under settings; one thread at a time.

    Args:
        source: Where the scene comes from.
        renderer: Name of the renderer.
        background: RGB behind everything; None for what the scene was trained in front of.

    Raises:
        UnknownNameError: No renderer has that name.
        BackendUnavailableError: The renderer cannot run here.
    """

    def __init__(self, source: Source, renderer: str = "cpu", background: Background | None = None) -> None:
        self.source = source
        self._background = None if background is None else torch.tensor(background)
        self._render = create_renderer(renderer)
        self._reference: tuple[Cameras, Tensor] | None = None
        self._shares: tuple[Tensor, Tensor] | None = None

    def frame(self, settings: Settings, cameras: Cameras, *, score: bool = True) -> Frame:
        """Draws one picture.

        Args:
            settings: What was chosen.
            cameras: One camera.
            score: Whether PSNR is wanted, which may cost a second picture.

        Raises:
            InvalidValueError: If a setting makes no sense.
            UnknownNameError: If there is no such concealer or layer.
        """
        if settings.layer not in LAYERS:
            raise InvalidValueError(f"a viewer shows {', '.join(LAYERS)}, not {settings.layer!r}")
        began = time.perf_counter()
        preview = self.source.preview
        if preview is not None:
            image, quality = self._picture(preview, cameras), None
        else:
            image, quality = self._draw(settings, self.source.scene(settings), cameras, score)
        seconds = time.perf_counter() - began
        status = dataclasses.replace(self.source.status(), psnr=quality, draw_ms=seconds * 1e3)
        return Frame((image * 255).round().to(torch.uint8), status)

    def _draw(
        self, settings: Settings, scene: Scene, cameras: Cameras, score: bool
    ) -> tuple[Float[Tensor, "H W 3"], float | None]:
        lossless = self.source.reference()
        if settings.layer == "losses":
            return self._losses(lossless or scene, scene, cameras), None
        if settings.layer == "lossless" and lossless is not None:
            return self._lossless(lossless, cameras), None
        picture = self._picture(scene, cameras)
        if lossless is None or not (score or settings.layer == "difference"):
            return picture, None
        truth = self._lossless(lossless, cameras)
        quality = float(psnr(picture[None], truth[None])[0])
        if settings.layer == "difference":
            picture = heat((picture - truth).abs().mean(dim=2) / ERROR_AT_FULL_HEAT)
        return picture, quality

    def _damage(self, positions: Float[Tensor, "N 3"]) -> Float[Tensor, "N"]:
        """Share of lost elements around each one, 1 for those that are lost; kept while nothing arrives."""
        assert self.source.progressive is not None
        known = self.source.progressive.known
        if self._shares is None or not torch.equal(self._shares[0], known):
            share = lost_share(positions, known, LOST_NEIGHBORS)
            self._shares = (known.clone(), torch.where(known, share, 1.0))
        return self._shares[1]

    def _lossless(self, scene: Scene, cameras: Cameras) -> Float[Tensor, "H W 3"]:
        """The reference picture; the last one is kept, because settings change while the view stays."""
        if self._reference is None or not _same(self._reference[0], cameras):
            self._reference = (cameras, self._picture(scene, cameras))
        return self._reference[1]

    def _picture(self, scene: Scene, cameras: Cameras) -> Float[Tensor, "H W 3"]:
        return render_scene(scene, cameras, renderer=self._render, background=self._background)[0]

    @torch.no_grad()
    def _losses(self, shape: Scene, scene: Scene, cameras: Cameras) -> Float[Tensor, "H W 3"]:
        """The Gaussians of the reference in the colours of what was lost around their elements."""
        share, spawned = self._damage(shape.positions), spawned_gaussians(shape, cameras, 0)
        colors = heat(0.1 + 0.9 * share)[spawned.anchor_index]
        gaussians = dataclasses.replace(spawned.gaussians, colors=colors)
        behind = torch.tensor(shape.background) if self._background is None else self._background
        return self._render(gaussians, cameras, background=behind)[0].clamp(0, 1)


def _same(a: Cameras, b: Cameras) -> bool:
    size = (a.width, a.height) == (b.width, b.height)
    return size and torch.equal(a.viewmats, b.viewmats) and torch.equal(a.Ks, b.Ks)
