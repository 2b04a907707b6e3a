"""Coarse copies of the most important anchors of a scene (a sketch)."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.calibration.sketch_fit import (
    BITS_OF_COPY,
    SketchFit,
    SketchMaterial,
    fit_sketch,
    num_candidates,
    sketch_material,
)
from splatwire.calibration.views import Progress
from splatwire.concealment import Concealed
from splatwire.concealment.sketch.concealer import SketchedLoss, buckets_of, with_sketch
from splatwire.concealment.sketch.section import SketchSection, write_sketch
from splatwire.errors import InvalidValueError
from splatwire.render.quick_sensitivity import quick_sensitivity
from splatwire.render.sensitivity import Sensitivity, render_sensitivity
from splatwire.types import AnchorScene, Cameras, ReceivedScene

_PRICE_STEPS = 24
_CLOSE = 0.98
"""The search for the price of a bit ends when the sketch has at least this share of the maximum size."""
_FURTHEST = 4.0
"""Maximum change of the price of a bit in a search step, as a binary logarithm."""


@dataclass(frozen=True, eq=False)
class AnchorSketch:
    """Sketch of a scene: coarse copies of its most important anchors, drawn if the anchors themselves are lost.

    Attributes:
        copies: The coarse copies, and the parameters with which a receiver enlarges anchors next to lost ones.
        buckets: Size class of each anchor, 0 for the largest, int64 (N); context of the entropy coder.
        growth_candidates: Exponents of the enlargement. The calibration tries each exponent, the default first.
        trust_candidates: Shares, 0 to 1, of the correction of the enlargement that the neural network predicts. The
            calibration tries each share, the default first.
    """

    copies: SketchSection
    buckets: np.ndarray
    growth_candidates: ClassVar = tuple((exponent,) for exponent in (0.25, 0.0, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5))
    trust_candidates: ClassVar = (1.0, 0.0, 0.5)

    @staticmethod
    def fitted(
        stream: SceneStream,
        complete: ReceivedScene[AnchorScene],
        cameras: Cameras,
        max_bytes: int,
        config: SketchConfig,
        show: Progress,
    ) -> "AnchorSketch":
        """Creates the sketch of a scene: chooses the anchors that get a coarse copy, and quantises the copies.

        Args:
            stream: The complete stream.
            complete: The decoded scene.
            cameras: Views in which the importance of anchors is measured.
            max_bytes: Maximum size of the sketch in bytes.
            config: Settings of the calibration.
            show: Called with the name of the current task and its completed share, 0 to 1.

        Raises:
            InvalidValueError: If the sketch is too small for a single copy, or no element is visible in any view.
        """
        sensitivity = _sensitivity(complete.scene, cameras, max_bytes, config, show)
        if not float(sensitivity.removal.sum()) > 0:
            raise InvalidValueError("no view shows anything of the scene: there is nothing to calibrate on")
        buckets = buckets_of(complete)
        copies = _largest_sketch(
            sketch_material(complete, sensitivity, max_bytes), lambda section: len(write_sketch(section, buckets)),
            max_bytes, config.fit, lambda share: show("choosing anchors and steps", share),
        )  # fmt: skip
        return AnchorSketch(copies, buckets).with_growth(
            (*AnchorSketch.growth_candidates[0], AnchorSketch.trust_candidates[0])
        )

    @property
    def num_sketched(self) -> int:
        """Number of anchors that have a coarse copy in the sketch."""
        return len(self.copies.values)

    @property
    def growth(self) -> tuple[float, ...]:
        """Parameters of the enlargement of received anchors: exponent, and weight of a correcting network, 0 to 1."""
        return self.copies.exponent, self.copies.trust

    def with_growth(self, growth: tuple[float, ...]) -> "AnchorSketch":
        """Returns a sketch with the same coarse copies and new parameters for the enlargement of received anchors.

        Args:
            growth: New value of the attribute `growth`.
        """
        exponent, trust = growth
        return replace(self, copies=replace(self.copies, exponent=exponent, trust=trust))

    def section(self) -> bytes:
        """Encodes the coarse copies of the most important anchors as the section `sketch` of a stream."""
        return write_sketch(self.copies, self.buckets)

    def replace_lost(self, received: ReceivedScene[AnchorScene]) -> SketchedLoss:
        """Replaces the lost anchors of a received scene by the sketch's coarse copies.

        Args:
            received: The received scene.

        Returns:
            The scene with copies, as input of `conceal`.
        """
        # The result does not depend on the parameters of the enlargement (`growth`), so sketches that differ
        # only in these can share it.
        return SketchedLoss.of(with_sketch(received, self.copies))

    def conceal(self, sketched: SketchedLoss) -> tuple[ReceivedScene[AnchorScene], Concealed]:
        """Enlarges anchors to cover lost ones that have no coarse copy, as a receiver of this sketch would.

        An anchor counts as lost only if it was not received and has no copy. These lost anchors are hidden. All other
        anchors are drawn, and those next to lost anchors are enlarged.

        Args:
            sketched: Result of the method `replace_lost`: the received scene, with coarse copies in place of lost
                anchors.

        Returns:
            The scene with coarse copies; and the result of the concealment, which contains the factors that enlarge
            anchors and the mask of the hidden anchors.
        """
        return sketched.received_scene, sketched.conceal(self.copies)


def _sensitivity(
    scene: AnchorScene, cameras: Cameras, max_bytes: int, config: SketchConfig, show: Progress
) -> Sensitivity:
    """Estimates how much the rendered pictures change if attributes of an anchor change, or if the anchor is lost.

    Args:
        scene: The complete scene.
        cameras: Views to render.
        max_bytes: Maximum size of all coarse copies (the sketch) in bytes.
        config: Settings of the calibration.
        show: Called with the name of the current task and its completed share, 0 to 1.
    """
    # With `SketchConfig.quick`, the measurement uses pictures of half the width and height, and only the most
    # important anchors. Their number follows from `max_bytes`.

    def progress(share: float) -> None:
        show("measuring importance", share)

    if config.quick and cameras.num_views > 1:
        half = cameras.scaled(0.5)
        return quick_sensitivity(scene, half, chosen=num_candidates(max_bytes), seed=config.seed, progress=progress)
    return render_sensitivity(scene, cameras, probes=config.probes, seed=config.seed, progress=progress)


def _largest_sketch(
    material: SketchMaterial,
    size_of: Callable[[SketchSection], int],
    max_bytes: int,
    options: SketchFit,
    show: Callable[[float], None],
) -> SketchSection:
    """Returns the best sketch (coarse copies of anchors) that takes at most `max_bytes` bytes.

    Args:
        material: Data of the scene and of the anchors that may be copied.
        size_of: Function that returns the encoded size of a sketch in bytes.
        max_bytes: Maximum size in bytes.
        options: Settings for the choice and quantisation.
        show: Called with the completed share, 0 to 1.

    Raises:
        InvalidValueError: If not even one copy fits.
    """
    # Searches for the Lagrange multiplier (squared error per bit) at which the optimal sketch has about this size.
    best: SketchSection | None = None
    large: tuple[float, float] | None = None
    small: tuple[float, float] | None = None
    price = math.log2(material.price_of(8 * max_bytes / BITS_OF_COPY, options))
    for step in range(_PRICE_STEPS):
        section = fit_sketch(material, 2.0**price, options)
        size = size_of(section) if len(section.values) else 0
        over = math.log2(max(size, 1) / max_bytes)
        if size > max_bytes:
            large = price, over
        else:
            small, best = (price, over), section if size else best
            if size > _CLOSE * max_bytes:
                break
        if large is None or small is None:
            price += min(max(2 * over, -_FURTHEST), _FURTHEST) or -1.0
        else:
            share = large[1] / (large[1] - small[1])
            price = large[0] + min(max(share + 0.02, 0.1), 0.9) * (small[0] - large[0])
        show((step + 1) / _PRICE_STEPS)
    show(1.0)
    if best is None:
        raise InvalidValueError(f"no sketch fits into {max_bytes:,} bytes: give it a larger share of the stream")
    return best
