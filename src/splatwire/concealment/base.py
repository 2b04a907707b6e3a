"""Typing protocol (structural type) for a loss concealer, and the type of its result."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import to_arrays
from splatwire.reprs import summary_repr
from splatwire.types import ReceivedScene, RenderHints


@dataclass(frozen=True, eq=False)
class Concealed(RenderHints):
    """Result of a concealer: how to draw received elements, and estimates of lost elements.

    Attributes:
        elements: All Gaussians or anchors of the scene, with estimates for lost values. None to use the values that the
            side information predicts.
        draws_hidden: True if the concealer also draws elements that are not drawn in the lossless scene, e.g. Gaussians
            of a coarser level of detail in place of lost ones.
    """

    elements: Any = None
    draws_hidden: bool = False

    __repr__ = summary_repr

    @staticmethod
    def filled(elements: Any) -> "Concealed":
        """Returns the result of a concealer that estimates all lost values. No element is enlarged or hidden.

        Args:
            elements: All Gaussians or anchors of the scene: received ones, and estimates of lost ones.
        """
        elements = to_arrays(elements)
        count = len(next(iter(vars(elements).values())))
        return Concealed(np.ones(count, np.float32), np.zeros(count, np.bool_), elements=elements)

    @property
    def hints(self) -> RenderHints:
        """Hints for the renderer: factors on the size and opacity of each element, and the mask of hidden elements."""
        return RenderHints(self.size_gain, self.left_out, self.opacity_gain)


@runtime_checkable
class Concealer(Protocol):
    """Interface of a loss concealer: a function with a name that estimates the lost elements of a received scene."""

    @property
    def name(self) -> str:
        """Name of the concealer, as passed to `create_concealer`."""

    def __call__(self, received: ReceivedScene, /) -> Concealed:
        """Returns estimates of lost values for a received scene, and hints for rendering it.

        A concealer must not change received values or return NaN.
        """


def check_at_least(name: str, value: float | int, minimum: float | int) -> None:
    """Checks that a numeric option of a concealer is at least `minimum`; NaN is rejected.

    Args:
        name: Name of the option, for the message.
        value: Value of the option.
        minimum: Minimum value.

    Raises:
        InvalidValueError: If `value` is not at least `minimum`.
    """
    if not value >= minimum:
        raise InvalidValueError(f"{name} must be at least {minimum:g}, not {value!r}")
