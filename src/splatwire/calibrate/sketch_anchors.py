"""Coarse copies of the anchors that matter most."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from splatwire.calibrate.sketch_config import SketchConfig
from splatwire.calibrate.sketch_fit import (
    BITS_OF_COPY,
    SketchFit,
    SketchMaterial,
    fit_sketch,
    num_candidates,
    sketch_material,
)
from splatwire.calibrate.views import Progress
from splatwire.conceal import Concealed
from splatwire.conceal.sketch.concealer import SketchedLoss, buckets_of, with_sketch
from splatwire.conceal.sketch.section import SketchSection, write_sketch
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, Partial
from splatwire.packets import SceneStream
from splatwire.render.quick_sensitivity import quick_sensitivity
from splatwire.render.sensitivity import Sensitivity, render_sensitivity
from splatwire.scene import Cameras

_PRICE_STEPS = 24
_CLOSE = 0.98
"""Of the bytes that a sketch may take, enough are used from this share on."""
_FURTHEST = 4.0
"""Most that the logarithm of the price changes at a time, in octaves."""


@dataclass(frozen=True, eq=False)
class AnchorSketch:
    """See `splatwire.calibrate.sketch.Sketch`; a growth is its exponent and the trust.

    Attributes:
        copies: The copies.
        buckets: See `buckets_of`.
    """

    copies: SketchSection
    buckets: np.ndarray
    growths: ClassVar = tuple((exponent,) for exponent in (0.25, 0.0, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5))
    trusts: ClassVar = (1.0, 0.0, 0.5)

    @staticmethod
    def fitted(
        stream: SceneStream,
        complete: Partial[AnchorScene],
        cameras: Cameras,
        most: int,
        config: SketchConfig,
        show: Progress,
    ) -> "AnchorSketch":
        """Chooses and rounds the copies.

        Args:
            stream: The stream.
            complete: What a decoder made of it, in front of what is behind it.
            cameras: What tells which anchors matter.
            most: Bytes that the sketch may take.
            config: The run.
            show: Called with what is done and the share of it that is done.

        Raises:
            InvalidValueError: If a sketch of that size holds nothing, or no view shows anything.
        """
        sensitivity = _sensitivity(complete.scene, cameras, most, config, show)
        if not float(sensitivity.removal.sum()) > 0:
            raise InvalidValueError("no view shows anything of the scene: there is nothing to calibrate on")
        buckets = buckets_of(complete)
        copies = _of_size(
            sketch_material(complete, sensitivity, most), lambda section: len(write_sketch(section, buckets)), most,
            config.fit, lambda share: show("choosing anchors and steps", share),
        )  # fmt: skip
        return AnchorSketch(copies, buckets).growing((*AnchorSketch.growths[0], AnchorSketch.trusts[0]))

    @property
    def num_sketched(self) -> int:
        """See `Sketch`."""
        return len(self.copies.values)

    @property
    def growth(self) -> tuple[float, ...]:
        """See `Sketch`."""
        return self.copies.exponent, self.copies.trust

    def growing(self, growth: tuple[float, ...]) -> "AnchorSketch":
        """See `Sketch`."""
        exponent, trust = growth
        return replace(self, copies=replace(self.copies, exponent=exponent, trust=trust))

    def section(self) -> bytes:
        """See `Sketch`."""
        return write_sketch(self.copies, self.buckets)

    def around(self, partial: Partial[AnchorScene]) -> SketchedLoss:
        """See `Sketch`."""
        return SketchedLoss.of(with_sketch(partial, self.copies))

    def proposal(self, around: SketchedLoss) -> tuple[Partial[AnchorScene], Concealed]:
        """See `Sketch`."""
        return around.filled, around.proposal(self.copies)


def _sensitivity(scene: AnchorScene, cameras: Cameras, most: int, config: SketchConfig, show: Progress) -> Sensitivity:
    """What each anchor is worth; at a glance, views of half the size tell."""

    def progress(share: float) -> None:
        show("what each anchor is worth", share)

    if config.quick and cameras.num_views > 1:
        half = cameras.scaled(0.5)
        return quick_sensitivity(scene, half, chosen=num_candidates(most), seed=config.seed, progress=progress)
    return render_sensitivity(scene, cameras, probes=config.probes, seed=config.seed, progress=progress)


def _of_size(
    material: SketchMaterial,
    size_of: Callable[[SketchSection], int],
    most: int,
    options: SketchFit,
    show: Callable[[float], None],
) -> SketchSection:
    """The sketch with about the lowest price that takes at most so many bytes: logarithms of both are nearly a line."""
    best: SketchSection | None = None
    large: tuple[float, float] | None = None
    small: tuple[float, float] | None = None
    price = math.log2(material.price_of(8 * most / BITS_OF_COPY, options))
    for step in range(_PRICE_STEPS):
        section = fit_sketch(material, 2.0**price, options)
        size = size_of(section) if len(section.values) else 0
        over = math.log2(max(size, 1) / most)
        if size > most:
            large = price, over
        else:
            small, best = (price, over), section if size else best
            if size > _CLOSE * most:
                break
        if large is None or small is None:
            price += min(max(2 * over, -_FURTHEST), _FURTHEST) or -1.0
        else:
            share = large[1] / (large[1] - small[1])
            price = large[0] + min(max(share + 0.02, 0.1), 0.9) * (small[0] - large[0])
        show((step + 1) / _PRICE_STEPS)
    show(1.0)
    if best is None:
        raise InvalidValueError(f"no sketch fits into {most:,} bytes: give it a larger share of the stream")
    return best
