"""The recipes of the benchmarks."""

import dataclasses
import math
from dataclasses import dataclass

from splatwire.channel import Nothing, parse_loss
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.model.causal import CausalConfig
from splatwire.train.config import (
    FULL_ITERATIONS,
    GrowthRules,
    LearningRate,
    LearningRates,
    LossTraining,
    LossWeights,
    Marks,
    RefineConfig,
    TrainConfig,
)

MIN_ITERATIONS = 20
HACPP, CAUSAL = "hacpp", "causal"
MODELS = (HACPP, CAUSAL)
DEFAULT_MODEL = CAUSAL
"""What a scene is to be coded with: the model of HAC++ (format 1), or the causal one (format 2)."""
CAUSAL_RATE = 0.008
CAUSAL_HIDDEN = (50, 32, 32)
CAUSAL_MASK_RATE = LearningRate(0.005, 0.005)
CAUSAL_MASK_THRESHOLD = 0.1
CAUSAL_SAMPLE_SHARE = 0.1
CAUSAL_GRADIENT = 0.0003
"""The causal model's lambda, widths, masks, sample and growth, whatever the benchmark. Growing from a larger gradient
on, it has two thirds of the anchors (lego; nine tenths on snowmiku_small), each of which may cost more: 0.6 dB at 211
kB of lego, 0.15 of which may be the mean's (`averaged`); nothing on snowmiku_small at 520 kB. From 0.0004 on both
lose."""
CAUSAL_LATE = {
    "offsets": 7.0, "color": 2.5, "opacity": 2.5, "features": 2.0, "log_scalings": 2.0, "covariance": 2.0,
    "causal": 2.0, "steps": 1.2,
}  # fmt: skip
"""`LearningRate.late` of a run of 2,400 iterations with the causal model: no anchor grows for it, and what is too
restless evens out in the mean that a run leaves. 0.56 dB at 3 % fewer bytes on lego, 0.16 dB at as many on
snowmiku_small; twice as much for offsets is worse, and so is learning so fast from the start (a fifth more anchors)."""
CAUSAL_LENGTH = 2400
TUNING_SHARE = 0.3
"""Iterations that a run for losses goes on for (`splatwire.train.tuning`), relative to its length; causal model."""
_GO_ON = ("offsets", "opacity", "color", "causal", "steps")
_SHORTER = 4 / 3
"""What learns faster at the end of a short run, and the power of how much shorter that is, by which it does."""


@dataclass(frozen=True)
class Preset:
    """What differs from benchmark to benchmark.

    Attributes:
        rate: Default lambda.
        voxel_size: As in `TrainConfig`.
        coarsest_cell: As in `GrowthRules`.
        mask_rate_per_lambda: Final learning rate of the masks per lambda.
        mask_rate_cap: Its upper bound.
        first_pruning: As in `GrowthRules`.
        test_views: As in `TrainConfig`.
    """

    rate: float
    voxel_size: float
    coarsest_cell: int
    mask_rate_per_lambda: float
    mask_rate_cap: float = math.inf
    first_pruning: int = 0
    test_views: str = "every_8th"


PRESETS = {
    "mipnerf360": Preset(0.004, 0.001, 16, 0.5, 0.0015),
    "tanks_and_temples": Preset(0.004, 0.01, 16, 0.1),
    "deep_blending": Preset(0.004, 0.005, 16, 0.08),
    "bungeenerf": Preset(0.004, 0.0, 128, 0.1, test_views="first_31"),
    "synthetic_nerf": Preset(0.001, 0.001, 4, 0.08, first_pruning=300),
}


def create_config(
    preset: str = "mipnerf360",
    *,
    model: str = CAUSAL,
    lmbda: float | None = None,
    size: int = 0,
    iterations: int = FULL_ITERATIONS,
    voxel_size: float | None = None,
    growth_interval: int | None = None,
    refine_steps: int | None = None,
    losses: tuple[str, ...] = (),
    loss_share: float = LossTraining.share,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    seed: int = 0,
) -> TrainConfig:
    """Creates the recipe of a benchmark.

    Args:
        preset: A key of `PRESETS`.
        model: One of `MODELS`.
        lmbda: Weight of the rate; the preset's where absent.
        size: As `LossWeights.size`.
        iterations: Length of the run; all phases keep their proportions.
        voxel_size: Spacing of anchor positions, world units, 0 to derive it from the points; the preset's where absent.
        growth_interval: Iterations between two changes of the anchors; in proportion, and at least 50, where absent.
        refine_steps: As `RefineConfig.steps`; where absent a quarter of the iterations, and at most its default.
        losses: What the scene is trained for, as `loss_training` reads it; nothing for none.
        loss_share: As `LossTraining.share`.
        background: RGB behind the scene.
        seed: Of everything random.

    Raises:
        UnknownNameError: No preset, model or loss model has that name.
        InvalidValueError: A value is out of range.
    """
    if model not in MODELS:
        raise UnknownNameError("model", model, MODELS)
    if preset not in PRESETS:
        raise UnknownNameError("preset", preset, PRESETS)
    chosen = PRESETS[preset]
    rate = (chosen.rate if model == HACPP else CAUSAL_RATE) if lmbda is None else lmbda
    voxel = chosen.voxel_size if voxel_size is None else voxel_size
    _check(rate, voxel, iterations)
    marks = _marks(iterations, growth_interval)
    steps = min(RefineConfig().steps, iterations // 4) if refine_steps is None else refine_steps
    mask_rate = max(min(chosen.mask_rate_per_lambda * rate, chosen.mask_rate_cap), 1e-6)
    config = TrainConfig(
        preset=preset,
        voxel_size=voxel,
        marks=marks,
        rates=for_length(LearningRates(mask_logits=LearningRate(0.01, mask_rate)), iterations),
        growth=GrowthRules(coarsest_cell=chosen.coarsest_cell, first_pruning=chosen.first_pruning),
        weights=LossWeights(rate=rate, size=size),
        refine=RefineConfig(steps=steps, seed=seed),
        losses=loss_training(losses, loss_share),
        background=background,
        test_views=chosen.test_views,
        seed=seed,
    )
    return config if model == HACPP else _going_on(_causal(config))


def for_length(rates: LearningRates, iterations: int) -> LearningRates:
    """Returns the published learning rates for a run of another length: what is drawn goes on learning in a short one.

    With the published ends the Gaussians of a short run do not arrive: 2,400 iterations of lego end 1.1 dB lower (one
    training). Ends 12 times larger are 0.3 dB below these (30 times larger), opacity and colour that end as they start
    0.1 dB. Where hash grid and context networks go on learning, too, lego's stream is three times as large.

    Args:
        rates: Of `FULL_ITERATIONS`.
        iterations: Length of the run.
    """
    factor = max(FULL_ITERATIONS / iterations, 1.0) ** _SHORTER
    published = {name: getattr(rates, name) for name in _GO_ON}
    ends = {name: min(rate.final * factor, rate.initial) for name, rate in published.items()}
    return dataclasses.replace(
        rates, **{name: LearningRate(published[name].initial, end) for name, end in ends.items()}
    )


def _faster_later(rates: LearningRates, iterations: int) -> LearningRates:
    """Returns the rates with `CAUSAL_LATE`, as far as a run is shorter than a full one."""
    share = math.log(FULL_ITERATIONS / iterations) / math.log(FULL_ITERATIONS / CAUSAL_LENGTH)
    power = min(max(share, 0.0), 1.0)
    late = {name: dataclasses.replace(getattr(rates, name), late=most**power) for name, most in CAUSAL_LATE.items()}
    return dataclasses.replace(rates, **late)


def _causal(config: TrainConfig) -> TrainConfig:
    """The recipe with the causal model, whose masks have to learn fast, and whose networks are small."""
    return dataclasses.replace(
        config,
        model=CausalConfig(),
        hidden=CAUSAL_HIDDEN,
        rates=_faster_later(dataclasses.replace(config.rates, mask_logits=CAUSAL_MASK_RATE), config.marks.iterations),
        weights=dataclasses.replace(config.weights, sample_share=CAUSAL_SAMPLE_SHARE),
        growth=dataclasses.replace(config.growth, gradient_threshold=CAUSAL_GRADIENT),
        mask_threshold=CAUSAL_MASK_THRESHOLD,
    )


def _going_on(config: TrainConfig) -> TrainConfig:
    """The recipe with iterations for losses at the end, if it has losses."""
    if not (config.losses.models or config.losses.first):
        return config
    marks, more = config.marks, round(TUNING_SHARE * config.marks.iterations)
    return dataclasses.replace(
        config, marks=dataclasses.replace(marks, iterations=marks.iterations + more, tuning=more)
    )


def _check(rate: float, voxel: float, iterations: int) -> None:
    if not (math.isfinite(rate) and rate >= 0):
        raise InvalidValueError(f"lambda must be 0 or more, not {rate}")
    if not (math.isfinite(voxel) and voxel >= 0):
        raise InvalidValueError(f"the voxel size must be 0 (derive it from the points) or more, not {voxel}")
    if iterations < MIN_ITERATIONS:
        raise InvalidValueError(f"a run has at least {MIN_ITERATIONS} iterations, not {iterations}")


def _marks(iterations: int, growth_interval: int | None) -> Marks:
    marks = Marks().scaled(iterations)
    if growth_interval is None:
        return marks
    if growth_interval < 1:
        raise InvalidValueError(f"there is at least 1 iteration between changes of the anchors, not {growth_interval}")
    return dataclasses.replace(marks, growth_interval=growth_interval)


def loss_training(losses: tuple[str, ...], share: float = LossTraining.share) -> LossTraining:
    """Returns how a scene is trained for some losses.

    Args:
        losses: Texts that `splatwire.channel.parse_loss` reads, and `first:SHARE` for the most important share of the
            anchors alone; `none` and nothing at all are no losses.
        share: As `LossTraining.share`.

    Raises:
        UnknownNameError: If there is no such loss model.
        InvalidValueError: If one does not make sense.
        DatasetError: If one is a trace that cannot be read.
    """
    models, first = [], []
    for text in losses:
        kind, _, part = text.partition(":")
        if kind == "first":
            first.append(_share(text, part))
        elif not isinstance(parse_loss(text), Nothing):
            models.append(text)
    return LossTraining(tuple(models), tuple(first), share=share)


def _share(text: str, share: str) -> float:
    try:
        value = float(share)
    except ValueError:
        value = math.nan
    if not 0 < value < 1:
        raise InvalidValueError(f"'{text}' should look like first:SHARE, with a share between 0 and 1")
    return value
