"""One iteration: draw a training view, compare it with its photo, improve everything a little."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.errors import DivergedError
from splatwire.model.gaussian_heads import SpawnedGaussians, spawn_gaussians
from splatwire.model.projection import project
from splatwire.render.base import Drawing
from splatwire.scene import Anchors, Cameras, Gaussians
from splatwire.train.averaging import gather_mean
from splatwire.train.config import TrainConfig
from splatwire.train.context import AnchorCache, Attributes, SampleRate
from splatwire.train.growth import adjust_anchors, gather_statistics
from splatwire.train.kernels import COMPILED, Kernels
from splatwire.train.losses import Photo
from splatwire.train.models import trained_model
from splatwire.train.packet_loss import PacketLosses
from splatwire.train.schedule import changes_anchors, gathers_statistics, learning_rates
from splatwire.train.state import Moments, TrainState, group_of
from splatwire.train.tuning import settle


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


class TrainingStep:
    """Does an iteration on a state, in place.

    Args:
        config: The recipe.
        cameras: The training cameras, where the state is.
        kernels: What does the heavy parts there.
    """

    def __init__(self, config: TrainConfig, cameras: Cameras, kernels: Kernels = COMPILED) -> None:
        self._config, self._cameras, self._kernels = config, cameras, kernels
        self._cache = AnchorCache(config)
        self._model = trained_model(config, kernels, self._cache)
        self._losses = PacketLosses(config, self._model, self._cache)

    def __call__(self, state: TrainState, view: int, photo: Photo) -> StepReport:
        """Learns from one view.

        Args:
            state: The state.
            view: Which view.
            photo: Its photo.

        Raises:
            DivergedError: If the loss is not finite.
        """
        config = self._config
        state.iteration += 1
        if config.marks.tuning and state.iteration == config.marks.settled + 1:
            settle(state, config)
        self._model.begin(state)
        self._losses.begin(state, self._cameras)
        visible = self._visible(state, view)
        (attributes, weight), rate = self._model.observe(state, visible)
        size_gain = None
        if (lost := self._losses.draw(state, rate)) is not None:
            visible, (attributes, weight), size_gain = lost.drawn(visible, (attributes, weight))
        anchors = self._seen(state, visible, attributes, weight)
        watched = gathers_statistics(config.marks, state.iteration)
        spawned = self._spawn(state, anchors, weight, view, size_gain)
        drawing = self._draw(spawned.gaussians, view, watched)
        loss, l1 = self._kernels.photometric_loss(drawing.image, photo, config.weights.dssim)
        loss = self._whole_loss(loss, state, spawned, rate)
        value = float(loss.detach())
        if not math.isfinite(value):
            raise DivergedError(state.iteration)
        if loss.requires_grad:
            loss.backward()
        if watched and (d_centers := drawing.d_centers) is not None:
            place = (spawned.gaussians, visible[spawned.anchor_index], spawned.offset_index)
            gather_statistics(state, visible, place, d_centers, self._cameras, view)
        if changes_anchors(config.marks, state.iteration):
            adjust_anchors(state, config)
        self._update(state)
        gather_mean(state, config)
        bits_per_anchor = float(rate.bits.detach()) / max(rate.num_anchors, 1) if rate is not None else None
        return StepReport(value, float(l1), bits_per_anchor, spawned.gaussians.num_gaussians)

    @torch.no_grad()
    def _visible(self, state: TrainState, view: int) -> Int64[Tensor, "M"]:
        """The anchors that a view may see (HAC++, decoding of a view)."""
        projected = project(self._cache.positions(state), state.scalings()[:, :3], None, self._cameras, view)
        return projected.touches_image(self._cameras.width, self._cameras.height).nonzero()[:, 0]

    def _seen(
        self, state: TrainState, visible: Int64[Tensor, "M"], attributes: Attributes, weight: Float[Tensor, "M K"]
    ) -> Anchors:
        """The visible anchors as they are drawn."""
        features, scalings, offsets = attributes
        offsets = offsets.view(-1, self._config.model.layout.num_offsets, 3)
        positions = self._cache.positions(state)[visible]
        return Anchors(positions, features, scalings, offsets, weight.detach() > 0.5)

    def _spawn(
        self,
        state: TrainState,
        anchors: Anchors,
        weight: Float[Tensor, "M K"],
        view: int,
        size_gain: Float[Tensor, "M"] | None,
    ) -> SpawnedGaussians:
        everything = torch.ones(anchors.num_anchors, dtype=torch.bool, device=state.device)
        center = self._cameras.centers[view].to(anchors.positions)
        heads = state.networks.heads
        return spawn_gaussians(anchors, heads, center, everything, size_gain=size_gain, mask_weight=weight)

    def _draw(self, gaussians: Gaussians, view: int, watched: bool) -> Drawing:
        background = gaussians.means.new_tensor(self._config.background)
        return self._kernels.draw(gaussians, self._cameras.select([view]), background=background, watched=watched)

    def _whole_loss(
        self, picture: Float[Tensor, ""], state: TrainState, spawned: SpawnedGaussians, rate: SampleRate | None
    ) -> Float[Tensor, ""]:
        """The loss of the picture, the Gaussians' volumes and the bits (HAC++, training)."""
        weights, scales, loss = self._config.weights, spawned.gaussians.scales, picture
        if len(scales):
            loss = loss + weights.volume * scales.prod(dim=1).mean()
        if rate is not None:
            loss = loss + self._model.rate_loss(state, rate)
        return loss

    def _update(self, state: TrainState) -> None:
        """Applies Adam to every parameter that has a gradient; new anchors wait for the next iteration."""
        rates = learning_rates(self._config, state.iteration, state.camera_extent)
        for name, parameter in state.parameters.items():
            if parameter.grad is None:
                continue
            if name not in state.moments:
                state.moments[name] = Moments(torch.zeros_like(parameter), torch.zeros_like(parameter))
            self._kernels.adam_update(parameter, parameter.grad, state.moments[name], rates[group_of(name)])
            parameter.grad = None
