"""A sketch of the elements that matter, and how far the rest grows, chosen on pictures; whatever the elements are."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from splatwire.calibrate.pseudo_loss import dropped_packets
from splatwire.calibrate.sketch_anchors import AnchorSketch
from splatwire.calibrate.sketch_config import SketchConfig
from splatwire.calibrate.sketch_gaussians import GaussianSketch
from splatwire.calibrate.views import CalibrationViews, Progress, References
from splatwire.codec import decode_stream
from splatwire.conceal import Concealed, conceal
from splatwire.conceal.conceal import drawn
from splatwire.errors import InvalidValueError
from splatwire.model import Partial, Prior
from splatwire.model.appearance import Scene
from splatwire.ops.arrays import to_arrays
from splatwire.packets import SceneStream
from splatwire.packets.sections import add_concealment
from splatwire.render import iterate_views


@dataclass(frozen=True, eq=False)
class SketchResult:
    """What came out.

    Attributes:
        section: Bytes of the section.
        num_sketched: Elements that are sketched.
        exponent: Of the growth.
        trust: In the network that corrects it.
        psnr: Decibels on losses that chose nothing: `no loss`, `drop`, `grow` and `sketch`; empty without such losses.
        seconds: Time taken.
    """

    section: bytes
    num_sketched: int
    exponent: float
    trust: float
    psnr: dict[str, float]
    seconds: float


@runtime_checkable
class Sketch(Protocol):
    """Copies of one kind of element, with a growth.

    Attributes:
        num_sketched: Elements that there are copies of.
        growth: Exponents of the growth, as the kind has them, and trust in the scene-free network.
        growths: Exponents that are tried, the usual ones first, and
        trusts: how much of the network's correction of them is.
    """

    @property
    def num_sketched(self) -> int:
        """See above."""

    @property
    def growth(self) -> tuple[float, ...]:
        """See above."""

    @property
    def growths(self) -> Sequence[tuple[float, ...]]:
        """See above."""

    @property
    def trusts(self) -> Sequence[float]:
        """See above."""

    def growing(self, growth: tuple[float, ...]) -> "Sketch":
        """The same copies with another growth."""

    def section(self) -> bytes:
        """What travels."""

    def around(self, partial: Partial) -> Any:
        """A lossy scene with the copies in place, and all that the growth follows from."""

    def proposal(self, around: Any) -> tuple[Partial, Concealed]:
        """The lossy scene, and what to draw of it with this growth."""


def sketch_of(
    stream: SceneStream,
    complete: Partial,
    views: CalibrationViews,
    config: SketchConfig,
    *,
    progress: Progress | None = None,
) -> SketchResult:
    """Makes the section `sketch` for a stream that has none yet.

    Args:
        stream: The complete stream.
        complete: What a decoder made of it.
        views: Where it is looked at from.
        config: The run.
        progress: Called with what is done and the share of it that is done.

    Raises:
        InvalidValueError: If something was lost, there are fewer than two packets, a sketch of that size holds nothing,
            or no view shows anything.
    """
    started, show = time.perf_counter(), progress or (lambda task, share: None)
    if complete.erasures.num_lost:
        raise InvalidValueError("calibration needs the complete scene, and of this one packets were lost")
    if len(stream.packets) < 2:
        raise InvalidValueError("calibration needs a stream of at least two packets")
    complete = replace(to_arrays(complete), scene=views.in_front(to_arrays(complete.scene)))
    fit: Callable[..., Sketch] = GaussianSketch.fitted if complete.find(Prior) is None else AnchorSketch.fitted
    most = round(config.share * stream.num_bytes)
    sketch = fit(stream, complete, views.reduced(config.views, config.width).cameras, most, config, show)
    quality: dict[str, float] = {}
    if config.masks + config.held_out_masks:
        scored = _Scores(stream, complete.scene, views.reduced(config.scored_views, config.width), config)
        sketch = scored.best_growth(sketch, show) if config.masks else sketch
        quality = scored.held_out(sketch, show) if config.held_out_masks else {}
    seconds = time.perf_counter() - started
    return SketchResult(sketch.section(), sketch.num_sketched, sketch.growth[0], sketch.growth[-1], quality, seconds)


class _Scores:
    """Mean PSNR of concealed losses; references are drawn, or loaded, once."""

    def __init__(self, stream: SceneStream, scene: Scene, views: CalibrationViews, config: SketchConfig) -> None:
        self._stream, self._scene, self._config = stream, scene, config
        self._references = References.of(scene, views)
        number = config.masks + config.held_out_masks
        self._seeds = np.random.SeedSequence(config.seed).generate_state(number).tolist()

    def best_growth(self, sketch: Sketch, show: Progress) -> Sketch:
        """The sketch with the trust that gives the best pictures with its growth, and then the growth that does."""
        losses = [sketch.around(self._decoded(self._stream, seed)) for seed in self._seeds[: self._config.masks]]
        tried: dict[tuple[float, ...], float] = {}

        def best_of(growths: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
            for growth in growths:
                candidate = sketch.growing(growth)
                tried[growth] = sum(self._quality_of(*candidate.proposal(loss)) for loss in losses)
                show("choosing the growth", len(tried) / (len(sketch.growths) + len(sketch.trusts) - 1))
            return max(tried, key=lambda growth: tried[growth])

        trust = best_of([(*sketch.growths[0], trust) for trust in sketch.trusts])[-1]
        return sketch.growing(best_of([(*growth, trust) for growth in sketch.growths[1:]]))

    def held_out(self, sketch: Sketch, show: Progress) -> dict[str, float]:
        """Decibels without loss, and on losses that chose nothing by concealer."""
        found, richer = (
            {"no loss": self._quality(self._scene)},
            add_concealment(self._stream, "sketch", sketch.section()),
        )
        losses = [self._decoded(richer, seed) for seed in self._seeds[self._config.masks :]]
        for number, name in enumerate(("drop", "grow", "sketch")):
            found[name] = sum(self._quality(conceal(partial, name)) for partial in losses) / len(losses)
            show("held-out losses", (number + 1) / 3)
        return found

    def _decoded(self, stream: SceneStream, seed: int) -> Partial:
        """What a receiver has of the stream after a loss."""
        dropped = set(dropped_packets(len(stream.packets), self._config.drop_rate, seed))
        partial = decode_stream(
            stream.with_packets([packet for k, packet in enumerate(stream.packets) if k not in dropped])
        )
        return replace(partial, scene=replace(partial.scene, background=self._scene.background))

    def _quality_of(self, partial: Partial, proposal: Concealed) -> float:
        return self._quality(drawn(partial, proposal, "sketch"))

    def _quality(self, scene: Scene) -> float:
        """Decibels over the views."""
        pictures = enumerate(iterate_views(scene, self._references.cameras))
        each = [self._references.psnr(view, picture) for view, picture in pictures]
        return sum(each) / len(each)
