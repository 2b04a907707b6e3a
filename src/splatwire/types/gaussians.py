"""Explicit Gaussians of one view, the input of a rasteriser."""

from dataclasses import dataclass
from typing import Any

from jaxtyping import Float

from splatwire.arguments import check_fields
from splatwire.reprs import summary_repr
from splatwire.types.shapes import Shape, check_arrays

_SHAPES: dict[str, Shape] = {
    "means": ("G", 3), "quats": ("G", 4), "scales": ("G", 3), "opacities": ("G",), "colors": ("G", 3),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Gaussians:
    """G anisotropic Gaussians, each with the colour seen in one view.

    Fields are float32 numpy arrays, or torch tensors in training.

    Attributes:
        means: Centres, world units, relative to the scene's origin.
        quats: Unit quaternions, (w, x, y, z).
        scales: Standard deviations along the principal axes, world units.
        opacities: Opacity at the centre, 0 to 1.
        colors: RGB, at least 0. Colours of explicit Gaussians may exceed 1.
    """

    means: Float[Any, "G 3"]
    quats: Float[Any, "G 4"]
    scales: Float[Any, "G 3"]
    opacities: Float[Any, "G"]
    colors: Float[Any, "G 3"]

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        check_fields(self)
        check_arrays(self, _SHAPES, positions="means")

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians, G."""
        return int(self.means.shape[0])
