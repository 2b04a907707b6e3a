"""One training iteration: renders a training view, compares the picture with the photo, and updates the parameters.

Growth adds and removes anchors after the backward pass. The new tensors of the anchors have no gradient, so they are
not updated in this iteration; the networks are. Packet loss and the start of the fine-tuning remove anchors before the
picture is rendered.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.errors import DivergedError
from splatwire.neural.model.gaussian_heads import SpawnedGaussians, spawn_gaussians
from splatwire.neural.model.tensor_projection import project_tensors
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training import device_view
from splatwire.neural.training.averaging import update_means
from splatwire.neural.training.causal_device import DeviceCausal
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.context import AnchorCache, Attributes, SampleBits
from splatwire.neural.training.device_view import AllGaussians
from splatwire.neural.training.fine_tuning_phase import start_fine_tuning
from splatwire.neural.training.growth import adjust_anchors, gather_statistics
from splatwire.neural.training.kernels import COMPILED, Kernels
from splatwire.neural.training.models import new_context_model
from splatwire.neural.training.packet_loss import PacketLossSimulator
from splatwire.neural.training.photometric_loss import Photo
from splatwire.neural.training.schedule import changes_anchors, gathers_statistics, learning_rates
from splatwire.neural.training.state import Moments, TrainState, group_of
from splatwire.render.base import Drawing
from splatwire.types import Anchors, Cameras, Gaussians


@dataclass(frozen=True, eq=False)
class StepReport:
    """Results of a training iteration, as tensors on the training device.

    Attributes:
        total: The total loss.
        absolute_error: Mean absolute error of the rendered picture.
        sample_bits: Estimated bits of a random sample of anchors; None while the rate is not part of the loss.
        num_sampled: Number of anchors in the sample.
        num_drawn: Number of Gaussians drawn.
    """

    # The properties return Python numbers; reading a property makes the host wait for the device.

    total: Float[Tensor, ""]
    absolute_error: Float[Tensor, ""]
    sample_bits: Float[Tensor, ""] | None
    num_sampled: int
    num_drawn: Int64[Tensor, ""]

    @property
    def loss(self) -> float:
        """The total loss."""
        return float(self.total)

    @property
    def l1(self) -> float:
        """Mean absolute error of the rendered picture."""
        return float(self.absolute_error)

    @property
    def bits_per_anchor(self) -> float | None:
        """Estimated mean bits per anchor (see `SampleBits`); None if the loss excludes the bit rate."""
        return None if self.sample_bits is None else float(self.sample_bits) / max(self.num_sampled, 1)

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians drawn."""
        return int(self.num_drawn)


class TrainingStep:
    """Training iteration of an anchor scene, applied to a state in place.

    Args:
        config: The configuration.
        cameras: The training cameras, on the device of the state.
        kernels: Implementations of the expensive operations for that device.
    """

    def __init__(self, config: TrainConfig, cameras: Cameras, kernels: Kernels = COMPILED) -> None:
        self._config, self._cameras, self._kernels = config, to_tensors(cameras), kernels
        self._cache = AnchorCache(config)
        self._context_model = new_context_model(config, kernels, self._cache)
        self._packet_loss = PacketLossSimulator(config, self._context_model, self._cache)
        self._views = device_view.ViewConstants.of(self._cameras) if kernels.asynchronous else None
        cameras = self._cameras
        self._centers, self._background = cameras.centers, cameras.Ks.new_tensor(config.background)

    def __call__(self, state: TrainState, view: int, photo: Photo) -> StepReport:
        """Performs one iteration with one view.

        Args:
            state: State of the training; changed in place.
            view: Index of the view.
            photo: Photo of the view.

        Raises:
            DivergedError: If the loss is not finite. On a GPU, the loss is checked only every `Kernels.report_interval`
                iterations.
        """
        config = self._config
        state.iteration += 1
        if config.milestones.fine_tuning_iterations and state.iteration == config.milestones.main_iterations + 1:
            start_fine_tuning(state, config)
        self._context_model.before_iteration(state)
        self._packet_loss.before_iteration(state, self._cameras)
        visible = self._visible(state, view)
        (attributes, offset_masks), estimated_bits = self._context_model.simulate_quantisation(state, visible)
        size_gain = None
        if (received := self._packet_loss.simulate(state, estimated_bits)) is not None:
            visible, (attributes, offset_masks), size_gain = received.select_visible(
                visible, (attributes, offset_masks)
            )
        anchors = self._drawn_anchors(state, visible, attributes, offset_masks)
        center_gradients = gathers_statistics(config.milestones, state.iteration)
        spawned = self._spawn(state, anchors, offset_masks, view, size_gain)
        drawing = self._draw(spawned.gaussians, view, center_gradients)
        loss, l1 = self._kernels.photometric_loss(drawing.image, photo, config.weights.dssim)
        if isinstance(spawned, SpawnedGaussians):
            num_drawn = torch.tensor(spawned.gaussians.num_gaussians)
        else:
            num_drawn = spawned.num_drawn
        loss = self._total_loss(loss, state, spawned, num_drawn, estimated_bits)
        self._check(state, loss)
        if loss.requires_grad:
            loss.backward()
        if center_gradients and (d_centers := drawing.d_centers) is not None:
            self._gather(state, visible, spawned, d_centers, view)
        if changes_anchors(config.milestones, state.iteration):
            adjust_anchors(state, config, self._kernels.random.uniform)
        self._update(state)
        update_means(state, config)
        bits = None if estimated_bits is None else estimated_bits.bits.detach()
        return StepReport(
            loss.detach(), l1, bits, 0 if estimated_bits is None else estimated_bits.num_anchors, num_drawn
        )

    @property
    def size_estimator(self) -> Callable[[TrainState], float] | None:
        """Function that estimates the bytes of the encoded scene up to a constant factor; None if there is none."""
        return self._context_model.estimate_bytes if isinstance(self._context_model, DeviceCausal) else None

    def _check(self, state: TrainState, loss: Float[Tensor, ""]) -> None:
        last = state.iteration == self._config.milestones.iterations
        if (last or state.iteration % self._kernels.report_interval == 0) and not math.isfinite(float(loss.detach())):
            raise DivergedError(state.iteration)

    @torch.no_grad()
    def _visible(self, state: TrainState, view: int) -> Int64[Tensor, "M"]:
        """Returns the indices of the anchors that a view may see."""
        positions = self._cache.positions(state)
        if self._views is not None:
            logs = state.parameters["log_scalings"]
            offset_scales = logs[:, : 3 if logs.shape[1] == 6 else 1].exp()
            return device_view.visible_anchors(self._views, view, positions, offset_scales).nonzero()[:, 0]
        projected = project_tensors(positions, state.scalings()[:, :3], None, self._cameras, view)
        return projected.touches_image(self._cameras.width, self._cameras.height).nonzero()[:, 0]

    def _drawn_anchors(
        self, state: TrainState, visible: Int64[Tensor, "M"], attributes: Attributes, offset_masks: Float[Tensor, "M K"]
    ) -> Anchors:
        """Builds the anchors to render from the attributes of the visible anchors.

        Args:
            state: State of the training.
            visible: Indices of the visible anchors.
            attributes: Features, scalings and offsets of these anchors, with noise.
            offset_masks: Masks of the visible anchors' offsets, 0 or 1.
        """
        features, scalings, offsets = attributes
        offsets = offsets.view(-1, self._config.model.layout.num_offsets, 3)
        positions = self._cache.positions(state)[visible]
        return Anchors(positions, features, scalings, offsets, offset_masks.detach() > 0.5)

    def _spawn(
        self,
        state: TrainState,
        anchors: Anchors,
        offset_masks: Float[Tensor, "M K"],
        view: int,
        size_gain: Float[Tensor, "M"] | None,
    ) -> SpawnedGaussians | AllGaussians:
        heads, center = state.networks.heads, self._centers[view].to(anchors.positions)
        if self._kernels.asynchronous:
            return device_view.spawn_all(anchors, heads, center, offset_masks, size_gain)
        everything = torch.ones(anchors.num_anchors, dtype=torch.bool, device=state.device)
        return spawn_gaussians(anchors, heads, center, everything, size_gain=size_gain, mask_weight=offset_masks)

    def _draw(self, gaussians: Gaussians, view: int, center_gradients: bool) -> Drawing:
        cameras, one = self._cameras, slice(view, view + 1)
        camera = replace(cameras, viewmats=cameras.viewmats[one], Ks=cameras.Ks[one], names=cameras.names[one])
        background = self._background.to(gaussians.means)
        return self._kernels.draw(gaussians, camera, background=background, center_gradients=center_gradients)

    def _total_loss(
        self,
        photometric: Float[Tensor, ""],
        state: TrainState,
        spawned: SpawnedGaussians | AllGaussians,
        num_drawn: Int64[Tensor, ""],
        estimated_bits: SampleBits | None,
    ) -> Float[Tensor, ""]:
        """Returns the total loss: photometric loss, volume of the Gaussians, and rate.

        The photometric and the volume term are those of HAC++; the rate term depends on the context model.

        Args:
            photometric: Photometric loss of the rendered picture.
            state: State of the training.
            spawned: Gaussians of the view.
            num_drawn: Number of Gaussians drawn.
            estimated_bits: Estimated bits of a sample of anchors; None to leave out the rate.
        """
        weights, scales, loss = self._config.weights, spawned.gaussians.scales, photometric
        if len(scales) and isinstance(spawned, SpawnedGaussians):
            loss = loss + weights.volume * scales.prod(dim=1).mean()
        elif isinstance(spawned, AllGaussians):  # the gradient of torch.prod synchronises with the host
            x, y, z = scales.unbind(dim=1)
            loss = loss + weights.volume * torch.dot(x * y * z, spawned.drawn.to(scales)) / num_drawn.clamp(min=1)
        if estimated_bits is not None:
            loss = loss + self._context_model.rate_loss(state, estimated_bits)
        return loss

    def _gather(
        self,
        state: TrainState,
        visible: Int64[Tensor, "M"],
        spawned: SpawnedGaussians | AllGaussians,
        d_centers: Float[Tensor, "G 2"],
        view: int,
    ) -> None:
        if self._views is not None and isinstance(spawned, AllGaussians):
            device_view.gather_statistics(state, visible, spawned, d_centers, self._views, view)
            return
        assert isinstance(spawned, SpawnedGaussians)
        drawn = (spawned.gaussians, visible[spawned.anchor_index], spawned.offset_index)
        gather_statistics(state, visible, drawn, d_centers, self._cameras, view)

    def _update(self, state: TrainState) -> None:
        """Updates every parameter that has a gradient by one step of Adam."""
        rates = learning_rates(self._config, state.iteration, state.camera_extent)
        updates = []
        for name, parameter in state.parameters.items():
            if parameter.grad is None:
                continue
            if name not in state.moments:
                state.moments[name] = Moments(torch.zeros_like(parameter), torch.zeros_like(parameter))
            updates.append((parameter, parameter.grad, state.moments[name], rates[group_of(name)]))
            parameter.grad = None
        self._kernels.adam_update(updates)
