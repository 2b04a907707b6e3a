"""What a concealer is, and what it proposes."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.model import Partial, RenderHints
from splatwire.ops.arrays import to_arrays


@dataclass(frozen=True, eq=False)
class Concealed(RenderHints):
    """What a concealer proposes: how to draw what is there, and what to leave out.

    Attributes:
        elements: All elements with the gaps filled, of which only what was not received is taken; None for gaps filled
            as the side information expects (`Partial.filled`).
        shows: Whether elements are drawn that the scene itself leaves out: coarser ones, in the place of lost ones.
    """

    elements: Any = None
    shows: bool = False

    @staticmethod
    def filled(elements: Any) -> "Concealed":
        """Proposes to draw every element at its own size."""
        elements = to_arrays(elements)
        count = len(next(iter(vars(elements).values())))
        return Concealed(np.ones(count, np.float32), np.zeros(count, np.bool_), elements=elements)

    @property
    def hints(self) -> RenderHints:
        """The hints alone."""
        return RenderHints(self.size_gain, self.left_out, self.opacity_gain)


@runtime_checkable
class Concealer(Protocol):
    """Fills the gaps that lost packets left. A pure function with a name; works in main memory."""

    @property
    def name(self) -> str:
        """The name under which it is registered."""

    def __call__(self, partial: Partial, /) -> Concealed:
        """Proposes what to draw. Must not change what was received, and never returns NaN."""


def check_at_least(what: str, value: float | int, least: float | int) -> None:
    """Refuses options that are too small (or NaN).

    Raises:
        InvalidValueError: If `value` is not at least `least`.
    """
    if not value >= least:
        raise InvalidValueError(f"{what} must be at least {least:g}, not {value!r}")
