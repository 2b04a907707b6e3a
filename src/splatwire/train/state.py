"""The state of a run: plain tensors, and the one place where rows of anchors are added and removed."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.model import GaussianHeads, Linear, Mlp
from splatwire.train.config import LossWeights

ANCHOR_PARAMETERS = ("features", "log_scalings", "offsets", "mask_logits")
"""Parameters with one row per anchor."""
HEADS = ("opacity", "covariance", "color")
GRID_PARAMETERS = ("grid.volume", "grid.planes")
CHANNEL_SLOPE = 0.01
MAX_TRAINED_INDEX = (1 << 20) - 1
"""Anchors lie within this many voxels of the origin, so that three indices make one 64-bit number."""


@dataclass
class Moments:
    """What Adam remembers of one parameter.

    Attributes:
        first: Running mean of the gradient.
        second: Running mean of its square.
        steps: Updates so far.
    """

    first: Tensor
    second: Tensor
    steps: int = 0


@dataclass
class GrowthStatistics:
    """What has been seen of each anchor and offset since it was last judged.

    Attributes:
        opacity_sum: Sum of the opacities of an anchor's Gaussians, over the views that saw it.
        visits: Views that saw the anchor.
        gradient_sum: Sum of the lengths of the gradient of an offset's 2D centre.
        gradient_count: Views that drew the offset's Gaussian.
    """

    opacity_sum: Float[Tensor, "N"]
    visits: Float[Tensor, "N"]
    gradient_sum: Float[Tensor, "N K"]
    gradient_count: Float[Tensor, "N K"]

    @staticmethod
    def zeros(num_anchors: int, num_offsets: int, device: torch.device) -> "GrowthStatistics":
        """Returns the statistics of anchors that nobody has looked at."""
        rows = [torch.zeros(num_anchors, device=device) for _ in range(2)]
        return GrowthStatistics(
            *rows, *(torch.zeros(num_anchors, num_offsets, device=device) for _ in range(2))
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Networks:
    """The networks in training.

    Attributes:
        heads: Those that draw.
        prior: Hash-grid feature to distributions and steps; None in the causal model, which has networks of its own.
        channel: One for each group of feature channels.
    """

    heads: GaussianHeads
    prior: Mlp | None
    channel: tuple[Mlp, ...]

    @property
    def context_prior(self) -> Mlp:
        """The prior network; only in a state that has one."""
        assert self.prior is not None
        return self.prior

    @staticmethod
    def of(parameters: dict[str, Tensor]) -> "Networks":
        """Returns the networks over tensors called `heads.*`, `prior.*` and `channel.*`."""

        def mlp(prefix: str, negative_slope: float = 0.0) -> Mlp:
            layers = (f"{prefix}.{layer}" for layer in ("hidden", "output"))
            hidden, output = (Linear(parameters[f"{name}.weight"], parameters[f"{name}.bias"]) for name in layers)
            return Mlp(hidden, output, negative_slope)

        num_groups = len({name.split(".")[1] for name in parameters if name.startswith("channel.")})
        channel = tuple(mlp(f"channel.{group}", CHANNEL_SLOPE) for group in range(num_groups))
        prior = mlp("prior") if "prior.hidden.weight" in parameters else None
        return Networks(GaussianHeads(*(mlp(f"heads.{name}") for name in HEADS)), prior, channel)


@dataclass(frozen=True)
class Steering:
    """How lambda is steered to a size (`splatwire.train.size`).

    Attributes:
        log_rate: Logarithm of what lambda is multiplied with.
        miss: Logarithm of the size over the wanted one when it was measured last; None before.
        ratio: Bytes of the last real stream over those estimated for it; None where sizes are not estimated.
    """

    log_rate: float = 0.0
    miss: float | None = None
    ratio: float | None = None


@dataclass
class TrainState:
    """Everything that a run needs to go on, and nothing else.

    Attributes:
        iteration: Iterations done.
        voxels: Anchor positions in voxels.
        voxel_size: World units per voxel.
        parameters: Trained tensors by name: those of `ANCHOR_PARAMETERS`, `heads.*`, `grid.*`, `prior.*`,
            `channel.*`.
        moments: Adam's memory, same names; a parameter that has never been updated has none.
        statistics: For growing and pruning.
        bounds_min: Lower corner of the hash grid's box; with the causal model, the middle of the anchors less their
            spread, in voxels.
        bounds_max: Upper corner; the middle plus the spread.
        camera_extent: See `splatwire.train.schedule.learning_rates`.
        generator: Source of everything random, on the CPU.
        queue: Training views still to be shown before all have been.
        steering: How lambda is steered, if it is.
        means: Running means of the parameters, same names, once they are taken (`splatwire.train.averaging`).
        networks: The networks over the tensors of `parameters`, which training changes in place.
    """

    iteration: int
    voxels: Int64[Tensor, "N 3"]
    voxel_size: float
    parameters: dict[str, Tensor]
    moments: dict[str, Moments]
    statistics: GrowthStatistics
    bounds_min: Float[Tensor, "3"]
    bounds_max: Float[Tensor, "3"]
    camera_extent: float
    generator: torch.Generator
    queue: list[int] = field(default_factory=list)
    steering: Steering = Steering()
    means: dict[str, Tensor] = field(default_factory=dict)
    networks: "Networks" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.networks = Networks.of(self.parameters)

    def rate(self, weights: LossWeights) -> float:
        """Lambda as it is now."""
        return weights.rate * math.exp(self.steering.log_rate)

    @property
    def num_anchors(self) -> int:
        """Number of anchors, N."""
        return int(self.voxels.shape[0])

    @property
    def positions(self) -> Float[Tensor, "N 3"]:
        """World coordinates of the anchors."""
        return (self.voxels.double() * self.voxel_size).float()  # as `voxel_positions`, on the device of the voxels

    @property
    def device(self) -> torch.device:
        """Where the tensors are."""
        return self.voxels.device

    def scalings(self, index: Tensor | slice = slice(None)) -> Float[Tensor, "M 6"]:
        """Scalings of some anchors, world units; their logarithms are what is learnt."""
        return expanded_scalings(self.parameters["log_scalings"][index].exp())

    def attributes(self, index: Tensor) -> tuple[Float[Tensor, "M F"], Float[Tensor, "M 6"], Float[Tensor, "M O"]]:
        """Features, scalings and flat offsets of some anchors, as they are coded."""
        return self.parameters["features"][index], self.scalings(index), self.parameters["offsets"][index].flatten(1)

    def masks(self, threshold: float) -> Bool[Tensor, "N K"]:
        """Which offsets exist: those whose mask's sigmoid is above the threshold."""
        return torch.sigmoid(self.parameters["mask_logits"]) > threshold


def expanded_scalings(scalings: Float[Tensor, "M S"]) -> Float[Tensor, "M 6"]:
    """Returns six scalings for each anchor: four are one scale for all axes of the offsets, and three base sizes."""
    if scalings.shape[1] == 6:
        return scalings
    return torch.cat([scalings[:, :1].expand(-1, 3), scalings[:, 1:]], dim=1)


def move_state(state: TrainState, device: torch.device) -> TrainState:
    """Returns the state on a device: itself where it is there already, otherwise a copy. The generator stays."""
    if state.device == device:
        return state
    statistics = {name: rows.to(device) for name, rows in vars(state.statistics).items()}
    return replace(
        state,
        voxels=state.voxels.to(device),
        parameters={name: value.detach().to(device).requires_grad_() for name, value in state.parameters.items()},
        moments={
            name: Moments(moments.first.to(device), moments.second.to(device), moments.steps)
            for name, moments in state.moments.items()
        },
        means={name: value.to(device) for name, value in state.means.items()},
        statistics=GrowthStatistics(**statistics),
        bounds_min=state.bounds_min.to(device),
        bounds_max=state.bounds_max.to(device),
    )


def group_of(name: str) -> str:
    """Returns the learning-rate group of a parameter (a field of `LearningRates`)."""
    parts = name.split(".")
    return parts[1] if parts[0] == "heads" else parts[0]


def keep_anchors(state: TrainState, keep: Bool[Tensor, "N"] | Int64[Tensor, "M"]) -> None:
    """Removes the anchors where `keep` is False, or all but those it lists, from everything with a row per anchor."""
    _map_rows(state, lambda _, rows: rows[keep])
    state.voxels = state.voxels[keep]


def append_anchors(state: TrainState, voxels: Int64[Tensor, "M 3"], parameters: dict[str, Tensor]) -> None:
    """Adds anchors that nobody has looked at yet: their moments and statistics are zero.

    Args:
        state: Changed in place.
        voxels: Positions of the new anchors.
        parameters: One tensor of M rows for each name in `ANCHOR_PARAMETERS`.
    """

    def extended(name: str | None, rows: Tensor) -> Tensor:
        added = parameters[name].to(rows) if name else rows.new_zeros((len(voxels), *rows.shape[1:]))
        return torch.cat([rows, added])

    _map_rows(state, extended)
    state.voxels = torch.cat([state.voxels, voxels.to(state.voxels)])


def _map_rows(state: TrainState, change: Callable[[str | None, Tensor], Tensor]) -> None:
    """Replaces every tensor with a row per anchor by `change(name, tensor)`; name is None where it is no parameter."""
    for name in state.means.keys() & set(ANCHOR_PARAMETERS):
        state.means[name] = change(name, state.means[name])
    for name in ANCHOR_PARAMETERS:
        rows = change(name, state.parameters[name].detach())
        state.parameters[name] = rows.contiguous().requires_grad_()
        if name in state.moments:
            moments = state.moments[name]
            moments.first, moments.second = change(None, moments.first), change(None, moments.second)
    statistics = state.statistics
    state.statistics = GrowthStatistics(**{name: change(None, rows) for name, rows in vars(statistics).items()})
