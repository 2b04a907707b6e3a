"""Creates a sketch of a scene: coarse copies of the most important elements, sent as side information.

Elements are anchors or explicit Gaussians.
"""

# A sketch also contains how much a receiver enlarges received elements next to lost ones. The best enlargement is
# chosen by comparing rendered pictures after simulated packet losses.

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from splatwire.anchors.appearance import origin_of
from splatwire.arguments import checked
from splatwire.bitstream import SceneStream
from splatwire.bitstream.sections import with_section
from splatwire.calibration.pseudo_loss import dropped_packets
from splatwire.calibration.sketch_anchors import AnchorSketch
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.calibration.sketch_gaussians import GaussianSketch
from splatwire.calibration.views import CalibrationViews, Progress, References
from splatwire.codec import decode_stream
from splatwire.concealment import Concealed, conceal
from splatwire.concealment.conceal import apply_result
from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import to_arrays
from splatwire.render import iterate_views
from splatwire.types import Prior, ReceivedScene
from splatwire.types.scene import Scene


@dataclass(frozen=True, eq=False)
class SketchResult:
    """Result of creating a sketch (coarse copies of important elements) for a scene.

    Attributes:
        section: Encoded sketch. It becomes the section `sketch` of the stream's side information.
        num_sketched: Number of elements that have a coarse copy in the sketch.
        exponent: Exponent that controls how much a receiver enlarges received elements to cover lost neighbours.
        trust: Weight, 0 to 1, of the neural network's correction of this enlargement.
        psnr: Mean PSNR in decibels without loss (`no loss`), and after simulated packet losses with the concealers
            `drop`, `grow` and `sketch`.
        seconds: Duration in seconds.
    """

    # `psnr` is empty if no losses were simulated for this purpose.

    section: bytes
    num_sketched: int
    exponent: float
    trust: float
    psnr: dict[str, float]
    seconds: float


@runtime_checkable
class Sketch(Protocol):
    """Typing protocol (structural type) for a sketch: coarse copies of a scene's most important elements.

    Elements are anchors or explicit Gaussians. If an element is lost, a receiver draws its copy instead. If a lost
    element has no copy, a receiver enlarges the elements next to it.

    Attributes:
        num_sketched: Number of elements that have a coarse copy.
        growth: Parameters of the enlargement: first the exponents, then the weight of a neural network's correction,
            0 to 1. Anchors have one exponent, explicit Gaussians have two (size and opacity).
        growth_candidates: Candidates for the exponents, the default first.
        trust_candidates: Candidates for the weight of the network, 0 to 1, the default first.
    """

    # There is one exponent for anchors (size), two for explicit Gaussians (size and opacity).

    @property
    def num_sketched(self) -> int:
        """Number of elements that have a coarse copy in the sketch."""

    @property
    def growth(self) -> tuple[float, ...]:
        """Parameters with which a receiver enlarges received elements next to lost ones."""

    @property
    def growth_candidates(self) -> Sequence[tuple[float, ...]]:
        """Candidates for the exponents with which a receiver enlarges elements next to lost ones, the default first."""

    @property
    def trust_candidates(self) -> Sequence[float]:
        """Candidates for the weight of the neural network that corrects the enlargement of elements, 0 to 1.

        The first one is the default.
        """

    def with_growth(self, growth: tuple[float, ...]) -> "Sketch":
        """Returns a sketch with the same coarse copies and new parameters for the enlargement of received elements.

        Args:
            growth: New value of the attribute `growth`.
        """

    def section(self) -> bytes:
        """Encodes the coarse copies as the section `sketch` of the stream's side information."""

    def replace_lost(self, received: ReceivedScene) -> Any:
        """Replaces lost elements of a received scene by their coarse copies. Elements without a copy stay lost.

        Args:
            received: The received scene.

        Returns:
            Argument for the method `conceal` of the same sketch. It contains the scene with copies; its type differs
            between classes of sketches.
        """
        # The result does not depend on the parameters of the enlargement (`growth`), so sketches that differ
        # only in these can share it.

    def conceal(self, sketched: Any) -> tuple[ReceivedScene, Concealed]:
        """Enlarges elements to cover lost ones that have no coarse copy, as a receiver of this sketch would.

        An element counts as lost only if it was not received and has no copy. These lost elements are hidden. All other
        elements are drawn, and those next to lost elements are enlarged.

        Args:
            sketched: Result of the method `replace_lost`: the received scene, with coarse copies in place of lost
                elements.

        Returns:
            The scene with coarse copies; and the result of the concealment, which contains the factors that enlarge
            elements and the mask of the hidden elements.
        """


@checked
def sketch_of(
    stream: SceneStream,
    complete: ReceivedScene,
    views: CalibrationViews,
    config: SketchConfig,
    *,
    progress: Progress | None = None,
) -> SketchResult:
    """Creates the section `sketch` of a stream's side information: coarse copies of the most important elements.

    Args:
        stream: The complete stream, without a section `sketch`.
        complete: The decoded scene.
        views: Views in which importance and picture quality are measured.
        config: The settings.
        progress: Called with the name of the current task and its completed share, 0 to 1.

    Raises:
        InvalidValueError: If a packet was lost, or the stream has fewer than two packets. Also if the sketch is too
            small for a single copy, or no element is visible in any view.
    """
    started, show = time.perf_counter(), progress or (lambda task, share: None)
    if complete.loss_mask.num_lost:
        raise InvalidValueError("calibration needs the complete scene, and of this one packets were lost")
    if len(stream.packets) < 2:
        raise InvalidValueError("calibration needs a stream of at least two packets")
    complete = replace(to_arrays(complete), scene=views.with_background_of_views(to_arrays(complete.scene)))
    views = views.relative_to(origin_of(complete.scene))
    fit: Callable[..., Sketch] = GaussianSketch.fitted if complete.get(Prior) is None else AnchorSketch.fitted
    max_bytes = round(config.share * stream.num_bytes)
    sketch = fit(stream, complete, views.reduced(config.views, config.width).cameras, max_bytes, config, show)
    quality: dict[str, float] = {}
    if config.num_losses + config.num_held_out_losses:
        scored = _Scores(stream, complete.scene, views.reduced(config.scored_views, config.width), config)
        sketch = scored.best_growth(sketch, show) if config.num_losses else sketch
        quality = scored.held_out(sketch, show) if config.num_held_out_losses else {}
    seconds = time.perf_counter() - started
    return SketchResult(sketch.section(), sketch.num_sketched, sketch.growth[0], sketch.growth[-1], quality, seconds)


class _Scores:
    """Measures the PSNR of a scene after simulated packet losses and concealment, against reference pictures."""

    def __init__(self, stream: SceneStream, scene: Scene, views: CalibrationViews, config: SketchConfig) -> None:
        self._stream, self._scene, self._config = stream, scene, config
        self._references = References.of(scene, views)
        number = config.num_losses + config.num_held_out_losses
        self._seeds = np.random.SeedSequence(config.seed).generate_state(number).tolist()

    def best_growth(self, sketch: Sketch, show: Progress) -> Sketch:
        """Chooses the parameters for enlarging received elements that give the highest PSNR under simulated losses.

        Args:
            sketch: Sketch with the coarse copies; its own enlargement parameters are not used.
            show: Called with the name of the current task and its completed share, 0 to 1.
        """
        # The parameters with the highest PSNR after simulated packet losses are chosen: first the strength of
        # the correction by a neural network (trust), then the exponents.
        losses = [
            sketch.replace_lost(self._decoded(self._stream, seed)) for seed in self._seeds[: self._config.num_losses]
        ]
        tried: dict[tuple[float, ...], float] = {}

        def best_of(growth_candidates: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
            for growth in growth_candidates:
                candidate = sketch.with_growth(growth)
                tried[growth] = sum(self._quality_of(*candidate.conceal(loss)) for loss in losses)
                show(
                    "choosing the growth",
                    len(tried) / (len(sketch.growth_candidates) + len(sketch.trust_candidates) - 1),
                )
            return max(tried, key=lambda growth: tried[growth])

        trust = best_of([(*sketch.growth_candidates[0], trust) for trust in sketch.trust_candidates])[-1]
        return sketch.with_growth(best_of([(*growth, trust) for growth in sketch.growth_candidates[1:]]))

    def held_out(self, sketch: Sketch, show: Progress) -> dict[str, float]:
        """Measures the picture quality without loss, and after simulated packet losses with three concealers.

        Args:
            sketch: The sketch (coarse copies) that one of the concealers uses.
            show: Called with the name of the current task and its completed share, 0 to 1.

        Returns:
            Mean PSNR in decibels for `no loss` and for each concealer (`SketchResult.psnr`).
        """
        # The losses are not those with which the parameters of the sketch were chosen.
        qualities, sketched_stream = (
            {"no loss": self._quality(self._scene)},
            with_section(self._stream, "sketch", sketch.section()),
        )
        losses = [self._decoded(sketched_stream, seed) for seed in self._seeds[self._config.num_losses :]]
        for number, name in enumerate(("drop", "grow", "sketch")):
            qualities[name] = sum(self._quality(conceal(received, name)) for received in losses) / len(losses)
            show("held-out losses", (number + 1) / 3)
        return qualities

    def _decoded(self, stream: SceneStream, seed: int) -> ReceivedScene:
        """Simulates random packet loss with a given seed, and decodes the received packets."""
        dropped = set(dropped_packets(len(stream.packets), self._config.drop_rate, seed))
        received = decode_stream(
            stream.with_packets([packet for k, packet in enumerate(stream.packets) if k not in dropped])
        )
        return replace(received, scene=replace(received.scene, background=self._scene.background))

    def _quality_of(self, received: ReceivedScene, result: Concealed) -> float:
        return self._quality(apply_result(received, result, "sketch"))

    def _quality(self, scene: Scene) -> float:
        """Returns the mean PSNR of a scene over the views, decibels."""
        pictures = enumerate(iterate_views(scene, self._references.cameras))
        psnrs = [self._references.psnr(view, picture) for view, picture in pictures]
        return sum(psnrs) / len(psnrs)
