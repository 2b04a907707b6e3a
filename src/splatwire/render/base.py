"""What a renderer is, and the names of the ones there are."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from splatwire.scene import Cameras, Gaussians


@runtime_checkable  # the test run checks annotations
class Renderer(Protocol):
    """Draws Gaussians; the conventions are those of 3DGS, whatever the backend."""

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, *, background: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "C H W 3"]:
        """Draws the same Gaussians in every view.

        Args:
            gaussians: What to draw.
            cameras: Where from, one or more views.
            background: RGB behind everything.

        Returns:
            RGB, not clamped, float32.
        """
        ...


@dataclass(frozen=True, eq=False)
class Drawing:
    """One view as training draws it.

    Attributes:
        image: RGB, not clamped; differentiable in the Gaussians.
        centers: A tensor whose `.grad`, after `backward`, is the gradient in the Gaussians' 2D centres, per pixel, zero
            for those that are not drawn; None if nobody asked for it.
    """

    image: Float[Any, "H W 3"]
    centers: Float[Any, "1 G 2"] | None

    @property
    def d_centers(self) -> Float[Any, "G 2"] | None:
        """Gradient in the 2D centres, per pixel; None if nobody asked for it, and before `backward`."""
        return None if self.centers is None or self.centers.grad is None else self.centers.grad[0]


@runtime_checkable  # the test run checks annotations
class TrainingRenderer(Protocol):
    """Draws one view where the Gaussians are, differentiable, and tells what pulls at their 2D centres."""

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, *, background: Float[Any, "3"], watched: bool
    ) -> Drawing:
        """Draws the only view of `cameras`.

        Args:
            gaussians: What to draw.
            cameras: Where from, one view.
            background: RGB behind everything.
            watched: Whether the gradient in the 2D centres will be asked for.
        """
        ...
