"""What a concealer is, and the registry of concealers by name."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.conceal.context import AnchorContext, ElementContext
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.model import AnchorScene, PartialSplats, RenderHints
from splatwire.scene import Anchors


@dataclass(frozen=True, eq=False)
class Concealed:
    """What a concealer proposes.

    Attributes:
        anchors: All anchors with the gaps filled. Only attributes that were not received are taken from here.
        size_gain: Factor on the size of each anchor's Gaussians at render time, 1 for none.
        left_out: True where an anchor is not to be drawn.
        opacity_gain: Factor on the opacity of each anchor's Gaussians, which stays at most 1; None for none anywhere.
    """

    anchors: Anchors
    size_gain: Float[Tensor, "N"]
    left_out: Bool[Tensor, "N"]
    opacity_gain: Float[Tensor, "N"] | None = None

    @staticmethod
    def filled(anchors: Anchors) -> "Concealed":
        """Proposes to draw every anchor at its own size."""
        ones = torch.ones(anchors.num_anchors, dtype=anchors.positions.dtype)
        return Concealed(anchors, ones, torch.zeros(anchors.num_anchors, dtype=torch.bool))

    @staticmethod
    def drawn(anchors: Anchors, hints: RenderHints) -> "Concealed":
        """Proposes to draw anchors with some hints."""
        return Concealed(anchors, hints.size_gain, hints.left_out, hints.opacity_gain)


@runtime_checkable
class Concealer(Protocol):
    """Fills the gaps that lost packets left. A pure function with a name; works in main memory."""

    @property
    def name(self) -> str:
        """The name under which it is registered."""

    def __call__(self, context: AnchorContext) -> Concealed:
        """Proposes what to draw. Must not change what was received, and never returns NaN."""


@runtime_checkable
class ElementConcealer(Protocol):
    """A concealer that needs to know no more of an element than where it is and how large: it works on any kind."""

    @property
    def name(self) -> str:
        """The name under which it is registered."""

    def hints(self, elements: ElementContext) -> RenderHints:
        """Says how to draw what arrived; lost elements are left out."""


@runtime_checkable
class CopyConcealer(ElementConcealer, Protocol):
    """A concealer that draws what the sender left copies of, and what arrived with hints."""

    def filled(self, partial: PartialSplats) -> PartialSplats:
        """What arrived with the copies where they are needed."""


Factory = TypeVar("Factory", bound=Callable[..., Concealer])
_FACTORIES: dict[str, Callable[..., Concealer]] = {}
_NEEDS: dict[str, str] = {}
"""The option without which a concealer cannot be made, by concealer."""
_SECTIONS: dict[str, str] = {}
"""The section of the side information without which a concealer cannot work, by concealer."""
_SHIPPED: dict[str, Mapping[str, Path]] = {}
"""The files of weights that come with the package, for each kind of elements, by concealer."""
_UNLISTED: set[str] = set()
"""Concealers that are there for comparison only."""


def register_concealer(
    name: str,
    *,
    needs: str | None = None,
    section: str | None = None,
    shipped: Mapping[str, Path] | None = None,
    listed: bool = True,
) -> Callable[[Factory], Factory]:
    """Registers a class or function that makes concealers from keyword options; used as a decorator.

    Args:
        name: Its name.
        needs: An option that it cannot do without, such as a file of weights; `name:VALUE` gives it.
        section: A section of the side information that it cannot do without.
        shipped: The package's files of weights by what elements are called, which it reads where its option `weights`
            names no other.
        listed: Whether `concealer_names` lists it.
    """

    def register(factory: Factory) -> Factory:
        _FACTORIES[name] = factory
        if needs is not None:
            _NEEDS[name] = needs
        if section is not None:
            _SECTIONS[name] = section
        if shipped is not None:
            _SHIPPED[name] = shipped
        if not listed:
            _UNLISTED.add(name)
        return factory

    return register


def concealer_names(sections: Iterable[str] = (), elements: str = AnchorScene.ELEMENTS) -> tuple[str, ...]:
    """Names of all registered concealers that work as they are, in order of registration.

    Args:
        sections: Named sections that the stream has; concealers that read another one are not listed.
        elements: What the stream's elements are called (`Scene.ELEMENTS`): many concealers fill attributes of anchors.
    """
    there = {None, *sections}
    return tuple(
        name
        for name, factory in _FACTORIES.items()
        if name not in _UNLISTED
        and (elements == AnchorScene.ELEMENTS or hasattr(factory, ElementConcealer.hints.__name__))
        and _SECTIONS.get(name) in there
        and (name not in _NEEDS or name in _SECTIONS)  # a section does for the option
    )


def concealer_sections() -> dict[str, str]:
    """The section of the side information that a concealer reads, by its name, for those that read one."""
    return dict(_SECTIONS)


def concealer_file(name: str, options: Mapping[str, Any], elements: str = AnchorScene.ELEMENTS) -> Path | None:
    """The file of weights that a concealer reads; None if it reads none.

    Args:
        name: Its name, or `name:FILE`.
        options: Its options.
        elements: What the elements that it works on are called.
    """
    name, _, file = name.partition(":")
    named = file or options.get("weights" if elements == AnchorScene.ELEMENTS else "gaussian_weights")
    return Path(named) if named else _SHIPPED.get(name, {}).get(elements)


def create_concealer(name: str, **options: Any) -> Concealer:
    """Makes a concealer.

    Args:
        name: One of `concealer_names()`, or `gnn:FILE` for one that needs something.
        options: Fields of that concealer; defaults where absent.

    Raises:
        UnknownNameError: No concealer has that name.
        InvalidValueError: It has no such option, or the value makes no sense.
    """
    name, colon, value = name.partition(":")
    if name not in _FACTORIES or (colon and name not in _NEEDS):
        raise UnknownNameError("concealer", name + colon + value, _FACTORIES)
    if colon:
        options = {_NEEDS[name]: value, **options}
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
