"""What every scene has, whatever its elements are: all that codec, concealers and renderers ask of it."""

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from splatwire.reprs import summary_repr
from splatwire.scene import Erasures
from splatwire.scene.background import Background
from splatwire.scene.rows import Rows

Own = TypeVar("Own")


@dataclass(frozen=True, eq=False)
class RenderHints:
    """What helps the picture beside the attributes; never touches a decoded attribute.

    Attributes:
        size_gain: Factor on the size of the element's Gaussians, 1 for none.
        left_out: True where the element is not drawn.
        opacity_gain: Factor on the opacity of the element's Gaussians, which stays at most 1; None for none anywhere.
    """

    size_gain: Float[Any, "N"]
    left_out: Bool[Any, "N"]
    opacity_gain: Float[Any, "N"] | None = None

    __repr__ = summary_repr


@dataclass(frozen=True)
class Coverage:
    """How elements make up for lost neighbours (`splatwire.conceal.Grow`), as multiples of its exponent.

    Attributes:
        size: Of the power by which sizes grow.
        opacity: Of the power by which the light that an element lets through falls; 0 where opacities stay.
    """

    size: float
    opacity: float


@runtime_checkable
class Elements(Protocol):
    """N things with a place, a size and named columns: arrays of N rows, one a field."""

    @property
    def log_sizes(self) -> Float[Any, "N"]:
        """Logarithm of the size of each, of the order of a length in world units."""

    def select(self: Own, index: np.ndarray) -> Own:
        """Those at `index`."""

    def arrived(self: Own, known: Bool[np.ndarray, "N"], places: Float[np.ndarray, "N 3"]) -> Own:
        """What a receiver has when only some of them came; the others are expected at `places`."""

    def kept(self: Own, erasures: Erasures, proposed: Own) -> Own:
        """What was received of these, and the rest of `proposed`."""


@runtime_checkable
class Scene(Protocol):
    """A scene that can be drawn and encoded: elements, appearance, background."""

    __dataclass_fields__: ClassVar[dict[str, Any]]
    ELEMENTS: ClassVar[str]
    COVERAGE: ClassVar[Coverage]

    @property
    def hints(self) -> RenderHints | None:
        """Render-time hints of a concealer, if one worked on the scene."""

    @property
    def background(self) -> Background:
        """RGB behind everything."""

    @property
    def elements(self) -> Any:
        """Its elements (`Elements`)."""

    @property
    def positions(self) -> Float[Any, "N 3"]:
        """Where they are."""

    @property
    def num_elements(self) -> int:
        """How many."""

    @property
    def drawable(self) -> Bool[np.ndarray, "N"]:
        """Those that any view can draw: worth a packet."""

    def rows(self) -> Rows:
        """What becomes of its elements where the scene is coded."""

    @property
    def num_gaussians(self) -> int:
        """Gaussians that they can have in a view."""

    @property
    def facts(self) -> dict[str, int | float]:
        """What a person may want to know of it, by name."""

    def select(self: Own, index: np.ndarray) -> Own:
        """The scene with the elements at `index`, hints left out."""

    def with_elements(self: Own, elements: Any, hints: RenderHints | None = None) -> Own:
        """The scene with other elements and hints."""
