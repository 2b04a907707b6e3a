"""Configuration of a training of explicit Gaussians."""

import math
from dataclasses import dataclass, field

from splatwire.arguments import check_fields
from splatwire.channel import parse_loss
from splatwire.codec.gaussians.quality import QUALITIES, Quality
from splatwire.errors import InvalidValueError
from splatwire.neural.training.config import FULL_ITERATIONS, LearningRate, stored_as
from splatwire.ops.spherical_harmonics import MAX_DEGREE
from splatwire.types.background import check_background

MIN_ITERATIONS = 20
MAX_GAUSSIANS = 4_000_000
"""Maximum number of Gaussians in a training, the same as for anchors."""
FINE_TUNING_SHARE, MAX_FINE_TUNING_ITERATIONS = 0.25, 2000
"""Iterations of the fine-tuning with the codec's rounding: share of all iterations, and their maximum number."""

MAX_RATE_FACTOR = 5.0
"""Maximum factor on the initial learning rates of short trainings."""


@dataclass(frozen=True)
class GaussianRates:
    """Learning rates by parameter; the rate of the centres is multiplied by the extent of the cameras.

    Attributes:
        means: Centres.
        log_scales: Logarithms of the standard deviations.
        quats: Quaternions.
        logits: Logits of the opacities.
        base: Harmonics of degree 0.
        harmonics: Harmonics above degree 0.
    """

    # The initial rates are those of 3DGS for 30,000 iterations. The final rates are lower than the initial ones,
    # except those of the harmonics above degree 0.

    means: LearningRate = LearningRate(1.6e-4, 1.6e-6)  # noqa: RUF009 - frozen
    log_scales: LearningRate = LearningRate(0.005, 0.002)  # noqa: RUF009 - frozen
    quats: LearningRate = LearningRate(0.001, 0.0005)  # noqa: RUF009 - frozen
    logits: LearningRate = LearningRate(0.05, 0.01)  # noqa: RUF009 - frozen
    base: LearningRate = LearningRate(0.0025, 0.001)  # noqa: RUF009 - frozen
    harmonics: LearningRate = LearningRate(0.000125, 0.000125)  # noqa: RUF009 - frozen

    def for_length(self, iterations: int) -> "GaussianRates":
        """Returns learning rates adapted to the length of a training.

        A shorter training starts with higher rates for all parameters except the opacities. The final rate is higher
        only for the centres.

        Args:
            iterations: Number of iterations of the training.
        """
        # On snowmiku_small, 500 iterations with 3 to 5 times the rates reach 25.3 dB on test views; 400 with the
        # published rates reach 18.8 dB.
        factor = min(math.sqrt(max(FULL_ITERATIONS / iterations, 1)), MAX_RATE_FACTOR)
        faster = {name: LearningRate(rate.initial * factor, rate.final) for name, rate in vars(self).items()}
        means = LearningRate(self.means.initial * factor, self.means.final * factor)
        return GaussianRates(**{**faster, "means": means, "logits": self.logits})


@dataclass(frozen=True)
class RelocationRules:
    """Rules for moving, adding and disturbing Gaussians (3DGS-MCMC).

    Gaussians are moved and added at regular intervals, between the times `start` and `end`. A time is given as a share
    of the iterations of the training.

    Attributes:
        start: First time at which Gaussians are moved and added.
        growth_end: Latest time at which the number of Gaussians reaches the budget.
        end: Last time at which Gaussians are moved and added.
        interval: Number of iterations between two changes of the set of Gaussians.
        min_changes: Minimum number of changes in a training; a short training has shorter intervals.
        growth: Relative increase of the number of Gaussians per change.
        dead_opacity: Gaussians with at most this opacity are moved.
        noise: Strength of the random displacements of the centres in the first iteration.
    """

    # `growth` is larger if the budget would otherwise not be reached.

    # The standard deviation of a displacement along an axis is `noise` times the variance of the Gaussian, divided
    # by the extent of the cameras. It decreases with the learning rate of the centres.

    start: float = 0.02
    growth_end: float = 0.5
    end: float = 0.85
    interval: int = 100
    min_changes: int = field(default=60, metadata=stored_as("changes"))
    growth: float = 0.05
    dead_opacity: float = 0.005
    noise: float = 80.0


@dataclass(frozen=True)
class GaussianConfig:
    """The complete configuration of a training of explicit Gaussians.

    Attributes:
        preset: Name of the preset that `test_views` was taken from, for information.
        gaussians: Budget: number of Gaussians of the trained scene, at least 1.
        degree: Degree of the spherical harmonics, 0 to 3.
        iterations: Number of iterations before the fine-tuning, at least `MIN_ITERATIONS`.
        fine_tuning_iterations: Number of iterations of the fine-tuning, in which the codec's rounding is simulated; 0
            for none.
        quality: Quality setting of the codec for the fine-tuning.
        packet_loss: Model of packet losses that the fine-tuning simulates, in the syntax of
            `splatwire.channel.parse_loss`; None for none.
        dssim: Weight of 1 - SSIM in the training loss; the weight of the mean absolute error is 1 - `dssim`.
        opacity_weight: Weight of the mean opacity in the loss.
        scale_weight: Weight of the mean standard deviation in the loss, relative to the extent of the cameras.
        dropout: Share of the Gaussians that are left out at random in each iteration, at least 0 and below 1.
        degree_starts: For harmonics of degree 1, 2 and 3, share of the iterations after which their training starts.
        rates: Learning rates.
        relocation: Rules for moving and adding Gaussians.
        background: RGB of the background.
        test_views: Rule that selects the test views; None for the default rule of the dataset's layout.
        seed: Seed of all random numbers, at least 0.

    Raises:
        InvalidValueError: If a value is out of range.
    """

    # With dropout, Gaussians fit single photos less closely, and views between the photos better.

    preset: str = "mipnerf360"
    gaussians: int = 100_000
    degree: int = MAX_DEGREE
    iterations: int = 2400
    fine_tuning_iterations: int = field(default=600, metadata=stored_as("tuning"))
    quality: Quality = QUALITIES["default"]
    packet_loss: str | None = field(default=None, metadata=stored_as("loss"))
    dssim: float = 0.2
    opacity_weight: float = 0.01
    scale_weight: float = 0.05
    dropout: float = 0.15
    degree_starts: tuple[float, float, float] = field(default=(0.1, 0.2, 0.3), metadata=stored_as("degree_steps"))
    rates: GaussianRates = field(default_factory=GaussianRates)
    relocation: RelocationRules = RelocationRules()
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    test_views: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        check_background(self.background)
        if not 1 <= self.gaussians <= MAX_GAUSSIANS:
            raise InvalidValueError(f"a training takes 1 to {MAX_GAUSSIANS:,} Gaussians, not {self.gaussians:,}")
        if not 0 <= self.degree <= MAX_DEGREE:
            raise InvalidValueError(f"spherical harmonics have degree 0 to {MAX_DEGREE}, not {self.degree}")
        if self.iterations < MIN_ITERATIONS or self.fine_tuning_iterations < 0:
            raise InvalidValueError(f"a training takes {MIN_ITERATIONS} iterations or more, not {self.iterations}")
        if self.seed < 0:
            raise InvalidValueError(f"a seed is 0 or more, not {self.seed}")
        if not 0 <= self.dropout < 1:
            raise InvalidValueError(f"a share of Gaussians to leave out is 0 or more and below 1, not {self.dropout:g}")
        if self.packet_loss is not None:
            parse_loss(self.packet_loss)
            if not self.fine_tuning_iterations:
                raise InvalidValueError("losses are simulated in the fine-tuning, which has no iterations here")

    def degree_at(self, iteration: int) -> int:
        """Returns the highest degree of the harmonics that are trained in an iteration."""
        reached = sum(iteration > share * self.iterations for share in self.degree_starts)
        return min(reached, self.degree)

    @property
    def change_interval(self) -> int:
        """Number of iterations between two changes of the set of Gaussians."""
        rules = self.relocation
        return min(rules.interval, max(self.iterations // rules.min_changes, 1))

    def relocates(self, iteration: int) -> bool:
        """True if Gaussians are moved and added after an iteration."""
        rules, share = self.relocation, iteration / self.iterations
        return rules.start <= share <= rules.end and iteration % self.change_interval == 0

    def target_count(self, iteration: int, count: int) -> int:
        """Returns the number of Gaussians that the scene should have after Gaussians are added in an iteration.

        Args:
            iteration: The iteration, the first is 1.
            count: Number of Gaussians before, at least 1.
        """
        num_changes = max(int(self.relocation.growth_end * self.iterations - iteration) // self.change_interval, 0) + 1
        factor = max((self.gaussians / count) ** (1 / num_changes), 1 + self.relocation.growth)
        return max(min(self.gaussians, math.ceil(count * factor)), count)


def fine_tuning_iterations_for(iterations: int) -> int:
    """Returns the default number of fine-tuning iterations after a training of `iterations` iterations."""
    return min(math.ceil(FINE_TUNING_SHARE * iterations), MAX_FINE_TUNING_ITERATIONS)
