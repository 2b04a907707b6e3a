"""Encoding of explicit Gaussians to a target size or quality, by pruning and quantisation."""

import functools
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from splatwire.arguments import checked
from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.gaussians.quality import Quality
from splatwire.errors import InvalidValueError
from splatwire.finetuning.pictures import Pictures
from splatwire.rate_control.pruning import PruningCurve, RemovalViews
from splatwire.rate_control.search import Interval, search
from splatwire.rate_control.shares import search_share
from splatwire.rate_control.steps import measured_colour_precision, measured_precision
from splatwire.rate_control.targets import Target
from splatwire.rate_control.tuning import Tuning, check_tunable, fitted_pictures, tuned_to_pictures
from splatwire.rate_control.views import SourcePictures, ViewSets
from splatwire.render.precision import measure_class_offsets
from splatwire.types import Cameras, SplatScene
from splatwire.types.scene import Scene

Effort = Literal["fast", "default", "best"]
"""Work per scene: `fast` chooses precision classes and keeps all Gaussians; `default` also prunes; `best` prunes more
and fine-tunes the remaining Gaussians."""
EFFORTS: tuple[str, ...] = get_args(Effort)
LEVELS = (2.5, 14.0)
"""Coarsest and finest level of quantisation of a search."""
START, OCTAVE_DB, OCTAVE_LOG = 7.5, 5.0, 0.25
"""First level of a search, and typical increase of PSNR (decibels) and of the logarithm of bytes per level."""
SIZE_TOLERANCE, PSNR_TOLERANCE = 0.03, 0.1
"""Maximum share by which a stream is below its target size, and maximum difference from a target PSNR in decibels."""
CORRECTIONS = 4
"""Maximum number of searches for a PSNR. Each search starts with the PSNR difference between held-out views and views
of the search that the previous search found.
"""
JUMP = 0.04
"""Minimum difference of levels in a search. Bytes and quality may jump within it, because positions are rounded to
cells whose size is a power of two.
"""
SHARE_OCTAVES = 4.0
"""Number of levels that changes the bytes as much as keeping all instead of none of the Gaussians."""
MIN_SHARE_RATIO = 0.6
"""Smallest share of Gaussians to keep on the fine side of a jump, relative to the best one."""
MIN_ERROR = 1e-12
"""Minimum mean squared error, so that logarithms are finite."""
PRUNED_GAIN_DB, ROUNDED_GAIN_DB = 5.0, 2.5
"""Expected reduction of the errors of pruning and of quantisation by the first fine-tuning, decibels. The first value
is less than usual, because a second fine-tuning can continue the first one only with fewer Gaussians.
"""
MORE_PRUNING_DB = 4.5
"""Difference between the usual gains of fine-tuning on the errors of pruning and of quantisation, decibels."""
MAX_PRUNED_ERROR = 0.9
"""Maximum share of the error of pruning in the error of a stream."""
TUNED_SHARE_DB = 6.0
"""Typical increase of the PSNR of fine-tuned scenes per unit of the logarithm of the share of Gaussians, decibels."""
TRIMMED_SHARE_DB, MIN_TRIMMED_SHARE = 12.0, 0.8
"""Typical increase of the PSNR of fine-tuned scenes with the share of Gaussians that is kept afterwards, decibels, and
smallest share."""
EXCESS_DB, EXCESS_LOG = 0.25, 0.06
"""Maximum difference of fine-tuned scenes from the smallest PSNR (decibels) or logarithm of bytes that is permitted,
before coarser steps reduce it."""
_IDENTITY = np.array([1, 0, 0, 0], np.float32)
"""Quaternion (w, x, y, z) of no rotation."""
_LOG = logging.getLogger(__name__)
Encoder = Callable[[SplatScene, np.ndarray, Quality], SceneStream]
"""Encodes a scene with the given class offsets and quality setting."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class EncodedScene:
    """Result of encoding a scene to a target size, PSNR or quality setting.

    Attributes:
        stream: The stream.
        quality: Quantisation setting that was chosen.
        kept: Share of the Gaussians that were kept, 0 to 1.
        held_out: Pictures of the source for measuring the PSNR, in views that were not used for the encoding.
        fine_tuned: True if the kept Gaussians were fine-tuned.
    """

    stream: SceneStream
    quality: Quality
    kept: float
    held_out: SourcePictures
    fine_tuned: bool = False

    @functools.cached_property
    def psnr(self) -> float:
        """Mean PSNR of the decoded scene in the held-out views, decibels."""
        return self.held_out.mean_psnr(decoded_finest(self.stream))


@checked
def encode_controlled(
    scene: SplatScene,
    target: Target,
    encode: Encoder,
    *,
    effort: Effort = "default",
    cameras: Cameras | None = None,
    tuning: Tuning = Tuning(),  # noqa: B008 - frozen
    progress: Progress = lambda task, share: None,
) -> EncodedScene:
    """Encodes Gaussians to a size, a PSNR or a quality setting.

    A target size is a maximum; the stream is usually at most 3 % smaller. A target PSNR is usually reached within 0.2
    dB.

    Args:
        scene: The scene to encode. Gaussians that cannot be seen are skipped.
        target: Size, PSNR or quality setting.
        encode: Function that encodes a scene.
        effort: `fast` keeps all Gaussians and only chooses precision classes; `default` also prunes; `best` prunes
            more, and fine-tunes the remaining Gaussians.
        cameras: Cameras at typical viewing positions; None for views around the scene.
        tuning: Options of the fine-tuning, which only the effort `best` uses.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Raises:
        InvalidValueError: If the scene has nothing to draw, is too large for `best`, or the target cannot be reached.
    """
    validity = scene.validity()
    validity.log_removed("encoding", scene.ELEMENTS)
    source = scene if validity.all_drawable else scene.select(validity.kept)
    if not source.num_elements:
        raise InvalidValueError("there is no Gaussian that draws anything: there is nothing to encode")
    if effort != "fast":
        source = _with_unrotated_spheres(source)
    if effort == "best":
        check_tunable(source)
    views = ViewSets.of(source, cameras)
    quality = target.quality or Quality(START)
    plan = _Plan.of(source, effort, views, quality, encode, progress)
    if effort != "best":
        return _Trials(plan, encode, progress).encode_to_target(target)

    def choosing(task: str, share: float) -> None:
        progress("choosing Gaussians", share)

    # The search without fine-tuning is done first, so that impossible targets are errors before the fine-tuning.
    untuned = None if target.quality is not None else _Trials(plan, encode, choosing).encode_to_target(target)
    tunable = plan.with_precision_for_tuning(quality)
    if target.psnr is None:
        start = _Trials(tunable.with_more_pruning(), encode, choosing).encode_to_target(target)
    else:
        pruned = untuned
        if pruned is None or tunable.precision != plan.precision:
            pruned = _Trials(tunable, encode, choosing).encode_to_target(target)
        start = tunable.encoded(pruned.quality, encode, tunable.share_to_tune(pruned))
    pictures = fitted_pictures(source, cameras, tuning, progress)
    tuned = _prune_and_tune(tunable, start, target, encode, pictures, tuning, progress)
    encoded = _Trials(tuned, encode, progress, start.quality.level).closest(target)
    if encoded is not None and target.psnr is not None and encoded.psnr > target.psnr + PSNR_TOLERANCE:
        encoded = tuned.trimmed(encoded, target.psnr, encode)
    better = plan.better_of(encoded, untuned, target, for_loss=tuning.packet_loss is not None)
    if better is not encoded:
        _LOG.warning("fine-tuning gains nothing for this target: the scene is encoded as with effort default")
    return better


def _with_unrotated_spheres(scene: SplatScene) -> SplatScene:
    """Sets the rotation of each Gaussian with three equal scales to the identity, which takes the fewest bytes."""
    # Rotations of spheres do not change pictures.
    splats = scene.splats
    spheres = splats.scales.min(axis=1) == splats.scales.max(axis=1)
    if not spheres.any():
        return scene
    return replace(scene, splats=replace(splats, quats=np.where(spheres[:, None], _IDENTITY, splats.quats)))


def _prune_and_tune(
    plan: "_Plan",
    start: EncodedScene,
    target: Target,
    encode: Encoder,
    pictures: Pictures,
    tuning: Tuning,
    progress: Progress,
) -> "_Plan":
    """Prunes a scene and fine-tunes the remaining Gaussians, so that the stream reaches a target.

    Args:
        plan: The scene before pruning.
        start: Stream of the pruned scene without fine-tuning. The Gaussians are fine-tuned for its quantisation steps.
        target: Target of the stream, given as a size, a PSNR or a quality setting.
        encode: Function that encodes a scene.
        pictures: Pictures of the complete scene.
        tuning: Options of the fine-tuning.
        progress: Called with the name of the current task and its finished share.

    Returns:
        The fine-tuned Gaussians, ready to be encoded.
    """
    # Different shares of the Gaussians are fine-tuned, one after another, until the result reaches the target. With
    # a quality setting, the scene is fine-tuned once.
    # Fine-tuned Gaussians are adapted to the steps of `start`: coarser steps still save bytes, finer ones gain nothing.
    # The share is therefore chosen so that these steps give the target or a little more.
    tuned: list[_Plan] = []
    packetization = start.stream.manifest.packetization

    def tune(share: float) -> float:
        pruned, class_offsets = plan.pruned(share, tuned)
        scene = tuned_to_pictures(pruned, class_offsets, pictures, start.quality, packetization, tuning, progress)
        tuned.append(replace(plan, class_offsets=class_offsets, curve=None, scene=scene))
        encoded = tuned[-1].encoded(start.quality, encode)
        return math.log(encoded.stream.num_bytes) if target.psnr is None else encoded.psnr

    if target.psnr is not None:
        low, excess, slope = target.psnr - PSNR_TOLERANCE / 2, EXCESS_DB, TUNED_SHARE_DB
    elif target.size is not None:
        low, excess, slope = math.log(target.size * (1 - SIZE_TOLERANCE)), EXCESS_LOG, 1.0
    else:
        tune(start.kept)
        return tuned[0]
    return tuned[search_share(tune, Interval(low, low + excess / 2, low + excess), start.kept, slope)]


def _slope(pairs: Sequence[tuple[float, float]]) -> float:
    """Estimates how much the PSNR in the held-out views changes for each decibel in the views of the search.

    The estimate is at least 0.5 and at most 2.

    Args:
        pairs: PSNR in the views of the search, and PSNR in the held-out views, for each stream so far, decibels.
    """
    if len(pairs) < 2:
        return 1.0
    (before, psnr_before), (last, psnr_last) = pairs[-2:]
    return (
        min(max((psnr_last - psnr_before) / (last - before), 0.5), 2.0) if abs(last - before) > PSNR_TOLERANCE else 1.0
    )


def decoded_finest(stream: SceneStream) -> Scene:
    """Decodes a complete stream. If the scene has levels of detail, only the finest level is returned."""
    scene = decode_stream(stream).scene
    return scene if scene.hints is None else scene.select(~scene.hints.left_out)


@dataclass(frozen=True, eq=False)
class _Plan:
    """Scene to encode, with measurements that decide on pruning and on the precision of each Gaussian.

    Attributes:
        source: The scene to encode.
        views: Views for measuring the effect of removing each Gaussian.
        search: Pictures of the source with which streams are compared during the search for a quantisation level.
        held_out: Pictures of the source for the reported PSNR.
        class_offsets: Precision class of each Gaussian, which selects its quantisation steps: 0 or more for the finest,
            negative for coarser ones.
        curve: Image error as a function of the share of Gaussians kept; None without pruning.
        scene: The Gaussians to prune and encode: those of `source`, or fine-tuned ones.
        precision: Additional precision of each attribute (`Quality.precision`).
    """

    source: SplatScene
    views: RemovalViews
    search: SourcePictures
    held_out: SourcePictures
    class_offsets: np.ndarray
    curve: PruningCurve | None
    scene: SplatScene
    precision: tuple[float, ...]

    @classmethod
    def of(
        cls, source: SplatScene, effort: Effort, views: ViewSets, quality: Quality, encode: Encoder, progress: Progress
    ) -> "_Plan":
        """Measures a scene before encoding: importance and required precision of each Gaussian.

        Args:
            source: The scene.
            effort: Effort of the encoder: `fast`, `default` or `best`.
            views: Views for measuring the scene.
            quality: Typical quality setting, at which the precision of attributes is chosen.
            encode: Function that encodes a scene.
            progress: Called with the name of the current task and its finished share.
        """
        # With `fast`, no pruning and no precision of attributes is measured.
        search, held_out = SourcePictures(source, views.search), SourcePictures(source, views.held_out)
        progress("measuring Gaussians", 0.0)
        if effort == "fast":
            class_offsets = measure_class_offsets(source.splats, views.measured)
            return cls(source, RemovalViews(()), search, held_out, class_offsets, None, source, quality.precision)
        removals = RemovalViews.of(source, views.measured)
        measured = removals.measure_complete(source)
        progress("measuring Gaussians", 1.0)
        curve = PruningCurve.measured(
            source, measured.removal, search, removals, lambda share: progress("pruning", share)
        )
        kept = curve.kept(curve.best_share(quality.level))
        # With measured steps of all attributes, playbot of degree 2 took more bytes.
        choose = measured_colour_precision if source.splats.degree else measured_precision
        precision = choose(
            source.select(kept),
            measured.class_offsets[kept],
            quality,
            views.search,
            encode,
            lambda share: progress("choosing precision", share),
        )
        return cls(source, removals, search, held_out, measured.class_offsets, curve, source, precision)

    def quality(self, quality_level: float) -> Quality:
        """Returns the quality setting with a given quantisation level and this plan's precision of each attribute.

        Args:
            quality_level: Quantisation level (`Quality.level`); a higher level has smaller quantisation steps.
        """
        return Quality(quality_level, precision=self.precision)

    def with_precision_for_tuning(self, quality: Quality) -> "_Plan":
        """Returns a copy of this plan with a precision of each attribute that suits fine-tuning.

        It is the mean of two precisions: this plan's precision, which is the best one without fine-tuning, and the
        precision of `quality`.

        Args:
            quality: Quality setting at which the precision of this plan was measured.
        """
        # Fine-tuning compensates for the rounding of colours and opacities, but hardly for that of rotations, which the
        # measurement makes much coarser: with half of the change, truck takes 0.48 instead of 0.55 of the bytes of all
        # Gaussians (guitar 0.26 instead of 0.24).
        half = tuple((new + old) / 2 for new, old in zip(self.precision, quality.precision, strict=True))
        return replace(self, precision=half)

    def with_more_pruning(self) -> "_Plan":
        """Returns a copy of this plan that keeps fewer Gaussians at the same quantisation level, for fine-tuning.

        Fine-tuning compensates for part of the image error that pruning causes. The copy therefore assumes smaller
        errors (`curve`), so that it prunes more.
        """
        assert self.curve is not None
        return replace(self, curve=self.curve.scaled(10 ** (-MORE_PRUNING_DB / 10)))

    def pruned(self, share: float, tuned: Sequence["_Plan"]) -> tuple[SplatScene, np.ndarray]:
        """Selects the most important Gaussians of the scene, to fine-tune them.

        Args:
            share: Share of the Gaussians of `source` to keep, 0 to 1.
            tuned: Results of earlier fine-tunings. A result can be used if it has more Gaussians than are to be kept.
                The Gaussians are selected from the smallest usable result. Without a usable result, they are selected
                from `source`.

        Returns:
            The kept Gaussians, and the precision class of each.
        """
        assert self.curve is not None
        kept = self.curve.kept(share)
        larger = [each for each in tuned if each.scene.num_elements > len(kept)]
        if not larger:
            return self.source.select(kept), self.class_offsets[kept]
        before = min(larger, key=lambda each: each.scene.num_elements)
        # Fine-tuning has changed the effect of each Gaussian.
        removal = self.views.removal(before.scene)
        best = np.sort(np.argsort(-removal, kind="stable")[: len(kept)])
        return before.scene.select(best), before.class_offsets[best]

    def trimmed(self, encoded: EncodedScene, psnr: float, encode: Encoder) -> EncodedScene:
        """Removes fine-tuned Gaussians to save bytes, if the stream exceeds the wanted PSNR.

        Args:
            encoded: Stream of all Gaussians of this plan.
            psnr: Wanted PSNR in the held-out views, decibels.
            encode: Function that encodes a scene.

        Returns:
            The stream with the PSNR closest to `psnr`.
        """
        count = self.scene.num_elements
        order = np.argsort(-self.views.removal(self.scene), kind="stable")
        tried = [encoded]

        def psnr_of_share(share: float) -> float:
            kept = np.sort(order[: max(round(share * count), 1)])
            stream = encode(self.scene.select(kept), self.class_offsets[kept], encoded.quality)
            tried.append(EncodedScene(stream, encoded.quality, encoded.kept * len(kept) / count, self.held_out, True))
            return tried[-1].psnr

        # Coarser steps would cost more: fine-tuned Gaussians are adapted to their cells of the position lattice.
        permitted = Interval(psnr - PSNR_TOLERANCE, psnr, psnr + PSNR_TOLERANCE)
        slope = TRIMMED_SHARE_DB
        search(psnr_of_share, permitted, 1 + (psnr - encoded.psnr) / slope, slope, (MIN_TRIMMED_SHARE, 1.0))
        return min(tried, key=lambda each: abs(each.psnr - psnr))

    def search_psnr(self, encoded: EncodedScene) -> float:
        """Returns the mean PSNR of an encoded scene, decibels, in the views for the search for a quantisation level."""
        return self.search.mean_psnr(decoded_finest(encoded.stream))

    def share_to_tune(self, untuned: EncodedScene) -> float:
        """Estimates the share of Gaussians to keep so that the fine-tuned stream has the PSNR of `untuned`.

        Args:
            untuned: Stream without fine-tuning; gives the PSNR to reach.
        """
        # The quantisation steps remain the same.
        assert self.curve is not None
        error = 10 ** (-self.search_psnr(untuned) / 10)
        pruned = min(self.curve.error(untuned.kept), MAX_PRUNED_ERROR * error)
        rounded = (error - pruned) * 10 ** (-ROUNDED_GAIN_DB / 10)
        return min(self.curve.share(max(error - rounded, MIN_ERROR) * 10 ** (PRUNED_GAIN_DB / 10)), untuned.kept)

    @staticmethod
    def better_of(
        tuned: EncodedScene | None, untuned: EncodedScene | None, target: Target, *, for_loss: bool
    ) -> EncodedScene:
        """Chooses between the streams with and without fine-tuning that were encoded for the same target.

        For a target size, the result is the stream with the higher PSNR. For a target PSNR, it is the smaller stream,
        provided that the fine-tuned stream reaches the PSNR. If only one stream is given, it is returned.

        Args:
            tuned: Stream of fine-tuned Gaussians; None if none reaches the target.
            untuned: Stream without fine-tuning; None if the target is a quality setting.
            target: The target of both streams.
            for_loss: True if Gaussians were fine-tuned for packet loss. A fine-tuned stream that meets the target is
                then chosen even if the other stream is smaller or has a higher PSNR.
        """
        # Fine-tuning for packet loss raises quality only if packets are lost, so its stream is chosen if it reaches the
        # target.
        if tuned is None or untuned is None:
            better = tuned or untuned
            assert better is not None
            return better
        if target.psnr is None:
            return tuned if for_loss or tuned.psnr >= untuned.psnr else untuned
        above, tolerance = tuned.psnr - target.psnr, max(2 * PSNR_TOLERANCE, abs(untuned.psnr - target.psnr))
        smaller = tuned.stream.num_bytes < untuned.stream.num_bytes
        return tuned if above >= -tolerance and (smaller or (for_loss and above <= tolerance)) else untuned

    def encoded(self, quality: Quality, encode: Encoder, share: float | None = None) -> EncodedScene:
        """Prunes and encodes the scene at a quality setting.

        Args:
            quality: Quality setting.
            encode: Function that encodes a scene.
            share: Share of the Gaussians to keep, 0 to 1; None for the best share at this setting.
        """
        # A plan without a `curve` keeps all Gaussians.
        if self.curve is None:
            scene, class_offsets = self.scene, self.class_offsets
        else:
            kept = self.curve.kept(self.curve.best_share(quality.level) if share is None else share)
            scene, class_offsets = self.scene.select(kept), self.class_offsets[kept]
        share = scene.num_elements / self.source.num_elements
        tuned = self.scene is not self.source
        return EncodedScene(encode(scene, class_offsets, quality), quality, share, self.held_out, tuned)


class _Trials:
    """Encodes a scene at several quantisation levels (`Quality.level`), to find a level for a target size or PSNR.

    Args:
        plan: The scene and its class offsets.
        encode: Function that encodes a scene.
        progress: Called with the name of the current task and its finished share.
        tuned_level: Quantisation level for which the Gaussians were fine-tuned. The search begins at this level. None
            without fine-tuning.
    """

    # Levels finer than `tuned_level` are not tried.

    def __init__(self, plan: _Plan, encode: Encoder, progress: Progress, tuned_level: float | None = None) -> None:
        self._plan, self._encode, self._progress = plan, encode, progress
        self._start = START if tuned_level is None else tuned_level
        self._ends = LEVELS[0], LEVELS[1] if tuned_level is None else tuned_level
        self._found: list[tuple[float, EncodedScene]] = []

    def of_size(self, size: int) -> EncodedScene | None:
        """Encodes the scene at several quantisation levels; returns the largest stream found of at most `size` bytes.

        Returns None if all streams are larger.
        """
        permitted = Interval(
            math.log(size * (1 - SIZE_TOLERANCE)), math.log(size * (1 - SIZE_TOLERANCE / 2)), math.log(size)
        )
        self._search(lambda encoded: math.log(encoded.stream.num_bytes), permitted, self._start, OCTAVE_LOG)
        fitting = [(value, each) for value, each in self._found if each.stream.num_bytes <= size]
        return max(fitting, key=lambda trial: trial[0])[1] if fitting else None

    def encode_to_target(self, target: Target) -> EncodedScene:
        """Encodes the scene so that the stream reaches a target size, PSNR or quality setting.

        Raises:
            InvalidValueError: If the target cannot be reached.
        """
        encoded = self.closest(target)
        if encoded is None:
            least = min(each.stream.num_bytes for _, each in self._found)
            raise InvalidValueError(
                f"this scene cannot be encoded to {target.size:,} bytes: the smallest stream has {least:,}"
            )
        if (
            target.psnr is not None
            and encoded.psnr < target.psnr - PSNR_TOLERANCE
            and encoded.quality.level == LEVELS[1]
        ):
            raise InvalidValueError(
                f"this scene cannot be encoded to {target.psnr:g} dB: the finest stream has {encoded.psnr:.1f} dB"
            )
        return encoded

    def closest(self, target: Target) -> EncodedScene | None:
        """Encodes the scene to a target size, PSNR or quality setting, as exactly as possible.

        Returns:
            The stream. For a target size, the largest stream found that does not exceed it; None if all are larger.
        """
        if target.quality is not None:
            return self._plan.encoded(replace(target.quality, precision=self._plan.precision), self._encode)
        if target.size is not None:
            return self.of_size(target.size)
        assert target.psnr is not None
        return self.of_psnr(target.psnr)

    def of_psnr(self, psnr: float) -> EncodedScene:
        """Encodes the scene so that the PSNR in the held-out views is as close as possible to `psnr` decibels.

        Raises:
            InvalidValueError: If the rendered images equal those of the source at every quantisation level, for example
                because the scene is invisible.
        """
        # The quantisation level is chosen by the PSNR in other views (`ViewSets.search`). If the PSNR in the
        # held-out views then differs from `psnr`, the level is chosen again with a corrected target.
        start, wanted, by_share = self._start, psnr, False
        best: EncodedScene | None = None
        found: tuple[float, EncodedScene] | None = None
        pairs: list[tuple[float, float]] = []
        for _ in range(CORRECTIONS):
            first = len(self._found)
            permitted = Interval(wanted - PSNR_TOLERANCE / 2, wanted, wanted + PSNR_TOLERANCE / 2)
            if by_share and found is not None:  # another search of levels would end next to the same jump
                self._search_shares(self._plan.search_psnr, permitted, found, OCTAVE_DB)
            else:
                by_share = self._search(self._plan.search_psnr, permitted, start, OCTAVE_DB)
            value, last = found = min(self._found[first:], key=lambda each: abs(each[0] - wanted))
            if best is None or abs(last.psnr - psnr) < abs(best.psnr - psnr):
                best = last
            excess = last.psnr - psnr
            end = self._ends[0] if excess > 0 else self._ends[1]
            if abs(excess) <= PSNR_TOLERANCE or last.quality.level == end or not math.isfinite(value - excess):
                break
            pairs.append((value, last.psnr))
            start, wanted = last.quality.level - excess / OCTAVE_DB, value - excess / _slope(pairs)
        assert best is not None
        if all(math.isinf(value) for value, _ in self._found):
            raise InvalidValueError("no camera shows a difference between source and stream: do they see the scene?")
        return best

    def _search(
        self, measure: Callable[[EncodedScene], float], permitted: Interval, start: float, slope: float
    ) -> bool:
        """Encodes the scene at different quantisation levels, until the stream has a wanted size or PSNR.

        If no level gives an accepted value, different shares of the Gaussians are then encoded at a single level. This
        is the level with the smallest value above the accepted range. Shares are not tried if Gaussians must not be
        pruned, if no value is above the range, or if this level is the coarsest one.

        Args:
            measure: Function that measures an encoded scene: logarithm of its size in bytes, or its PSNR in decibels.
            permitted: Range of accepted values.
            start: First level to try.
            slope: Expected increase of the measured value per level.

        Returns:
            True if different shares of the Gaussians were tried.
        """
        first = len(self._found)
        result = search(functools.partial(self._encode_and_measure, measure), permitted, start, slope, self._ends, JUMP)
        above = [each for each in self._found[first:] if each[0] > permitted.high]
        if result is not None or not above or self._plan.curve is None:
            return False
        finer = min(above, key=lambda result: result[0])
        if finer[1].quality.level <= LEVELS[0]:
            return False
        self._search_shares(measure, permitted, finer, slope)
        return True

    def _search_shares(
        self,
        measure: Callable[[EncodedScene], float],
        permitted: Interval,
        start: tuple[float, EncodedScene],
        slope: float,
    ) -> None:
        """Encodes different shares of the Gaussians at one quantisation level, until size or PSNR is as wanted.

        Args:
            measure: Function that measures an encoded scene: logarithm of its size in bytes, or its PSNR in decibels.
            permitted: Range of accepted values.
            start: Measured value of an encoded scene, and this encoded scene. It gives the quantisation level, and
                the first share to try is estimated from it.
            slope: Expected increase of the measured value per quantisation level. The increase per share is estimated
                from it.
        """
        value, encoded = start
        share, per_share = encoded.kept, slope * SHARE_OCTAVES / encoded.kept
        ends = (MIN_SHARE_RATIO * share, min(share / MIN_SHARE_RATIO, 1.0))
        first_share = share + (permitted.wanted - value) / per_share
        search(
            functools.partial(self._encode_and_measure, measure, encoded.quality.level),
            permitted,
            first_share,
            per_share,
            ends,
        )

    def _encode_and_measure(
        self, measure: Callable[[EncodedScene], float], quality_level: float, share: float | None = None
    ) -> float:
        """Encodes a share of the Gaussians at a quantisation level; returns the measured value of the result.

        Args:
            measure: Function that measures an encoded scene: logarithm of its size in bytes, or its PSNR in decibels.
            quality_level: Quantisation level; a higher level has smaller quantisation steps.
            share: Share of the Gaussians to keep, 0 to 1; None for the best share at this level.
        """
        encoded = self._plan.encoded(self._plan.quality(quality_level), self._encode, share)
        self._found.append((measure(encoded), encoded))
        self._progress("searching", 1 - 1 / (1 + len(self._found) / 2))
        return self._found[-1][0]
