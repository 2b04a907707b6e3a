"""Interface that scenes of Gaussians and scenes of anchors share. The codec, concealers and renderers use it."""

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from splatwire.arguments import CheckedFields
from splatwire.reprs import summary_repr
from splatwire.types.background import Background
from splatwire.types.loss_mask import LossMask
from splatwire.types.validity import ElementValidity

Own = TypeVar("Own")


@dataclass(frozen=True, eq=False)
class RenderHints(CheckedFields):
    """Instructions of a loss concealer for drawing each element: factors on size and opacity, and hidden elements.

    Attributes:
        size_gain: Factor on the size of the element's Gaussians, 1 for no change.
        left_out: Mask of elements (Gaussians or anchors) that are not drawn.
        opacity_gain: Factor on the opacity of the element's Gaussians; None for no change.
    """

    size_gain: Float[Any, "N"]
    left_out: Bool[Any, "N"]
    opacity_gain: Float[Any, "N"] | None = None

    __repr__ = summary_repr


@dataclass(frozen=True)
class GrowStrength(CheckedFields):
    """Strength with which the concealer `grow` enlarges received elements next to lost ones.

    Each class of scenes has its own strength. Let r be the share of an element's neighbours that were received, e the
    parameter `exponent` of the concealer, and a and b the two attributes of this class. The size of the element is
    multiplied by `r ** -(e * a)`. Its opacity o becomes `1 - (1 - o) ** (r ** -(e * b))`.

    Attributes:
        size: Strength a for sizes; 0 leaves them unchanged.
        opacity: Strength b for opacities; 0 leaves them unchanged.
    """

    size: float
    opacity: float


@runtime_checkable
class Elements(Protocol):
    """Typing protocol (structural type) for the N elements of a scene, which are Gaussians or anchors.

    Each element has a position, a size, and one row in every attribute array.
    """

    @property
    def log_sizes(self) -> Float[Any, "N"]:
        """Natural logarithm of each element's size, world units."""

    def select(self: Own, index: np.ndarray) -> Own:
        """Returns the elements at `index` (integers or mask), in that order."""

    def with_losses(self: Own, fully_received: Bool[np.ndarray, "N"], positions: Float[np.ndarray, "N 3"]) -> Own:
        """Simulates losses: returns the elements with the values of lost ones replaced by placeholders.

        Args:
            fully_received: Mask of received elements.
            positions: Positions for the lost elements; other rows are ignored.
        """

    def with_estimates(self: Own, loss_mask: LossMask, estimates: Own) -> Own:
        """Returns the elements with lost values replaced by estimates.

        Args:
            loss_mask: Mask of received values.
            estimates: All elements, with estimates of the lost values.
        """


@runtime_checkable
class Scene(Protocol):
    """Typing protocol for all kinds of scenes that can be drawn and encoded.

    A scene has elements (Gaussians or anchors), an appearance model and a background. `ELEMENTS` is the name of the
    elements in messages.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]
    ELEMENTS: ClassVar[str]
    GROW_STRENGTH: ClassVar[GrowStrength]

    @property
    def hints(self) -> RenderHints | None:
        """Changes by loss concealment: factors on size and opacity, and hidden elements. None without concealment."""

    @property
    def background(self) -> Background:
        """RGB of the background."""

    @property
    def elements(self) -> Any:
        """The Gaussians or anchors of the scene."""

    @property
    def positions(self) -> Float[Any, "N 3"]:
        """Position of each element."""

    @property
    def num_elements(self) -> int:
        """Number of elements, N."""

    @property
    def drawable(self) -> Bool[np.ndarray, "N"]:
        """Mask of the elements that can be visible in at least one view.

        An encoder drops all other elements.
        """

    def validity(self) -> ElementValidity:
        """Classifies the elements as drawable, invisible or invalid; only drawable ones are encoded."""

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians that the elements can produce in a view."""

    @property
    def facts(self) -> dict[str, int | float]:
        """Scene statistics for display, by name."""

    def select(self: Own, index: np.ndarray) -> Own:
        """Returns the scene with only the elements at `index`. Removes `hints`, the results of loss concealment."""

    def with_elements(self: Own, elements: Any, hints: RenderHints | None = None) -> Own:
        """Returns the scene with its elements replaced.

        Args:
            elements: The new Gaussians or anchors.
            hints: Factors on size and opacity, and hidden elements, set by loss concealment; None for no changes.
        """
