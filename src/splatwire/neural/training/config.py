"""Configuration of a training run (HAC++, section on training) in one frozen dataclass."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from splatwire.arguments import check_fields
from splatwire.errors import InvalidValueError, shown
from splatwire.lazy_names import renamed_attributes
from splatwire.types import HacppConfig
from splatwire.types.background import check_background
from splatwire.types.causal_coding import CausalConfig

STORED_NAME = "stored_name"
"""Key, in the metadata of a dataclass field, of the name of the field in checkpoints and in JSON reports."""
FULL_ITERATIONS = 30_000
"""Number of iterations of HAC++'s published schedule; for another number, all phases are scaled."""
MIN_GROWTH_INTERVAL = 50
"""Minimum number of iterations between two additions of anchors in a schedule that is scaled to fewer iterations
(`Milestones.scaled`); an interval that is given explicitly may be shorter.

With fewer iterations, a Gaussian's mean gradient would be estimated from too few views.
"""


def stored_as(name: str) -> Mapping[str, str]:
    """Returns the metadata of a field that has another name in checkpoints and in JSON reports."""
    return {STORED_NAME: name}


@dataclass(frozen=True)
class LearningRate:
    """A learning rate that decreases exponentially during training, from `initial` to `final`.

    Attributes:
        initial: Learning rate in the first iteration.
        final: Learning rate after the last iteration.
        late: Factor on the learning rate after `Milestones.growth_end`.
    """

    initial: float
    final: float
    late: float = 1.0


@dataclass(frozen=True)
class LearningRates:
    """Learning rates by parameter group; the rates of offsets and masks are multiplied by the extent of the cameras.

    Attributes:
        offsets: Offsets.
        mask_logits: Mask logits.
        features: Anchor features.
        log_scalings: Logarithms of the scalings.
        opacity: Opacity network.
        covariance: Covariance network.
        color: Colour network.
        grid: Hash-grid tables.
        prior: Prior network.
        channel: Channel networks.
        causal: Networks of the causal model.
        log_steps: Natural logarithms of the causal model's quantisation steps.
    """

    offsets: LearningRate = LearningRate(0.01, 0.0001)
    mask_logits: LearningRate = LearningRate(0.01, 0.0015)
    features: LearningRate = LearningRate(0.0075, 0.0075)
    log_scalings: LearningRate = LearningRate(0.007, 0.007)
    opacity: LearningRate = LearningRate(0.002, 0.00002)
    covariance: LearningRate = LearningRate(0.004, 0.004)
    color: LearningRate = LearningRate(0.008, 0.00005)
    grid: LearningRate = LearningRate(0.005, 0.00001)
    prior: LearningRate = LearningRate(0.005, 0.00001)
    channel: LearningRate = LearningRate(0.005, 0.0005)
    causal: LearningRate = LearningRate(0.005, 0.0005)
    log_steps: LearningRate = field(default=LearningRate(0.01, 0.002), metadata=stored_as("steps"))


@dataclass(frozen=True)
class Milestones:
    """Schedule of a training: iterations at which its phases start or end.

    Attributes:
        iterations: Total number of iterations.
        noise_start: Start of uniform noise, which simulates the quantisation of attributes with fixed steps.
        growth_pause_end: End of a pause in which no anchors are added or removed; the pause begins at `noise_start`.
        context_start: Start of the context phase, in which the training loss includes the rate. The quantisation steps
            are trained from here on (causal model), or predicted by the context model (HAC++).
        statistics_start: Start of gathering gradients and opacities, which decide where anchors are added and removed.
        growth_start: Start of adding and removing anchors.
        growth_end: End of adding and removing anchors. Later, only anchors without offsets are removed: with packet
            loss, and at the start of the fine-tuning.
        growth_interval: Number of iterations between two changes of the set of anchors.
        fine_tuning_iterations: Number of fine-tuning iterations at the end, on the finished scene
            (`neural.training.fine_tuning_phase`).
    """

    iterations: int = FULL_ITERATIONS
    noise_start: int = 3000
    growth_pause_end: int = 4000
    context_start: int = 10_000
    statistics_start: int = 500
    growth_start: int = 1500
    growth_end: int = 15_000
    growth_interval: int = 100
    fine_tuning_iterations: int = field(default=0, metadata=stored_as("tuning"))

    @property
    def main_iterations(self) -> int:
        """Number of iterations before the fine-tuning; all iterations of the training if there is none."""
        return self.iterations - self.fine_tuning_iterations

    def is_fine_tuning(self, iteration: int) -> bool:
        """True if an iteration belongs to the fine-tuning at the end of the training."""
        return self.main_iterations < iteration <= self.iterations

    def scaled(self, iterations: int) -> "Milestones":
        """Returns the schedule scaled to a training of `iterations` iterations."""
        factor = iterations / self.iterations
        values = {f.name: round(getattr(self, f.name) * factor) for f in dataclasses.fields(self)}
        interval = max(min(MIN_GROWTH_INTERVAL, self.growth_interval), values["growth_interval"])
        return Milestones(**{**values, "iterations": iterations, "growth_interval": interval})


@dataclass(frozen=True)
class GrowthRules:
    """Rules for adding and removing anchors.

    Anchors are added in empty cells of several grids, from coarse to fine.

    Attributes:
        gradient_threshold: An anchor may be added near a Gaussian if the mean length of the gradient of the training
            loss with respect to the Gaussian's 2D centre reaches this threshold. Coordinates of the centre are -1 to 1
            across the image. The threshold doubles from each grid to the next finer one.
        min_views_factor: An anchor is examined for removal once the number of views that have seen it since its last
            examination exceeds `min_views_factor * Milestones.growth_interval`. This may take several intervals.
        min_opacity: An anchor is removed if the sum of the opacities of its Gaussians is below this value, averaged
            over views.
        levels: Maximum number of grids.
        coarsest_cell: Cell size of the coarsest grid, in voxels.
        cell_ratio: Ratio of the cell sizes of consecutive grids.
        max_log_size: Limit of the logarithm of an anchor's base size, world units; applied when the set of anchors
            changes.
        max_anchors: Maximum number of anchors.
        first_pruning: First iteration in which anchors may be removed.
    """

    # Half of `min_views_factor` is the minimum for an offset near which an anchor is added. At each change, a grid cell
    # without an anchor gets at most one; grids with cells below one voxel are skipped. `first_pruning` is the same
    # for any length of the training: random initial points are mostly transparent until the networks are trained.

    gradient_threshold: float = 0.0002
    min_views_factor: float = field(default=0.8, metadata=stored_as("seen_share"))
    min_opacity: float = 0.005
    levels: int = 3
    coarsest_cell: int = 16
    cell_ratio: int = 4
    max_log_size: float = 0.05
    max_anchors: int = 4_000_000
    # On 200x200 views of Lego, 19 of 20 anchors were transparent at iteration 150, and with more points all anchors
    # were removed.
    first_pruning: int = 0


@dataclass(frozen=True)
class LossWeights:
    """Weights of the terms of the training loss.

    Attributes:
        dssim: Weight of 1 - SSIM; the weight of the mean absolute error is 1 - `dssim`.
        volume: Weight of the mean product of the Gaussians' three sizes.
        rate: Lambda, the weight of the rate in the loss. For HAC++, the rate is the number of bits per
            attribute value (F + 6 + 3 K values per anchor, also those of masked offsets). For the causal model, it is
            the size of the scene in megabytes.
        sample_share: Share of the anchors whose rate is estimated in each iteration.
        target_bytes: Target size of the stream in bytes; lambda is controlled to reach it (`neural.training.size`). 0
            keeps lambda constant.
    """

    dssim: float = 0.2
    volume: float = 0.01
    rate: float = 0.004
    sample_share: float = 0.05
    target_bytes: int = field(default=0, metadata=stored_as("size"))

    def __post_init__(self) -> None:
        if self.target_bytes < 0 or (self.target_bytes and not self.rate):
            raise InvalidValueError(f"a size is 1 byte or more and needs a lambda above 0 to be steered by, not {self}")


@dataclass(frozen=True)
class RefineConfig:
    """Settings for refining the context model after training, with fixed anchors.

    The causal model has no hash grid, and its quantisation steps do not change here. The entries of HAC++'s binary hash
    grid are the signs of real numbers, which are trained.

    Attributes:
        steps: Number of Adam steps; 0 disables the refinement.
        batch: Number of anchors per Adam step.
        network_rate: Initial learning rate of the networks.
        grid_rate: HAC++ only: initial learning rate of the hash grid.
        latent: HAC++ only: initial absolute value of the real numbers that are trained in place of the hash grid's
            signs.
        step_weight: HAC++ only: penalty on changes of the quantisation steps, bits. The network predicts each step by
            an output (logit). If the refinement changes this logit by d, `step_weight * d ** 2` bits are added to the
            anchor's cost.
        grid_weight: HAC++ only: weight of each bit of the encoded hash grid in the training loss. Each bit of the
            encoded anchors has weight 1.
        seed: Seed of the random choice of anchors; causal model: also of the noise that replaces rounding.
    """

    # HAC++: network outputs are scaled by the predicted standard deviations, so that one learning rate suits all.
    # Without the penalty `step_weight`, steps would become coarser, which saves bits but changes the scene.
    # `grid_weight` is above 1 because the grid also needs bytes for protection against loss.

    steps: int = 600
    batch: int = 4000
    network_rate: float = 0.005
    grid_rate: float = 0.001
    latent: float = 0.01
    step_weight: float = 30.0
    grid_weight: float = 1.3
    seed: int = 0

    def __post_init__(self) -> None:
        if self.steps < 0 or self.batch < 1:
            raise InvalidValueError(
                f"a refinement has 0 or more steps of 1 anchor or more, not {self.steps} of {self.batch}"
            )


@dataclass(frozen=True)
class PacketLossConfig:
    """Simulated packet loss in training (`neural.training.packet_loss`).

    Each iteration with packet loss uses one of `models` or one of `received_shares`, chosen at random. If both are
    empty, no packet loss is simulated.

    Attributes:
        models: Loss models in the syntax of `splatwire.channel.parse_loss`.
        received_shares: Shares of the anchors, 0 to 1. In an iteration with one of these shares, only this share of the
            anchors is received: the most important ones.
        packetizations: Names of packetizations (`packetization_named`); one of them is chosen at random.
        lossy_share: Share of the iterations with packet loss, after the start of its simulation.
    """

    # Packet loss is simulated after `Milestones.growth_end`; with fine-tuning and without `received_shares`, only in
    # the fine-tuning.

    models: tuple[str, ...] = ()
    received_shares: tuple[float, ...] = field(default=(), metadata=stored_as("first"))
    # The losses of the packetization `paper` are concentrated in some regions. Training with it instead of `spread`
    # makes snowmiku_small 0.2 to 0.4 dB better, with and without loss (two trainings), and lego 0.1 dB worse.
    packetizations: tuple[str, ...] = field(default=("paper", "datagram"), metadata=stored_as("packets"))
    lossy_share: float = field(default=0.5, metadata=stored_as("share"))

    def __post_init__(self) -> None:
        if not 0 <= self.lossy_share <= 1:
            raise InvalidValueError(f"the share of lossy iterations must be from 0 to 1, not {self.lossy_share}")


@dataclass(frozen=True)
class TrainConfig:
    """The complete configuration of a training run.

    Attributes:
        preset: Name of the preset that the configuration is based on.
        model: Shapes of anchors and of the context model; the type of this object selects the context model.
        voxel_size: Spacing of anchor positions in world units; 0 to derive it from the points.
        hidden: Hidden units of the rendering networks, the prior network and the channel networks.
        milestones: Schedule of the training.
        rates: Learning rates by parameter group.
        growth: Rules for adding and removing anchors.
        weights: Weights of the terms of the training loss.
        refine: Settings for the refinement of the context model at the end.
        packet_loss: Settings for simulated packet loss.
        averaging_iterations: Window, in iterations, of the running mean of the parameters at the end of the main phase
            and of the fine-tuning; 0 for no averaging. The mean begins two windows before the end. In its first window
            all iterations have equal weights, afterwards it is exponential (`splatwire.neural.training.averaging`).
        mask_threshold: An offset exists if the sigmoid of its mask logit is above this threshold.
        random_points: Maximum number of random initial points if the data has none.
        background: RGB of the background.
        test_views: Rule that selects the test views; None for the default rule of the dataset's layout.
        seed: Seed of all random numbers, at least 0.

    Raises:
        InvalidValueError: If a value is out of range.
    """

    # The networks of the causal model are as wide as the channel networks. There is at most one random initial point
    # per four pixels of a view, but up to 500 for small views.

    preset: str = "mipnerf360"
    model: HacppConfig | CausalConfig = field(default_factory=HacppConfig)
    voxel_size: float = 0.001
    hidden: tuple[int, int, int] = (50, 100, 40)
    milestones: Milestones = Milestones()
    rates: LearningRates = LearningRates()
    growth: GrowthRules = GrowthRules()
    weights: LossWeights = LossWeights()
    refine: RefineConfig = RefineConfig()
    packet_loss: PacketLossConfig = field(default=PacketLossConfig(), metadata=stored_as("losses"))
    averaging_iterations: int = field(default=100, metadata=stored_as("averaged"))
    mask_threshold: float = 0.01
    random_points: int = 100_000
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    test_views: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        check_background(self.background)
        for name in ("voxel_size", "averaging_iterations", "random_points", "seed"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InvalidValueError(
                    f"{name}: expected a finite number of at least 0, not {shown(getattr(self, name))}"
                )

    __getattr__ = renamed_attributes("TrainConfig", {"losses": "packet_loss", "averaged": "averaging_iterations"})

    @property
    def hacpp(self) -> HacppConfig:
        """Shapes of the HAC++ model; only for configurations with the HAC++ model."""
        assert isinstance(self.model, HacppConfig)
        return self.model

    @property
    def causal(self) -> CausalConfig:
        """Shapes of the causal model; only for configurations with the causal model."""
        assert isinstance(self.model, CausalConfig)
        return self.model
