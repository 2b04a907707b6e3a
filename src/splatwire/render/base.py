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
        center_probe: Tensor whose `grad`, after `backward`, is the gradient with respect to the 2D centres of the
            Gaussians, 1 / pixel. Its values depend on the renderer: 2D centres or zeros. None if not requested.
    """

    image: Float[Any, "H W 3"]
    center_probe: Float[Any, "1 G 2"] | None

    @property
    def d_centers(self) -> Float[Any, "G 2"] | None:
        """Gradient with respect to the 2D centres in pixels; None if not requested, or before `backward`."""
        return None if self.center_probe is None or self.center_probe.grad is None else self.center_probe.grad[0]


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
