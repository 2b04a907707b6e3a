"""What is shown under which settings: pictures and figures, no browser."""

import dataclasses
import math
import time
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from splatwire.channel import Bernoulli, GilbertElliott, LossModel
from splatwire.errors import InvalidValueError
from splatwire.metrics import psnr
from splatwire.model import SplatScene
from splatwire.model.appearance import Scene
from splatwire.render import render_scene
from splatwire.render.backends import create_renderer
from splatwire.scene import Cameras
from splatwire.scene.background import Background
from splatwire.view.progressive_scene import ProgressiveScene

LAYERS = ("received", "lossless", "difference")
"""What can be shown: the concealed scene, the reference, the error of each pixel."""
ERROR_AT_FULL_HEAT = 0.1


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
    def pending(self) -> bool:
        """Whether more may come by itself."""

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

    def _lossless(self, scene: Scene, cameras: Cameras) -> Float[Tensor, "H W 3"]:
        """The reference picture; the last one is kept, because settings change while the view stays."""
        if self._reference is None or not _same(self._reference[0], cameras):
            self._reference = (cameras, self._picture(scene, cameras))
        return self._reference[1]

    def _picture(self, scene: Scene, cameras: Cameras) -> Float[Tensor, "H W 3"]:
        return render_scene(scene, cameras, renderer=self._render, background=self._background)[0]


def _same(a: Cameras, b: Cameras) -> bool:
    size = (a.width, a.height) == (b.width, b.height)
    return size and torch.equal(a.viewmats, b.viewmats) and torch.equal(a.Ks, b.Ks)


def heat(values: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape 3"]:
    """Colours of damage from dark (0) over red to bright yellow (1): matplotlib's `inferno`."""
    import matplotlib

    table = torch.from_numpy(matplotlib.colormaps["inferno"](np.linspace(0, 1, 256))[:, :3].astype(np.float32))
    return table[(values.clamp(0, 1) * 255).round().long()]
