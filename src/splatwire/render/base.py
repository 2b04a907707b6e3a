"""Typing protocols (structural types) that renderers implement."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from splatwire.types import Cameras, Gaussians


@runtime_checkable  # the test run checks annotations
class Renderer(Protocol):
    """Typing protocol (structural type) for a renderer of Gaussians with the conventions of 3DGS."""

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, *, background: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "C H W 3"]:
        """Renders the Gaussians in every view.

        Args:
            gaussians: The Gaussians.
            cameras: Cameras of one or more views.
            background: RGB of the background.

        Returns:
            RGB, not clamped, float32.
        """
        ...


@dataclass(frozen=True, eq=False)
class Drawing:
    """Result of rendering one view for training.

    Attributes:
        image: RGB, not clamped; differentiable with respect to the Gaussians.
        centers: 2D centres of the Gaussians, pixels. After `backward`, `centers.grad` is the gradient with respect to
            them. None if not requested.
    """

    image: Float[Any, "H W 3"]
    centers: Float[Any, "1 G 2"] | None

    @property
    def d_centers(self) -> Float[Any, "G 2"] | None:
        """Gradient with respect to the 2D centres in pixels; None if not requested, or before `backward`."""
        return None if self.centers is None or self.centers.grad is None else self.centers.grad[0]


@runtime_checkable  # the test run checks annotations
class TrainingRenderer(Protocol):
    """Typing protocol (structural type) for a differentiable renderer of a single view.

    It draws on the device of the Gaussians.
    """

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, *, background: Float[Any, "3"], center_gradients: bool
    ) -> Drawing:
        """Draws the only view of `cameras`.

        Args:
            gaussians: The Gaussians.
            cameras: Cameras of one view.
            background: RGB of the background.
            center_gradients: True if the gradient with respect to the 2D centres is needed.
        """
        ...
