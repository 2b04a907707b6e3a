"""State of a training of explicit Gaussians, as plain tensors."""

from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.neural.training.state import Moments
from splatwire.ops.spherical_harmonics import num_functions
from splatwire.types import SplatScene
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats


@dataclass
class GaussianState:
    """Complete state of a training of N Gaussians, sufficient to resume the training.

    Attributes:
        iteration: Number of completed iterations.
        parameters: Trained tensors by name: `means` (N, 3), `log_scales` (N, 3), `quats` (N, 4), `logits` (N) of the
            opacities, `base` (N, 3) with the spherical harmonics of degree 0, and `harmonics.d` (N, 2 d + 1, 3) with
            those of each higher degree d.
        moments: Adam's moments by parameter name; absent for parameters that were never updated.
        camera_extent: 1.1 times the largest distance of a training camera from the mean camera centre, world units.
        generator: Source of all random numbers, on the CPU.
        view_queue: Indices of the training views not yet used in the current round over all views.
        origin: World coordinates that `means` are relative to.
        photo_size: Width and height of the training photos, pixels; None if not known.
    """

    iteration: int
    parameters: dict[str, Tensor]
    moments: dict[str, Moments]
    camera_extent: float
    generator: torch.Generator
    view_queue: list[int] = field(default_factory=list)
    origin: Origin = NO_ORIGIN
    photo_size: tuple[int, int] | None = None

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians, N."""
        return int(self.parameters["means"].shape[0])

    @property
    def num_elements(self) -> int:
        """Number of Gaussians, N."""
        return self.num_gaussians

    @property
    def device(self) -> torch.device:
        """Device of the tensors."""
        return self.parameters["means"].device

    @property
    def opacities(self) -> Float[Tensor, "N"]:
        """Opacity of each Gaussian."""
        return torch.sigmoid(self.parameters["logits"])

    def moved(self, device: torch.device) -> "GaussianState":
        """Returns the state on a device, without a copy if the state is already there."""
        if self.device == device:
            return self
        return replace(
            self,
            parameters={name: value.detach().to(device).requires_grad_() for name, value in self.parameters.items()},
            moments={
                name: Moments(moments.first.to(device), moments.second.to(device), moments.steps)
                for name, moments in self.moments.items()
            },
        )

    @torch.no_grad()
    def scene(self, degree: int, background: tuple[float, float, float]) -> SplatScene:
        """Returns the Gaussians as a scene, on the CPU.

        Args:
            degree: Degree of the harmonics, at most that of the state.
            background: RGB of the background.
        """
        values = {name: value.detach().cpu() for name, value in self.parameters.items()}
        bands = [values["base"][:, None], *(values[f"harmonics.{d}"] for d in range(1, degree + 1))]
        splats = Splats(
            values["means"].numpy().copy(),
            torch.nn.functional.normalize(values["quats"], dim=1).numpy(),
            values["log_scales"].exp().numpy(),
            torch.sigmoid(values["logits"]).numpy(),
            torch.cat(bands, dim=1).numpy(),
        )
        return SplatScene(splats, background=background, origin=self.origin)


def parameter_shapes(num_gaussians: int, degree: int) -> dict[str, tuple[int, ...]]:
    """Returns the shape of every trained tensor by name."""
    shapes: dict[str, tuple[int, ...]] = {
        "means": (num_gaussians, 3),
        "log_scales": (num_gaussians, 3),
        "quats": (num_gaussians, 4),
        "logits": (num_gaussians,),
        "base": (num_gaussians, 3),
    }
    for band in range(1, degree + 1):
        shapes[f"harmonics.{band}"] = (num_gaussians, num_functions(band) - num_functions(band - 1), 3)
    return shapes
