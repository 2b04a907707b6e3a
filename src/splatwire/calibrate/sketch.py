"""A sketch of the anchors that matter, and how far the rest grows, chosen on pictures."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool
from torch import Tensor

from splatwire.calibrate.checks import check_settings
from splatwire.calibrate.pseudo_loss import CalibrationData
from splatwire.calibrate.sketch_fit import SketchFit, SketchMaterial, fit_sketch, sketch_material
from splatwire.calibrate.views import CalibrationViews, Progress, References
from splatwire.conceal import Concealed, Concealer, Drop, Grow
from splatwire.conceal.conceal import drawn
from splatwire.conceal.sketch.concealer import SketchedLoss, buckets_of, conceal_with, with_sketch
from splatwire.conceal.sketch.section import MAX_TRUST, SketchSection, write_sketch
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, Partial
from splatwire.render import iterate_views
from splatwire.render.sensitivity import render_sensitivity

_PRICE_STEPS = 12
_MAX_WIDTH = 400


@dataclass(frozen=True)
class SketchConfig:
    """A calibration for the picture.

    Attributes:
        share: Bytes of the sketch over those of the stream.
        drop_rate: Share of packets that a pseudo-loss takes.
        masks: Pseudo-losses that choose the growth.
        held_out_masks: Pseudo-losses that choose nothing: the gain is reported on them.
        views: Most views that sensitivities are taken from, and
        scored_views: most views that pictures are compared in.
        width: Pictures are drawn at most this wide.
        probes: Random sign patterns per view (`render_sensitivity`).
        exponents: Powers of the growth that are tried.
        trusts: How much of the scene-free network's correction of the growth is tried, 0 for none.
        fit: How anchors are chosen and rounded.
        seed: Seed of everything random.
    """

    share: float = 0.04
    drop_rate: float = 0.2
    masks: int = 2
    held_out_masks: int = 2
    views: int = 24
    scored_views: int = 6
    width: int = _MAX_WIDTH
    probes: int = 2
    exponents: tuple[float, ...] = (0.0, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5)
    trusts: tuple[float, ...] = (0.0, 0.5, 1.0)
    fit: SketchFit = field(default_factory=SketchFit)
    seed: int = 0

    def __post_init__(self) -> None:
        check_settings(
            self, "a calibration", ("masks", "held_out_masks", "views", "scored_views", "width", "probes"),
            drop_rate=0 < self.drop_rate < 1, share=0 < self.share <= 0.5, seed=self.seed >= 0,
            exponents=bool(self.exponents) and all(0 <= e <= 4 for e in self.exponents),
            trusts=bool(self.trusts) and all(0 <= t <= MAX_TRUST for t in self.trusts),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SketchResult:
    """What came out.

    Attributes:
        section: Bytes of the section.
        num_sketched: Anchors that are sketched.
        exponent: Of the growth.
        trust: In the network that corrects it.
        psnr: Decibels on losses that chose nothing: `no loss`, `drop`, `grow` and `sketch`.
        seconds: Time taken.
    """

    section: bytes
    num_sketched: int
    exponent: float
    trust: float
    psnr: dict[str, float]
    seconds: float


def sketch_for_stream(
    data: CalibrationData,
    views: CalibrationViews,
    stream_bytes: int,
    config: SketchConfig,
    *,
    progress: Progress | None = None,
) -> SketchResult:
    """Makes the section `sketch` for a stream.

    Args:
        data: The complete scene and its packets.
        views: Where it is looked at from.
        stream_bytes: Size of the stream, of which the sketch may be a share.
        config: The run.
        progress: Called with what is done and the share of it that is done.

    Raises:
        InvalidValueError: If a sketch of that size holds nothing, or no view shows anything.
    """
    started, show = time.perf_counter(), progress or (lambda task, share: None)
    data = replace(data, complete=replace(data.complete, scene=views.in_front(data.scene)))
    sensitivity = render_sensitivity(
        data.scene, views.reduced(config.views, config.width).cameras, probes=config.probes, seed=config.seed,
        progress=lambda share: show("what each anchor is worth", share),
    )  # fmt: skip
    if not float(sensitivity.removal.sum()) > 0:
        raise InvalidValueError("no view shows anything of the scene: there is nothing to calibrate on")
    material = sketch_material(data.complete, sensitivity)
    buckets = buckets_of(data.complete)
    section = _of_size(material, buckets, config, round(config.share * stream_bytes), show)
    scored = _Scores(data, views.reduced(config.scored_views, config.width), config)
    section = _best_growth(scored, section, config, show)
    show("held-out losses", 0.0)
    quality = {"no loss": scored.quality(data.scene)}
    rows: dict[str, Concealer | SketchSection] = {"drop": Drop(), "grow": Grow(), "sketch": section}
    for number, (name, method) in enumerate(rows.items()):
        quality[name] = scored.held_out_quality(method)
        show("held-out losses", (number + 1) / len(rows))
    coded = write_sketch(section, buckets)
    seconds = time.perf_counter() - started
    return SketchResult(coded, len(section.values), section.exponent, section.trust, quality, seconds)


def _of_size(
    material: SketchMaterial, buckets: np.ndarray, config: SketchConfig, most: int, show: Progress
) -> SketchSection:
    """The sketch with the lowest price that takes at most so many bytes."""
    low, high = -40.0, 0.0  # logarithms of the price: too many bytes, few enough
    best: SketchSection | None = None
    for step in range(2 * _PRICE_STEPS):
        middle = 0.5 * (low + high)
        section = fit_sketch(material, 2.0**middle, config.fit)
        size = len(write_sketch(section, buckets)) if len(section.values) else 0
        if size > most:
            low = middle
        else:
            high, best = middle, section if size else best
            if size > 0.98 * most:
                break
        show("choosing anchors and steps", (step + 1) / (2 * _PRICE_STEPS))
    show("choosing anchors and steps", 1.0)
    if best is None:
        raise InvalidValueError(f"no sketch fits into {most:,} bytes: give it a larger share of the stream")
    return best


def _best_growth(scored: "_Scores", section: SketchSection, config: SketchConfig, show: Progress) -> SketchSection:
    """The section with the exponent, the trust at it, and the exponent at that trust which give the best pictures."""
    losses = [scored.sketched(section, known) for known in scored.chosen_on]
    tried: dict[tuple[float, float], float] = {}
    most = 2 * (len(config.exponents) + len(config.trusts))

    def best_of(pairs: Sequence[tuple[float, float]]) -> tuple[float, float]:
        for pair in pairs:
            if pair not in tried:
                candidate = replace(section, exponent=pair[0], trust=pair[1])
                tried[pair] = sum(scored.quality_of(loss, candidate) for loss in losses) / len(losses)
            show("choosing the growth", len(tried) / most)
        return max(pairs, key=lambda pair: tried[pair])

    trust = config.trusts[0]
    for _ in range(2):
        exponent, _ = best_of([(exponent, trust) for exponent in config.exponents])
        exponent, trust = best_of([(exponent, trust) for trust in config.trusts])
    show("choosing the growth", 1.0)
    return replace(section, exponent=exponent, trust=trust)


class _Scores:
    """Mean PSNR of concealed pseudo-losses; references are drawn, or loaded, once."""

    def __init__(self, data: CalibrationData, views: CalibrationViews, config: SketchConfig) -> None:
        self._complete = data.complete
        rates = [config.drop_rate] * (config.masks + config.held_out_masks)
        known = data.pseudo_losses(rates, config.seed)
        self.chosen_on, self._held_out = known[: config.masks], known[config.masks :]
        self._references = References.of(data.scene, views)

    def held_out_quality(self, method: "Concealer | SketchSection") -> float:
        """Decibels over the views, mean over the losses that choose nothing."""
        return sum(self.quality(self._concealed(method, known)) for known in self._held_out) / len(self._held_out)

    def sketched(self, section: SketchSection, known: Bool[Tensor, "N"]) -> SketchedLoss:
        """A loss with the copies in place, for `quality_of` with any growth."""
        return SketchedLoss.of(with_sketch(self._complete.without(known), section))

    def quality_of(self, loss: SketchedLoss, section: SketchSection) -> float:
        """Decibels over the views with the growth of a section."""
        return self.quality(self._drawn(loss.filled, loss.proposal(section)))

    def quality(self, scene: AnchorScene) -> float:
        """Decibels over the views."""
        pictures = enumerate(iterate_views(scene, self._references.cameras))
        each = [self._references.psnr(view, picture) for view, picture in pictures]
        return sum(each) / len(each)

    def _concealed(self, method: "Concealer | SketchSection", known: Bool[Tensor, "N"]) -> AnchorScene:
        partial = self._complete.without(known)
        return self._drawn(
            partial, conceal_with(partial, method) if isinstance(method, SketchSection) else method(partial)
        )

    def _drawn(self, partial: Partial[AnchorScene], proposal: Concealed) -> AnchorScene:
        scene: AnchorScene = drawn(partial, partial, proposal, "sketch")
        return scene
