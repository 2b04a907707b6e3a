"""What a concealer is, and the registry of concealers by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.conceal.context import AnchorContext
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.scene import Anchors


@dataclass(frozen=True, eq=False)
class Concealed:
    """What a concealer proposes.

    Attributes:
        anchors: All anchors with the gaps filled. Only attributes that were not received are taken from here.
        size_gain: Factor on the size of each anchor's Gaussians at render time, 1 for none.
        left_out: True where an anchor is not to be drawn.
    """

    anchors: Anchors
    size_gain: Float[Tensor, "N"]
    left_out: Bool[Tensor, "N"]

    @staticmethod
    def filled(anchors: Anchors) -> "Concealed":
        """Proposes to draw every anchor at its own size."""
        ones = torch.ones(anchors.num_anchors, dtype=anchors.positions.dtype)
        return Concealed(anchors, ones, torch.zeros(anchors.num_anchors, dtype=torch.bool))


@runtime_checkable
class Concealer(Protocol):
    """Fills the gaps that lost packets left. A pure function with a name; works in main memory."""

    @property
    def name(self) -> str:
        """The name under which it is registered."""

    def __call__(self, context: AnchorContext) -> Concealed:
        """Proposes what to draw. Must not change what was received, and never returns NaN."""


Factory = TypeVar("Factory", bound=Callable[..., Concealer])
_FACTORIES: dict[str, Callable[..., Concealer]] = {}


def register_concealer(name: str) -> Callable[[Factory], Factory]:
    """Registers a class or function that makes concealers from keyword options; used as a decorator."""

    def register(factory: Factory) -> Factory:
        _FACTORIES[name] = factory
        return factory

    return register


def concealer_names() -> tuple[str, ...]:
    """Names of all registered concealers, in order of registration."""
    return tuple(_FACTORIES)


def create_concealer(name: str, **options: Any) -> Concealer:
    """Makes a concealer.

    Args:
        name: One of `concealer_names()`.
        options: Fields of that concealer; defaults where absent.

    Raises:
        UnknownNameError: No concealer has that name.
        InvalidValueError: It has no such option, or the value makes no sense.
    """
    if name not in _FACTORIES:
        raise UnknownNameError("concealer", name, _FACTORIES)
    try:
        return _FACTORIES[name](**options)
    except TypeError as error:
        raise InvalidValueError(f"concealer '{name}' does not take these options: {error}") from error


def check_at_least(what: str, value: float | int, least: float | int) -> None:
    """Refuses options that are too small (or NaN).

    Raises:
        InvalidValueError: If `value` is not at least `least`.
    """
    if not value >= least:
        raise InvalidValueError(f"{what} must be at least {least:g}, not {value!r}")
