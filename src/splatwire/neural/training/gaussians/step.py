"""One training iteration of explicit Gaussians: renders a view and updates all parameters."""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.errors import DivergedError
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.gaussians.config import GaussianConfig
from splatwire.neural.training.gaussians.relocation import add_noise, relocate
from splatwire.neural.training.gaussians.state import GaussianState
from splatwire.neural.training.kernels import COMPILED, Kernels
from splatwire.neural.training.photometric_loss import Photo
from splatwire.neural.training.schedule import learning_rate_at
from splatwire.neural.training.state import Moments
from splatwire.neural.training.step import StepReport
from splatwire.ops.spherical_harmonics import DC, num_functions, sh_functions
from splatwire.types import Cameras, Gaussians

_MAX_OPAQUE = 0.999


class GaussianStep:
    """Training iteration of explicit Gaussians, applied to a state in place.

    Args:
        config: The configuration.
        cameras: The training cameras, on the device of the state.
        kernels: Implementations of the expensive operations for that device.
    """

    def __init__(self, config: GaussianConfig, cameras: Cameras, kernels: Kernels = COMPILED) -> None:
        self._config, self._cameras, self._kernels = config, to_tensors(cameras), kernels
        self._centers = self._cameras.centers
        self._background = self._cameras.Ks.new_tensor(config.background)

    def __call__(self, state: GaussianState, view: int, photo: Photo) -> StepReport:
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
        degree = config.degree_at(state.iteration)
        gaussians = seen_gaussians(state.parameters, degree, self._centers[view].to(state.parameters["means"]))
        cameras, one = self._cameras, slice(view, view + 1)
        camera = replace(cameras, viewmats=cameras.viewmats[one], Ks=cameras.Ks[one], names=cameras.names[one])
        background = self._background.to(gaussians.means)
        shown = self._with_dropout(state, gaussians)
        image = self._kernels.draw(shown, camera, background=background, center_gradients=False).image
        loss, l1 = self._kernels.photometric_loss(image, photo, config.dssim)
        loss = loss + config.opacity_weight * gaussians.opacities.mean()
        loss = loss + config.scale_weight / state.camera_extent * gaussians.scales.mean()
        self._check(state, loss)
        loss.backward()
        learning_rate = self._update(state)
        if config.relocates(state.iteration):
            num_gaussians = config.target_count(state.iteration, state.num_gaussians)
            relocate(state, num_gaussians, config.relocation.dead_opacity)
        noise = config.relocation.noise * learning_rate / config.rates.means.initial / state.camera_extent
        add_noise(state, noise, self._kernels.random.uniform)
        return StepReport(loss.detach(), l1, None, 0, torch.tensor(state.num_gaussians))

    def _with_dropout(self, state: GaussianState, gaussians: Gaussians) -> Gaussians:
        """Sets the opacity of randomly chosen Gaussians to 0 (dropout), and increases the opacities of the others."""
        if not (share := self._config.dropout):
            return gaussians
        numbers = self._kernels.random.uniform(gaussians.opacities.shape, state.generator, state.device)
        factors = (numbers >= share).to(gaussians.opacities) / (1 - share)
        return replace(gaussians, opacities=(gaussians.opacities * factors).clamp(max=_MAX_OPAQUE))

    def _check(self, state: GaussianState, loss: Float[Tensor, ""]) -> None:
        last = state.iteration == self._config.iterations
        if (last or state.iteration % self._kernels.report_interval == 0) and not math.isfinite(float(loss.detach())):
            raise DivergedError(state.iteration)

    def _update(self, state: GaussianState) -> float:
        """Updates every parameter that has a gradient by one step of Adam.

        Returns:
            Learning rate of the centres, before multiplication by the extent of the cameras.
        """
        share = state.iteration / self._config.iterations
        learning_rates = {
            name: learning_rate_at(schedule, share) for name, schedule in vars(self._config.rates).items()
        }
        updates = []
        for name, parameter in state.parameters.items():
            if parameter.grad is None:
                continue
            if name not in state.moments:
                state.moments[name] = Moments(torch.zeros_like(parameter), torch.zeros_like(parameter))
            learning_rate = learning_rates[name.split(".")[0]] * (state.camera_extent if name == "means" else 1.0)
            updates.append((parameter, parameter.grad, state.moments[name], learning_rate))
            parameter.grad = None
        self._kernels.adam_update(updates)
        return learning_rates["means"]


def seen_gaussians(parameters: dict[str, Tensor], degree: int, center: Float[Tensor, "3"]) -> Gaussians:
    """Returns the Gaussians with the colours that a camera sees; differentiable.

    Args:
        parameters: Trained tensors (`GaussianState.parameters`).
        degree: Degree of the harmonics that are used.
        center: Centre of the camera, world units.
    """
    # No gradient reaches the centres through the viewing directions.
    means = parameters["means"]
    colors = 0.5 + DC * parameters["base"]
    if degree:
        x, y, z = torch.nn.functional.normalize(means.detach() - center, dim=1).unbind(dim=1)
        functions = sh_functions(x, y, z, degree)
        for band in range(1, degree + 1):
            basis = torch.stack(functions[num_functions(band - 1) : num_functions(band)], dim=1)
            colors = colors + (basis[:, :, None] * parameters[f"harmonics.{band}"]).sum(dim=1)
    return Gaussians(
        means,
        torch.nn.functional.normalize(parameters["quats"], dim=1),
        parameters["log_scales"].exp(),
        torch.sigmoid(parameters["logits"]),
        torch.relu(colors),
    )
