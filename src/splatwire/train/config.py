"""Every constant of a training run, in one frozen record (HAC++, training)."""

import dataclasses
from dataclasses import dataclass, field

from splatwire.errors import InvalidValueError
from splatwire.model import ModelConfig
from splatwire.model.causal import CausalConfig

FULL_ITERATIONS = 30_000
"""The published schedule; a shorter or longer one scales every mark."""
MIN_GROWTH_INTERVAL = 50
"""Growing more often than this sees too few views to tell which Gaussians are pulled."""


@dataclass(frozen=True)
class LearningRate:
    """A learning rate that goes from `initial` to `final` along a straight line in the logarithm.

    Attributes:
        initial: At the start.
        final: After the last iteration.
        late: What it is multiplied with once the number of anchors stays.
    """

    initial: float
    final: float
    late: float = 1.0


@dataclass(frozen=True)
class LearningRates:
    """Learning rates by group of parameters; those of offsets and masks are multiplied by the extent of the cameras.

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
        steps: Logarithms of its quantisation steps.
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
    steps: LearningRate = LearningRate(0.01, 0.002)


@dataclass(frozen=True)
class Marks:
    """When what happens, in iterations; each thing starts after the iteration of its mark.

    Attributes:
        iterations: Length of the run.
        noise_start: Uniform noise with fixed steps is added to the attributes.
        growth_pause_end: Nothing grows from `noise_start` to this iteration.
        context_start: The hash grid sets the steps, and the rate enters the loss.
        statistics_start: Gradients and opacities are gathered.
        growth_start: Anchors are added and removed.
        growth_end: The number of anchors stays.
        growth_interval: Iterations between two changes of the anchors.
        tuning: Iterations at the end in which the scene, finished by then, goes on (`splatwire.train.tuning`).
    """

    iterations: int = FULL_ITERATIONS
    noise_start: int = 3000
    growth_pause_end: int = 4000
    context_start: int = 10_000
    statistics_start: int = 500
    growth_start: int = 1500
    growth_end: int = 15_000
    growth_interval: int = 100
    tuning: int = 0

    @property
    def settled(self) -> int:
        """The iteration after which the scene is finished, and goes on."""
        return self.iterations - self.tuning

    def goes_on(self, iteration: int) -> bool:
        """Whether it is one of those in which the finished scene goes on."""
        return self.settled < iteration <= self.iterations

    def scaled(self, iterations: int) -> "Marks":
        """Returns the same phases, in proportion, for a run of `iterations`."""
        factor = iterations / self.iterations
        values = {f.name: round(getattr(self, f.name) * factor) for f in dataclasses.fields(self)}
        interval = max(min(MIN_GROWTH_INTERVAL, self.growth_interval), values["growth_interval"])
        return Marks(**{**values, "iterations": iterations, "growth_interval": interval})


@dataclass(frozen=True)
class GrowthRules:
    """Which anchors are added and removed.

    Attributes:
        gradient_threshold: Mean length of the gradient of a Gaussian's 2D centre, per half image size, from which on
            an anchor is added near it; doubled from each level to the next.
        seen_share: Share of the interval in which an anchor must have been visible to be judged (half of it for an
            offset).
        min_opacity: Anchors whose offsets' opacities add up to less, on average, are removed.
        levels: Cell sizes that are tried.
        coarsest_cell: Cell size of the first level, in voxels.
        cell_ratio: Each next cell is this many times smaller; a level whose cell is under a voxel is left out.
        max_log_size: Cap on the logarithm of an anchor's base size, world units.
        max_anchors: No anchor is added beyond this number.
        first_pruning: Nothing is removed before this iteration, however short the run. Points drawn at random start as
            a fog that the networks must learn to light: on 200x200 views of Lego, iteration 150 still had 19 of 20
            anchors transparent, and a denser fog lost all of them.
    """

    gradient_threshold: float = 0.0002
    seen_share: float = 0.8
    min_opacity: float = 0.005
    levels: int = 3
    coarsest_cell: int = 16
    cell_ratio: int = 4
    max_log_size: float = 0.05
    max_anchors: int = 4_000_000
    first_pruning: int = 0


@dataclass(frozen=True)
class LossWeights:
    """Weights of the terms of the loss.

    Attributes:
        dssim: Share of 1 - SSIM; the rest is the mean absolute error.
        volume: Of the mean product of the Gaussians' three sizes.
        rate: Lambda: of the bits per parameter, or of the megabytes of a scene with the causal model.
        sample_share: Share of the anchors whose rate is estimated in each iteration.
        size: Bytes that the stream is to have; lambda is steered there (`splatwire.train.size`). 0: lambda stays.
    """

    dssim: float = 0.2
    volume: float = 0.01
    rate: float = 0.004
    sample_share: float = 0.05
    size: int = 0

    def __post_init__(self) -> None:
        if self.size < 0 or (self.size and not self.rate):
            raise InvalidValueError(f"a size is 1 byte or more and needs a lambda above 0 to be steered by, not {self}")


@dataclass(frozen=True)
class RefineConfig:
    """How the context model is fitted again once the attributes stand still (`splatwire.train.refine`).

    Attributes:
        steps: Steps of Adam; 0 leaves the context model as it is.
        batch: Anchors of a step.
        network_rate: Learning rate of the networks at the start; outputs are in units of the spread that they predict.
        grid_rate: Learning rate of the numbers behind the grid's signs at the start.
        latent: Magnitude that these numbers start with.
        step_weight: Bits that a squared change of a quantisation step's logit counts as: coarser steps would save bits,
            but change the scene.
        grid_weight: What a bit of the grid counts as: side information has to be protected.
        seed: Of the choice of anchors.
    """

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
class LossTraining:
    """Packets that are lost in training, so that the scene learns to do without any of them (`train.packet_loss`).

    Attributes:
        models: Loss models as `splatwire.channel.parse_loss` reads them; a lossy iteration draws one. None: no losses.
        first: Shares of the anchors, most important first, of which nothing else arrives: what a receiver has of tiers
            that it gets one after another. A lossy iteration draws one of these or of the models.
        packets: Packetizations, as `packetization_named` knows them; a lossy iteration draws one. With the paper's some
            places lose nothing and others much: snowmiku_small comes out 0.2 to 0.4 dB better than with `spread`, with
            and without loss (two trainings), lego 0.1 dB worse.
        share: Share of the iterations that are lossy, once the scene goes on (or the number of anchors stays).
    """

    models: tuple[str, ...] = ()
    first: tuple[float, ...] = ()
    packets: tuple[str, ...] = ("paper", "datagram")
    share: float = 0.5

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise InvalidValueError(f"the share of lossy iterations must be from 0 to 1, not {self.share}")


@dataclass(frozen=True)
class TrainConfig:
    """A whole recipe.

    Attributes:
        preset: What it was derived from.
        model: Shapes of anchors and context model, which also says what a scene will be coded with.
        voxel_size: Spacing of anchor positions in world units; 0 to derive it from the points.
        hidden: Hidden units of the rendering networks, the prior network and the channel networks; those of the causal
            model are as wide as the last ones.
        marks: When what happens.
        rates: Learning rates.
        growth: Which anchors are added and removed.
        weights: Weights of the loss.
        refine: What is done to the context model at the end.
        losses: Packets that are lost in training.
        averaged: Iterations whose mean a run leaves (`splatwire.train.averaging`); 0 for the last one alone.
        mask_threshold: A mask is 1 where the sigmoid of its logit is above this.
        random_points: Points drawn in a box when the data has none, at most one for every four pixels of a view.
        background: RGB behind the scene.
        test_views: Which views are left out for testing.
        seed: Of everything random.
    """

    preset: str = "mipnerf360"
    model: ModelConfig | CausalConfig = field(default_factory=ModelConfig)
    voxel_size: float = 0.001
    hidden: tuple[int, int, int] = (50, 100, 40)
    marks: Marks = Marks()
    rates: LearningRates = LearningRates()
    growth: GrowthRules = GrowthRules()
    weights: LossWeights = LossWeights()
    refine: RefineConfig = RefineConfig()
    losses: LossTraining = LossTraining()
    averaged: int = 100
    mask_threshold: float = 0.01
    random_points: int = 100_000
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    test_views: str = "every_8th"
    seed: int = 0

    @property
    def hacpp(self) -> ModelConfig:
        """The model of HAC++; only for a recipe that has it."""
        assert isinstance(self.model, ModelConfig)
        return self.model

    @property
    def causal(self) -> CausalConfig:
        """The causal model; only for a recipe that has it."""
        assert isinstance(self.model, CausalConfig)
        return self.model
