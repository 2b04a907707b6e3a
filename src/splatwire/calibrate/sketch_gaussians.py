"""Copies of the explicit Gaussians that matter, and how far the rest grows, chosen on pictures.

The error of a loss is mostly that of few Gaussians: the most important 1 % make 60 to 96 % of it (luigi, tiger, guitar,
truck), and no concealer can guess one of these. Copies of them cost about their share of the stream.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from splatwire.calibrate.pseudo_loss import dropped_packets
from splatwire.calibrate.sketch import SketchConfig, SketchResult
from splatwire.calibrate.views import CalibrationViews, Progress, References
from splatwire.codec import decode_stream
from splatwire.codec.schemas.gaussians.copies import MAX_COPIES, read_copies
from splatwire.codec.schemas.gaussians.copies_encoder import write_copies
from splatwire.codec.schemas.gaussians.decoder import open_side_info
from splatwire.conceal import conceal
from splatwire.conceal.conceal import drawn
from splatwire.conceal.scene_free.elements import element_inputs
from splatwire.conceal.sketch.concealer import grown_with_copies, with_copies
from splatwire.errors import InvalidValueError
from splatwire.model import Copies, Partial, SplatScene
from splatwire.model.appearance import Scene
from splatwire.packets import SceneStream
from splatwire.render import iterate_views
from splatwire.render.sensitivity import removal_sensitivity

LEVEL = 1
"""Class of precision of the copies. At equal bytes more of them are better than finer ones: luigi, 3 % of the stream,
class 1 / 3 / 5: 37.46 / 37.44 / 37.17 dB."""
GROWTHS = ((0.125, 0.75), (0.0, 0.0), (0.0, 0.5), (0.0, 1.0), (0.125, 1.25), (0.25, 0.75))
"""Exponents of size and opacity that are tried, the first with all of `TRUSTS`, the others with the best of these."""
TRUSTS = (0.0, 0.5, 1.0)
"""How much of the scene-free network's change of them is tried."""
Growth = tuple[float, float, float]
_NONE: Growth = (0.0, 0.0, 0.0)


def sketch_of_gaussians(
    stream: SceneStream,
    complete: Partial[SplatScene],
    views: CalibrationViews,
    config: SketchConfig,
    *,
    progress: Progress | None = None,
) -> SketchResult:
    """Makes the section `sketch` for a stream of explicit Gaussians.

    Args:
        stream: The complete stream, without such a section.
        complete: What a decoder made of it.
        views: Where it is looked at from.
        config: The run; `fit`, `exponents` and `trusts` are for anchors.
        progress: Called with what is done and the share of it that is done.

    Raises:
        InvalidValueError: If something was lost, no copy fits, or no view shows anything.
    """
    started, show = time.perf_counter(), progress or (lambda task, share: None)
    if complete.erasures.num_lost:
        raise InvalidValueError("calibration needs the complete scene, and of this one packets were lost")
    complete = replace(complete, scene=views.in_front(complete.scene))
    scene, info = complete.scene, open_side_info(stream.manifest, stream.side_info)
    removal = removal_sensitivity(
        scene.splats, views.reduced(config.views, config.width).cameras, background=torch.tensor(scene.background),
        probes=config.probes, seed=config.seed, progress=lambda share: show("what each Gaussian is worth", share),
    )  # fmt: skip
    if not float(removal.sum()) > 0:
        raise InvalidValueError("no view shows anything of the scene: there is nothing to calibrate on")
    ranked = removal.argsort(descending=True, stable=True).numpy()

    def written(count: int, growth: Growth) -> bytes:
        return write_copies(scene.splats, ranked[:count], info, level=LEVEL, growth=growth)

    count = _as_many_as_fit(lambda count: len(written(count, _NONE)), len(ranked), config.share * stream.num_bytes)
    section = written(count, _NONE)
    copies = read_copies(replace(info, sections={"sketch": section}), len(ranked))
    assert copies is not None
    scores = _Scores(stream, complete, copies, views.reduced(config.scored_views, config.width), config)
    growth, quality = scores.best_growth(show), {"no loss": scores.quality(scene)}
    quality |= scores.held_out(growth, show)
    seconds = time.perf_counter() - started
    return SketchResult(written(count, growth), count, growth[0], growth[2], quality, seconds)


def _as_many_as_fit(size: Callable[[int], int], most: int, limit: float) -> int:
    """The largest number up to `most` whose size is within the limit, where sizes rise."""
    low, high = 0, min(most, MAX_COPIES) + 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if size(middle) <= limit else (low, middle)
    if not low:
        raise InvalidValueError(f"no sketch fits into {limit:,.0f} bytes: give it a larger share of the stream")
    return low


def _lossy(stream: SceneStream, rate: float, seed: int) -> SceneStream:
    """The stream without a share of its packets."""
    dropped = set(dropped_packets(len(stream.packets), rate, seed))
    return stream.with_packets([packet for k, packet in enumerate(stream.packets) if k not in dropped])


class _Scores:
    """Mean PSNR of concealed losses; references are drawn, or loaded, once, and each loss is decoded once."""

    def __init__(
        self,
        stream: SceneStream,
        complete: Partial[SplatScene],
        copies: Copies,
        views: CalibrationViews,
        config: SketchConfig,
    ) -> None:
        self._complete, self._copies = complete, copies
        self._references = References.of(complete.scene, views)
        number = config.masks + config.held_out_masks
        seeds = np.random.SeedSequence(config.seed).generate_state(number).tolist()
        losses = [self._decoded(_lossy(stream, config.drop_rate, seed)) for seed in seeds]
        self._chosen_on, self._held_out = losses[: config.masks], losses[config.masks :]

    def best_growth(self, show: Progress) -> Growth:
        """The growth that gives the best pictures."""
        filled = [with_copies(partial, self._copies) for partial in self._chosen_on]
        inputs = [element_inputs(partial) for partial in filled]
        tried: dict[Growth, float] = {}

        def best_of(growths: Sequence[Growth]) -> Growth:
            for growth in growths:
                quality = 0.0
                for partial, around in zip(filled, inputs, strict=True):
                    quality += self.quality(
                        drawn(partial, partial, grown_with_copies(partial, around, growth), "sketch")
                    )
                tried[growth] = quality
                show("choosing the growth", len(tried) / (len(GROWTHS) + len(TRUSTS) - 1))
            return max(tried, key=lambda growth: tried[growth])

        trust = best_of([(*GROWTHS[0], trust) for trust in TRUSTS])[2]
        return best_of([(*base, trust) for base in GROWTHS[1:]])

    def held_out(self, growth: Growth, show: Progress) -> dict[str, float]:
        """Decibels on losses that chose nothing, by concealer."""
        copies = replace(self._copies, growth=growth)
        losses, found = [partial.saying(copies) for partial in self._held_out], {}
        for number, name in enumerate(("drop", "grow", "sketch")):
            found[name] = sum(self.quality(conceal(partial, name)) for partial in losses) / len(losses)
            show("held-out losses", (number + 1) / 3)
        return found

    def quality(self, scene: Scene) -> float:
        """Decibels over the views."""
        pictures = enumerate(iterate_views(scene, self._references.cameras))
        each = [self._references.psnr(view, picture) for view, picture in pictures]
        return sum(each) / len(each)

    def _decoded(self, stream: SceneStream) -> Partial[SplatScene]:
        partial = decode_stream(stream)
        scene = replace(partial.scene, background=self._complete.scene.background)
        return replace(partial, scene=scene).saying(self._copies)
