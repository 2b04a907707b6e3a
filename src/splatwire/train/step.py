"""One iteration: draw a training view, compare it with its photo, improve everything a little."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.errors import DivergedError
from splatwire.model.gaussian_heads import SpawnedGaussians, spawn_gaussians
from splatwire.model.projection import project
from splatwire.render.base import Drawing
from splatwire.scene import Anchors, Cameras
from splatwire.train.config import TrainConfig
from splatwire.train.context import (
    AnchorCache,
    adaptive_steps,
    add_noise,
    calibrate_prior,
    grid_features,
    sample_rate,
    step_columns,
)
from splatwire.train.grid import sign_bits
from splatwire.train.growth import adjust_anchors, gather_statistics
from splatwire.train.initial import grid_bounds
from splatwire.train.kernels import Kernels, choose_kernels
from splatwire.train.losses import Photo
from splatwire.train.schedule import Phase, changes_anchors, gathers_statistics, learning_rates, phase_of
from splatwire.train.state import Moments, TrainState, group_of, heads_of, network


@dataclass(frozen=True)
class StepReport:
    """What an iteration found.

    Attributes:
        loss: The whole loss.
        l1: Mean absolute error of the picture.
        bits_per_anchor: Estimated bits of an anchor's features, scalings and offsets; None before the context phase.
        num_gaussians: Gaussians drawn.
    """

    loss: float
    l1: float
    bits_per_anchor: float | None
    num_gaussians: int


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A picture and what it came from."""

    drawing: Drawing
    spawned: SpawnedGaussians
    visible: Int64[Tensor, "M"]


def train_step(
    state: TrainState,
    config: TrainConfig,
    cameras: Cameras,
    view: int,
    photo: Photo,
    cache: AnchorCache,
    kernels: Kernels | None = None,
) -> StepReport:
    """Does one iteration in place, on the device of the state.

    Args:
        state: The state.
        config: The recipe.
        cameras: The training cameras.
        view: The view to learn from.
        photo: Its photo.
        cache: A cache that belongs to this run.
        kernels: What does the heavy parts; chosen by the device of the state if absent.

    Raises:
        BackendUnavailableError: If nothing can draw on that device here.
        DivergedError: If the loss is not finite.
    """
    kernels = kernels or choose_kernels(state.device)
    state.iteration += 1
    phase = phase_of(config.marks, state.iteration)
    if state.iteration == config.marks.context_start + 1:
        state.bounds_min, state.bounds_max = grid_bounds(cache.positions(state))
        calibrate_prior(state, config)
    watching = gathers_statistics(config.marks, state.iteration)
    sample = _draw_sample(state, config) if phase is Phase.CONTEXT else None
    drawn, rate, num_sampled = _forward(state, config, cameras, view, cache, sample, phase, watching, kernels)
    loss, l1 = kernels.photometric_loss(drawn.drawing.image, photo, config.weights.dssim)
    scales = drawn.spawned.gaussians.scales
    if len(scales):
        loss = loss + config.weights.volume * scales.prod(dim=1).mean()
    if rate is not None:
        loss = loss + config.weights.rate * _bits_per_parameter(state, config, rate, num_sampled)
    value = float(loss.detach())
    if value != value or abs(value) == float("inf"):
        raise DivergedError(state.iteration)
    if loss.requires_grad:
        loss.backward()
    if watching and (d_centers := drawn.drawing.d_centers) is not None:
        spawned = drawn.spawned
        place = (spawned.gaussians, drawn.visible[spawned.anchor_index], spawned.offset_index)
        gather_statistics(state, drawn.visible, place, d_centers, cameras, view)
    if changes_anchors(config.marks, state.iteration):
        adjust_anchors(state, config)
    _update(state, config, kernels)
    bits_per_anchor = float(rate.detach()) / max(num_sampled, 1) if rate is not None else None
    return StepReport(value, float(l1), bits_per_anchor, len(scales))


def _draw_sample(state: TrainState, config: TrainConfig) -> Int64[Tensor, "S"]:
    luck = torch.rand(state.num_anchors, generator=state.generator)
    chosen = (luck <= config.weights.sample_share).nonzero()[:, 0]
    return chosen.to(state.device)


def _forward(
    state: TrainState,
    config: TrainConfig,
    cameras: Cameras,
    view: int,
    cache: AnchorCache,
    sample: Int64[Tensor, "S"] | None,
    phase: Phase,
    watching: bool,
    kernels: Kernels,
) -> tuple[_Drawn, Tensor | None, int]:
    """Draws the view with the noise of the phase; returns it, the bits of the sample, and its size."""
    parameters, positions = state.parameters, cache.positions(state)
    with torch.no_grad():
        sizes = parameters["log_scalings"][:, :3].exp()
        projected = project(positions, sizes, None, cameras, view)
        visible = projected.touches_image(cameras.width, cameras.height).nonzero()[:, 0]
    steps: tuple[Tensor, ...] | tuple[float, ...] | None = None
    rate = None
    if phase is Phase.NOISE:
        steps = config.model.base_steps
    elif sample is not None:
        features = grid_features(state, cache, torch.cat([visible, sample]), kernels)
        logits = step_columns(network(parameters, "prior"))(features[: len(visible)])
        steps = adaptive_steps(logits, config.model).split(1, dim=1)
        masks = _masks(state, config, sample)
        rate = sample_rate(state, config, features[len(visible) :], sample, masks, kernels.uniform).bits
    drawn = _draw(state, config, cameras, view, positions, visible, steps, watching, kernels)
    return drawn, rate, 0 if sample is None else len(sample)


def _draw(
    state: TrainState,
    config: TrainConfig,
    cameras: Cameras,
    view: int,
    positions: Float[Tensor, "N 3"],
    visible: Int64[Tensor, "M"],
    steps: tuple[Tensor, ...] | tuple[float, ...] | None,
    watching: bool,
    kernels: Kernels,
) -> _Drawn:
    parameters = state.parameters
    features = parameters["features"][visible]
    scalings = parameters["log_scalings"][visible].exp()
    offsets = parameters["offsets"][visible].flatten(1)
    if steps is not None:
        features = add_noise(features, steps[0], state.generator, kernels.uniform)
        scalings = add_noise(scalings, steps[1], state.generator, kernels.uniform)
        offsets = add_noise(offsets, steps[2], state.generator, kernels.uniform)
    weight, _ = _masks(state, config, visible)
    exists = weight.detach() > 0.5
    offsets = offsets.view(-1, config.model.layout.num_offsets, 3)
    anchors = Anchors(positions[visible], features, scalings, offsets, exists)
    everything = torch.ones(len(visible), dtype=torch.bool, device=visible.device)
    center = cameras.centers[view].to(positions)
    spawned = spawn_gaussians(anchors, heads_of(parameters), center, everything, mask_weight=weight)
    background = positions.new_tensor(config.background)
    drawing = kernels.draw(spawned.gaussians, cameras.select([view]), background=background, watched=watching)
    return _Drawn(drawing, spawned, visible)


def _masks(
    state: TrainState, config: TrainConfig, index: Int64[Tensor, "M"]
) -> tuple[Float[Tensor, "M K"], Float[Tensor, "M"]]:
    """Masks of offsets and of anchors, 0 or 1, with the gradient of the sigmoid and of its mean (HACPP_SPEC 2)."""
    share = torch.sigmoid(state.parameters["mask_logits"][index])
    hard = (share > config.mask_threshold).to(share)
    offsets = share + (hard - share).detach()
    mean, any_hard = share.mean(dim=1), hard.amax(dim=1)
    return offsets, mean + (any_hard - mean).detach()


def _bits_per_parameter(
    state: TrainState, config: TrainConfig, sample_bits: Float[Tensor, ""], num_sampled: int
) -> Float[Tensor, ""]:
    layout = config.model.layout
    per_anchor = layout.feature_dim + 6 + 3 * layout.num_offsets
    grid = sign_bits(state.parameters["grid.volume"], state.parameters["grid.planes"])
    return sample_bits / max(num_sampled * per_anchor, 1) + grid / (state.num_anchors * per_anchor)


def _update(state: TrainState, config: TrainConfig, kernels: Kernels) -> None:
    """Applies Adam to every parameter that has a gradient; new anchors wait for the next iteration."""
    rates = learning_rates(config, state.iteration, state.camera_extent)
    for name, parameter in state.parameters.items():
        if parameter.grad is None:
            continue
        if name not in state.moments:
            state.moments[name] = Moments(torch.zeros_like(parameter), torch.zeros_like(parameter))
        kernels.adam_update(parameter, parameter.grad, state.moments[name], rates[group_of(name)])
        parameter.grad = None
