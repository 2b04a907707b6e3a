"""Concealers by name: those of this room, and those that installed packages announce as entry points.

A package announces a concealer under the group `splatwire.concealers`, name = its name, value = what
`register_concealer` decorates (docs/your-own-concealer.md). It is loaded when it is asked for first, in whatever
process that is.
"""

import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from splatwire.conceal.base import Concealer
from splatwire.errors import InvalidValueError, UnknownNameError, how_to_install
from splatwire.model import Partial

GROUP = "splatwire.concealers"
"""Entry points of concealers."""
_HOUSE = "splatwire"
_LOG = logging.getLogger(__name__)
Need: TypeAlias = type | tuple[type, ...]
Factory = TypeVar("Factory", bound=Callable[..., Concealer])


@dataclass(frozen=True)
class Registration:
    """What is known of a concealer before it is made.

    Attributes:
        make: Makes it from keyword options.
        needs: Kinds of records that it looks at; of a tuple, one is enough.
        option: An option that it cannot do without; `name:VALUE` gives it.
        section: A section of the side information that it reads; it does for the option.
        shipped: Files of weights that come with its package.
        listed: Whether `concealer_names` lists it.
    """

    make: Callable[..., Concealer]
    needs: tuple[Need, ...]
    option: str | None
    section: str | None
    shipped: tuple[Path, ...]
    listed: bool

    def lacks(self, offers: Collection[type]) -> Need | None:
        """The first kind of records that it needs and does not find; None if all are there."""
        return next((need for need in self.needs if not set(_kinds(need)) & set(offers)), None)


_KNOWN: dict[str, Registration] = {}


def register_concealer(
    name: str,
    *,
    needs: Sequence[Need] = (),
    option: str | None = None,
    section: str | None = None,
    shipped: Sequence[Path] = (),
    listed: bool = True,
) -> Callable[[Factory], Factory]:
    """Registers a class or function that makes concealers from keyword options; used as a decorator.

    Args:
        name: Its name.
        needs: Kinds of records that it looks at beside places, sizes and what arrived: of elements (`Anchors`,
            `Splats`), or of what is said of them (`Partial.said`). Of a tuple of kinds one is enough.
        option: An option that it cannot do without, such as a file of weights; `name:VALUE` gives it.
        section: A section of the side information that it reads, and cannot do without unless it has its option.
        shipped: The package's files of weights that it reads.
        listed: Whether `concealer_names` lists it.

    Raises:
        InvalidValueError: If another concealer has that name.
    """

    def register(factory: Factory) -> Factory:
        there = _KNOWN.get(name)
        if there is not None and _home(there.make) != _home(factory):
            raise InvalidValueError(f"two concealers are called '{name}': {_home(there.make)} and {_home(factory)}")
        _KNOWN[name] = Registration(factory, tuple(needs), option, section, tuple(shipped), listed)
        return factory

    return register


def concealer_names(sections: Iterable[str] = (), offers: Collection[type] | None = None) -> tuple[str, ...]:
    """Names of all concealers that work as they are: those of this package first, then those of others.

    One whose package cannot be loaded is left out, with a line in the log.

    Args:
        sections: Named sections that the stream has; concealers that read another one are not listed.
        offers: Kinds of records that a concealer finds (`Partial.offers`, `Schema.offers`); None for all.
    """
    _load_all()
    there = {None, *sections}
    return tuple(
        name
        for name, known in _KNOWN.items()
        if known.listed
        and (offers is None or known.lacks(offers) is None)
        and known.section in there
        and (known.option is None or known.section is not None)  # a section does for the option
    )


def check_needs(method: Concealer, partial: Partial) -> None:
    """Refuses a registered concealer that does not find what it needs.

    Raises:
        InvalidValueError: If it does not; the message names those that do.
    """
    known = next((known for known in _KNOWN.values() if known.make is type(method)), None)
    need = None if known is None else known.lacks(partial.offers)
    if need is not None:
        able = ", ".join(concealer_names(partial.sections, partial.offers))
        words = " or ".join(kind.__name__ for kind in _kinds(need))
        what = f"concealer '{method.name}' needs {words}, which this stream of {partial.scene.ELEMENTS} has not"
        raise InvalidValueError(f"{what}: {able} work")


def why_unfit(
    name: str, offers: Collection[type], sections: Iterable[str], options: Mapping[str, Any] | None = None
) -> str:
    """Reason why a concealer cannot work on a stream, known without decoding it; empty if it can.

    Args:
        name: Its name, or `name:FILE`.
        offers: Kinds of records that it finds there (`Schema.offers`).
        sections: Named sections of the side information.
        options: Its options.

    Raises:
        UnknownNameError: No concealer has that name.
    """
    base, colon, _ = name.partition(":")
    known = _registered(base)
    need = known.lacks(offers)
    if need is not None:
        return f"concealer '{base}' needs {' or '.join(kind.__name__ for kind in _kinds(need))}, which it has not"
    given = colon or known.option in (options or {})
    if known.section is not None and known.section not in sections and not given:
        return f"concealer '{base}' reads the section '{known.section}', which it has not (splatwire calibrate adds it)"
    return ""


def concealer_sections() -> dict[str, str]:
    """The section of the side information that a concealer reads, by its name, for those that read one."""
    _load_all()
    return {name: known.section for name, known in _KNOWN.items() if known.section is not None}


def concealer_files(name: str, options: Mapping[str, Any]) -> tuple[Path, ...]:
    """The files that what a concealer does depends on: those that come with it, and those that its options name.

    Args:
        name: Its name, or `name:FILE`.
        options: Its options.

    Raises:
        UnknownNameError: No concealer has that name.
    """
    name, _, value = name.partition(":")
    given = [Path(word) for word in (value, *options.values()) if isinstance(word, str | Path) and word]
    return (*_registered(name).shipped, *(path for path in given if path.is_file()))


def concealer_package(name: str) -> tuple[str, ...]:
    """The package that brings a concealer, with its version; empty for those that come with this one."""
    points = entry_points(group=GROUP, name=name.partition(":")[0])
    return tuple(f"{point.dist.name} {point.dist.version}" for point in points if point.dist and _foreign(point))


def create_concealer(name: str, **options: Any) -> Concealer:
    """Makes a concealer.

    Args:
        name: One of `concealer_names()`, or `gnn:FILE` for one that needs something.
        options: Fields of that concealer; defaults where absent.

    Raises:
        UnknownNameError: No concealer has that name.
        InvalidValueError: It has no such option, the value makes no sense, or the package that brings it is broken.
    """
    if not isinstance(name, str):
        raise InvalidValueError(f"expected the name of a concealer such as 'grow', not {type(name).__name__}")
    name, colon, value = name.partition(":")
    known = _registered(name)
    if colon:
        if known.option is None:
            raise InvalidValueError(f"concealer '{name}' takes nothing behind a colon, and was given {value!r}")
        options = {known.option: value, **options}
    try:
        return known.make(**options)
    except TypeError as error:
        raise InvalidValueError(f"concealer '{name}' does not take these options: {error}") from error


def _registered(name: str) -> Registration:
    if name not in _KNOWN:
        for point in entry_points(group=GROUP, name=name):
            _load(point)
    if name not in _KNOWN:
        raise UnknownNameError("concealer", name, {*_KNOWN, *(point.name for point in entry_points(group=GROUP))})
    return _KNOWN[name]


def _load_all() -> None:
    for point in entry_points(group=GROUP):
        if point.name not in _KNOWN:
            try:
                _load(point)
            except InvalidValueError as error:
                _LOG.warning("%s", error)


def _load(point: EntryPoint) -> None:
    package = point.dist.name if point.dist else "an installed package"
    try:
        point.load()
    except Exception as error:  # whatever the code of another package raises
        how = how_to_install(error.name) if isinstance(error, ModuleNotFoundError) else None
        reason = f"concealer '{point.name}' of {package} cannot be loaded: {how or error}"
        raise InvalidValueError(reason) from error
    if point.name not in _KNOWN:
        raise InvalidValueError(f"{package} announces concealer '{point.name}' and does not register it")


def _kinds(need: Need) -> tuple[type, ...]:
    return need if isinstance(need, tuple) else (need,)


def _foreign(point: EntryPoint) -> bool:
    return point.dist is None or point.dist.name != _HOUSE


def _home(factory: Callable[..., Concealer]) -> str:
    return f"{factory.__module__}.{getattr(factory, '__qualname__', repr(factory))}"
