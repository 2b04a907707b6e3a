"""Explicit Gaussians whose colour is a function of the viewing direction: what a 3DGS file holds."""

import dataclasses
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.ops.spherical_harmonics import degree_of, sh_basis
from splatwire.scene.gaussians import Gaussians


@dataclass(frozen=True, eq=False)
class Splats:
    """G anisotropic Gaussians with spherical harmonics for colour; nothing else depends on the view.

    Attributes:
        means: World coordinates of the centres.
        quats: Unit quaternions, (w, x, y, z).
        scales: Standard deviations along the principal axes, world units (linear, not logarithms).
        opacities: Opacity at the centre, in (0, 1) (not logits).
        sh: Coefficients of red, green and blue, ordered as in `splatwire.ops.spherical_harmonics`; the colour is 0.5
            plus their sum.
    """

    means: Float[Tensor, "G 3"]
    quats: Float[Tensor, "G 4"]
    scales: Float[Tensor, "G 3"]
    opacities: Float[Tensor, "G"]
    sh: Float[Tensor, "G D 3"]

    def __post_init__(self) -> None:
        degree_of(self.sh.shape[1])

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians, G."""
        return int(self.means.shape[0])

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        return degree_of(self.sh.shape[1])

    def select(self, index: Tensor) -> "Splats":
        """Returns the Gaussians at `index` (integers or a boolean mask over G), in that order."""
        return Splats(**{f.name: getattr(self, f.name)[index] for f in dataclasses.fields(self)})

    def seen_from(self, camera_center: Float[Tensor, "3"]) -> Gaussians:
        """Returns the Gaussians with the colours that a camera at `camera_center` sees.

        Colours are cut at 0, as every 3DGS renderer does, and may exceed 1. Differentiable.
        """
        directions = torch.nn.functional.normalize(self.means - camera_center, dim=1)
        colors = torch.einsum("gd,gdc->gc", sh_basis(directions, self.degree), self.sh) + 0.5
        return Gaussians(self.means, self.quats, self.scales, self.opacities, colors.clamp(min=0))
