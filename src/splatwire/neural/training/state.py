"""State of a training as plain tensors, and functions that add and remove anchors."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.neural.training.config import LossWeights
from splatwire.types import GaussianHeads, Linear, Mlp
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin

ANCHOR_PARAMETERS = ("features", "log_scalings", "offsets", "mask_logits")
"""Names of the trained tensors that have one row per anchor."""
HEADS = ("opacity", "covariance", "color")
GRID_PARAMETERS = ("grid.volume", "grid.planes")
CONTEXT_NEGATIVE_SLOPE = 0.01
"""Slope of the activation function (leaky ReLU) of context networks for negative inputs."""
MAX_TRAINED_INDEX = (1 << 20) - 1
"""Maximum absolute voxel index of an anchor, so that three indices fit one 64-bit key."""


@dataclass
class Moments:
    """Moments of the Adam optimiser for one trained tensor.

    Attributes:
        first: Running mean of the gradient.
        second: Running mean of the squared gradient.
        steps: Number of updates.
    """

    first: Tensor
    second: Tensor
    steps: int = 0


@dataclass
class GrowthStatistics:
    """Statistics of anchors and offsets, for deciding which anchors to remove and where to add anchors.

    Attributes:
        opacity_sum: Sum of the opacities of an anchor's Gaussians, over the views that saw the anchor.
        visits: Number of views that saw the anchor.
        gradient_sum: Sum over views of the length of the loss gradient with respect to the 2D centre of an offset's
            Gaussian.
        gradient_count: Number of views that drew the offset's Gaussian.
    """

    opacity_sum: Float[Tensor, "N"]
    visits: Float[Tensor, "N"]
    gradient_sum: Float[Tensor, "N K"]
    gradient_count: Float[Tensor, "N K"]

    @staticmethod
    def zeros(num_anchors: int, num_offsets: int, device: torch.device) -> "GrowthStatistics":
        """Returns the statistics of new anchors: all zero."""
        rows = [torch.zeros(num_anchors, device=device) for _ in range(2)]
        return GrowthStatistics(
            *rows, *(torch.zeros(num_anchors, num_offsets, device=device) for _ in range(2))
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Networks:
    """The networks in training, except those of the causal model.

    Attributes:
        heads: The rendering networks.
        prior: The prior network, from hash-grid feature to distributions and quantisation steps; None with the causal
            model.
        channel: One network per group of feature channels.
    """

    heads: GaussianHeads
    prior: Mlp | None
    channel: tuple[Mlp, ...]

    @property
    def context_prior(self) -> Mlp:
        """The prior network of the HAC++ model."""
        assert self.prior is not None
        return self.prior

    @staticmethod
    def of(parameters: dict[str, Tensor]) -> "Networks":
        """Builds the networks from trained tensors."""

        def mlp(prefix: str, negative_slope: float = 0.0) -> Mlp:
            layers = (f"{prefix}.{layer}" for layer in ("hidden", "output"))
            hidden, output = (Linear(parameters[f"{name}.weight"], parameters[f"{name}.bias"]) for name in layers)
            return Mlp(hidden, output, negative_slope)

        num_groups = len({name.split(".")[1] for name in parameters if name.startswith("channel.")})
        channel = tuple(mlp(f"channel.{group}", CONTEXT_NEGATIVE_SLOPE) for group in range(num_groups))
        prior = mlp("prior") if "prior.hidden.weight" in parameters else None
        return Networks(GaussianHeads(*(mlp(f"heads.{name}") for name in HEADS)), prior, channel)


@dataclass(frozen=True)
class SizeController:
    """State of the size controller, which adapts lambda (the weight of the rate) until the stream has the target size.

    Attributes:
        log_lambda_factor: Natural logarithm of the factor by which lambda is multiplied.
        log_error: Natural logarithm of the ratio of measured size to allowed size (the target size plus the excess that
            is allowed so far) at the last measurement; None before the first measurement.
        ratio: Ratio of encoded size to estimated size at the last encoding; None if sizes are not estimated.
    """

    log_lambda_factor: float = 0.0
    log_error: float | None = None
    ratio: float | None = None


@dataclass
class TrainState:
    """Complete state of a training, sufficient to resume the training.

    Attributes:
        iteration: Number of completed iterations.
        voxels: Anchor positions in voxels.
        voxel_size: World units per voxel.
        parameters: Trained tensors by name; with the causal model also `zero_points`, which are not trained.
        moments: Adam's moments by parameter name; absent for parameters that were never updated.
        statistics: Statistics for adding and removing anchors.
        bounds_min: Lower end of the range by which the context model normalises positions. Unit: voxels with the causal
            model, otherwise world units. Set at the start, and once more when the context phase begins.
        bounds_max: Upper end of the range, in the same unit, set at the same times.
        camera_extent: 1.1 times the largest distance of a training camera from the mean camera centre, world units.
        generator: Source of all random numbers, on the CPU.
        view_queue: Indices of the training views not yet used in the current round over all views.
        origin: World coordinates that the anchors are relative to.
        photo_size: Width and height of the training photos, pixels; None if not known.
        metadata: Metadata of the finished scene that is trained further; empty for a new scene.
        size_controller: State of the size controller.
        parameter_means: Running means of the trained tensors by name; empty until averaging starts.
        networks: The networks made of the tensors of `parameters`.
    """

    # The bounds are the corners of the hash grid's bounding box; with the causal model, the middle of the anchors
    # minus and plus their spread, in voxels. Names of parameters: those of `ANCHOR_PARAMETERS`, `heads.*`,
    # `grid.*`, `prior.*`, `channel.*`; with the causal model, `heads.*`, `causal.*`, `log_steps` and `zero_points`.
    # Zero points are mean natural logarithms of the offset scale and the three sizes, set once (`initialise_causal`).

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
    view_queue: list[int] = field(default_factory=list)
    origin: Origin = NO_ORIGIN
    photo_size: tuple[int, int] | None = None
    metadata: SceneMetadata = NO_METADATA
    size_controller: SizeController = SizeController()
    parameter_means: dict[str, Tensor] = field(default_factory=dict)
    networks: "Networks" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.networks = Networks.of(self.parameters)

    def current_lambda(self, weights: LossWeights) -> float:
        """Returns lambda, the weight of the bit rate in the loss, as currently set by the size controller.

        Args:
            weights: Weights of the terms of the loss, with the initial lambda.
        """
        return weights.rate * math.exp(self.size_controller.log_lambda_factor)

    @property
    def num_anchors(self) -> int:
        """Number of anchors, N."""
        return int(self.voxels.shape[0])

    @property
    def num_elements(self) -> int:
        """Number of anchors, N."""
        return self.num_anchors

    @property
    def positions(self) -> Float[Tensor, "N 3"]:
        """Positions of the anchors relative to the origin, world units."""
        return (self.voxels.double() * self.voxel_size).float()  # as `voxel_positions`, on the device of the voxels

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        return self.voxels.device

    def scalings(self, index: Tensor | slice = slice(None)) -> Float[Tensor, "M 6"]:
        """Returns the scalings of some anchors, world units."""
        # The trained parameters are their logarithms.
        return expanded_scalings(self.parameters["log_scalings"][index].exp())

    def attributes(self, index: Tensor) -> tuple[Float[Tensor, "M F"], Float[Tensor, "M 6"], Float[Tensor, "M O"]]:
        """Returns features, scalings and flattened offsets of some anchors."""
        return self.parameters["features"][index], self.scalings(index), self.parameters["offsets"][index].flatten(1)

    def masks(self, threshold: float) -> Bool[Tensor, "N K"]:
        """Mask of the offsets that exist: the sigmoid of their mask logit is above the threshold."""
        return torch.sigmoid(self.parameters["mask_logits"]) > threshold


def expanded_scalings(scalings: Float[Tensor, "M S"]) -> Float[Tensor, "M 6"]:
    """Expands four scalings per anchor (common offset scale, three sizes) to six.

    Six scalings are returned unchanged.
    """
    if scalings.shape[1] == 6:
        return scalings
    return torch.cat([scalings[:, :1].expand(-1, 3), scalings[:, 1:]], dim=1)


def move_state(state: TrainState, device: torch.device) -> TrainState:
    """Returns the state on a device, without a copy if the state is already there."""
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
        parameter_means={name: value.to(device) for name, value in state.parameter_means.items()},
        statistics=GrowthStatistics(**statistics),
        bounds_min=state.bounds_min.to(device),
        bounds_max=state.bounds_max.to(device),
    )


def group_of(name: str) -> str:
    """Returns the learning-rate group of a parameter (a field of `LearningRates`)."""
    parts = name.split(".")
    return parts[1] if parts[0] == "heads" else parts[0]


def keep_anchors(state: TrainState, keep: Bool[Tensor, "N"] | Int64[Tensor, "M"]) -> None:
    """Keeps only the anchors of a training state that a mask or indices select, in their order; in place."""
    _map_rows(state, lambda _, rows: rows[keep])
    state.voxels = state.voxels[keep]


def append_anchors(state: TrainState, voxels: Int64[Tensor, "M 3"], parameters: dict[str, Tensor]) -> None:
    """Adds new anchors with zero moments and statistics.

    Args:
        state: Changed in place.
        voxels: Positions of the new anchors.
        parameters: Initial values by name: a tensor of M rows for each name in `ANCHOR_PARAMETERS`.
    """

    def extended(name: str | None, rows: Tensor) -> Tensor:
        added = parameters[name].to(rows) if name else rows.new_zeros((len(voxels), *rows.shape[1:]))
        return torch.cat([rows, added])

    _map_rows(state, extended)
    state.voxels = torch.cat([state.voxels, voxels.to(state.voxels)])


def _map_rows(state: TrainState, change: Callable[[str | None, Tensor], Tensor]) -> None:
    """Applies a function in place to every tensor of a training state that has one row per anchor.

    Args:
        state: State of the training, changed in place.
        change: Function that returns the new tensor. Its first argument is the name of a trained tensor, or None for
            Adam's moments and statistics. The second is the tensor.
    """
    for name in state.parameter_means.keys() & set(ANCHOR_PARAMETERS):
        state.parameter_means[name] = change(name, state.parameter_means[name])
    for name in ANCHOR_PARAMETERS:
        rows = change(name, state.parameters[name].detach())
        state.parameters[name] = rows.contiguous().requires_grad_()
        if name in state.moments:
            moments = state.moments[name]
            moments.first, moments.second = change(None, moments.first), change(None, moments.second)
    statistics = state.statistics
    state.statistics = GrowthStatistics(**{name: change(None, rows) for name, rows in vars(statistics).items()})
