"""Registry of concealers for static scenes and sequences, open to installed packages (docs/your-own-concealer.md).

A package announces a concealer under the entry-point group `splatwire.concealers`. A name may refer to one concealer
for static scenes and one for sequences.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from splatwire.arguments import checked
from splatwire.concealment.base import Concealer
from splatwire.errors import InvalidValueError, UnknownNameError
from splatwire.plugins import Registry, source_of
from splatwire.types import ReceivedScene

GROUP = "splatwire.concealers"
"""Entry-point group of concealers."""
Need: TypeAlias = type | tuple[type, ...]
Factory = TypeVar("Factory", bound=Callable[..., Any])


@dataclass(frozen=True)
class Registration:
    """Properties of a registered concealer, known before it is created.

    Attributes:
        make: Function that creates the concealer from keyword options.
        needs: Types of elements or side information that the concealer requires; a tuple lists alternatives.
        option: Name of the option that the concealer requires; None if it requires no option. Users set its value by
            `name:VALUE`, where `name` is the name of the concealer.
        section: Name of the side information section that the concealer reads; None if it reads none. If a stream has
            this section, the option is not required.
        shipped: Network weight files in the package of the concealer.
        listed: True if `concealer_names` lists it.
    """

    make: Callable[..., Any]
    needs: tuple[Need, ...]
    option: str | None
    section: str | None
    shipped: tuple[Path, ...]
    listed: bool

    def missing_need(self, provides: Collection[type]) -> Need | None:
        """Returns a type that the concealer requires but the stream does not contain; None if nothing is missing.

        Args:
            provides: Types of the stream's elements and side information.
        """
        return next((need for need in self.needs if not set(_kinds(need)) & set(provides)), None)


@dataclass(frozen=True)
class NamedConcealers:
    """Concealers registered under one name: one for static scenes, one for sequences, or both.

    Attributes:
        static: Concealer for static scenes; None if there is none.
        temporal: Concealer for sequences; None if there is none.
    """

    static: Registration | None = None
    temporal: Registration | None = None


CONCEALERS: Registry[NamedConcealers] = Registry("concealer", GROUP)


def register_concealer(
    name: str,
    *,
    needs: Sequence[Need] = (),
    option: str | None = None,
    section: str | None = None,
    shipped: Sequence[Path] = (),
    listed: bool = True,
    temporal: bool = False,
) -> Callable[[Factory], Factory]:
    """Registers a concealer factory (class or function with keyword options); used as a decorator.

    Args:
        name: Name of the concealer.
        needs: Types that the concealer requires: element types (`Anchors`, `Splats`), or types of side information
            (`ReceivedScene.records`). A tuple lists alternatives.
        option: Name of a required option, such as a weights file, which users set by `name:VALUE`.
        section: Name of the side information section that the concealer reads; None if it reads none. If a stream has
            this section, the option is not required.
        shipped: Network weight files that the concealer reads; they belong to the same Python package.
        listed: True to include the concealer in the result of `concealer_names`.
        temporal: True for sequences, False for static scenes.

    Raises:
        InvalidValueError: If the name is taken by another concealer of that kind.
    """

    def register(factory: Factory) -> Factory:
        if not callable(factory):
            raise InvalidValueError(f"concealer '{name}' is a {type(factory).__name__}, not a class or function")
        registration = Registration(factory, tuple(needs), option, section, tuple(shipped), listed)
        existing = CONCEALERS.registered().get(name, NamedConcealers())
        other = existing.temporal if temporal else existing.static
        if other is not None:
            CONCEALERS.check_free(name, source_of(other.make), source_of(factory))
        both = replace(existing, temporal=registration) if temporal else replace(existing, static=registration)
        CONCEALERS.put(name, both, source_of(factory))
        return factory

    return register


@checked
def concealer_names(sections: Iterable[str] = (), provides: Collection[type] | None = None) -> tuple[str, ...]:
    """Returns the names of the concealers of static scenes that can be used for a stream, built-in ones first.

    Args:
        sections: Names of the sections in the stream's side information.
        provides: Types of elements and side information in the stream. If None, the types are unknown, and concealers
            for all types are listed.
    """
    available = {None, *sections}
    return tuple(
        name
        for name, registration in _static_concealers().items()
        if registration.listed
        and (provides is None or registration.missing_need(provides) is None)
        and registration.section in available
        and (registration.option is None or registration.section is not None)  # a section replaces the option
    )


def temporal_names() -> tuple[str, ...]:
    """Returns the names of the concealers of sequences that need no option, built-in ones first."""
    registrations = {name: named.temporal for name, named in CONCEALERS.all().items() if named.temporal is not None}
    return tuple(
        name for name, registration in registrations.items() if registration.listed and registration.option is None
    )


def check_needs(method: Concealer, received: ReceivedScene) -> None:
    """Checks that a received scene has the side information that a registered concealer needs.

    Args:
        method: The concealer.
        received: The received scene.

    Raises:
        InvalidValueError: If side information is missing; the message names usable concealers.
    """
    registered = (named.static for named in CONCEALERS.registered().values())
    registration = next((entry for entry in registered if entry is not None and entry.make is type(method)), None)
    need = None if registration is None else registration.missing_need(received.provides)
    if need is not None:
        usable = ", ".join(concealer_names(received.sections, received.provides))
        types = " or ".join(kind.__name__ for kind in _kinds(need))
        raise InvalidValueError(
            f"concealer '{method.name}' needs {types}, which this stream of {received.scene.ELEMENTS} does not have: "
            f"use {usable}"
        )


def why_unfit(
    name: str, provides: Collection[type], sections: Iterable[str], options: Mapping[str, Any] | None = None
) -> str:
    """Returns why a concealer cannot conceal losses of a given stream; an empty text if it can.

    Args:
        name: Name of the concealer, or `name:FILE`.
        provides: Types of elements and side information in the stream.
        sections: Named sections of the side information.
        options: Options of the concealer.

    Raises:
        UnknownNameError: If no concealer has that name.
    """
    base, colon, _ = name.partition(":")
    registration = _registered(base)
    need = registration.missing_need(provides)
    if need is not None:
        types = " or ".join(kind.__name__ for kind in _kinds(need))
        return f"concealer '{base}' needs {types}, which the stream does not have"
    is_given = colon or registration.option in (options or {})
    if registration.section is not None and registration.section not in sections and not is_given:
        section = f"the section '{registration.section}', which the stream does not have (splatwire calibrate adds it)"
        return f"concealer '{base}' reads {section}"
    return ""


def concealer_sections() -> dict[str, str]:
    """Returns the side information section that each concealer reads, by name of the concealer."""
    return {
        name: registration.section
        for name, registration in _static_concealers().items()
        if registration.section is not None
    }


def concealer_files(name: str, options: Mapping[str, Any]) -> tuple[Path, ...]:
    """Returns the files that influence a concealer's output: shipped network weights, and files given as options.

    Args:
        name: Name of the concealer, or `name:FILE`.
        options: Options of the concealer.

    Raises:
        UnknownNameError: If no concealer has that name.
    """
    name, _, value = name.partition(":")
    given_paths = [Path(word) for word in (value, *options.values()) if isinstance(word, str | Path) and word]
    named = CONCEALERS[name]
    shipped = [
        path
        for registration in (named.static, named.temporal)
        if registration is not None
        for path in registration.shipped
    ]
    return (*shipped, *(path for path in given_paths if path.is_file()))


def concealer_package(name: str) -> tuple[str, ...]:
    """Returns name and version of the installed package that provides a concealer; empty for built-in concealers."""
    return CONCEALERS.packages(name.partition(":")[0])


def create_concealer(name: str, **options: Any) -> Concealer:
    """Creates a concealer of static scenes.

    Args:
        name: One of `concealer_names()`, or e.g. `gnn:FILE` for a concealer with a required option.
        options: Options of that concealer; defaults apply to missing ones.

    Raises:
        UnknownNameError: If no concealer has that name.
        InvalidValueError: If an option is unknown or invalid, or the providing package is broken.
    """
    if not isinstance(name, str):
        raise InvalidValueError(f"expected the name of a concealer such as 'grow', not {type(name).__name__}")
    concealer: Concealer = create(name, _registered(name.partition(":")[0]), Concealer, options)
    return concealer


def create(name: str, registration: Registration, protocol: type, options: Mapping[str, Any]) -> Any:
    """Creates a concealer for static scenes or for sequences.

    Args:
        name: Name of the concealer, or `name:VALUE` with its required option.
        registration: Registered properties of the concealer.
        protocol: Typing protocol (structural type) that the result must implement.
        options: Options of that concealer; defaults apply to missing ones.

    Raises:
        InvalidValueError: If an option is unknown or invalid, or the result does not implement the protocol.
    """
    name, colon, value = name.partition(":")
    if colon:
        if registration.option is None:
            raise InvalidValueError(f"concealer '{name}' takes no value after a colon, and was given {value!r}")
        options = {registration.option: value, **options}
    try:
        concealer = registration.make(**options)
    except TypeError as error:
        raise InvalidValueError(f"concealer '{name}' does not take these options: {error}") from error
    if not isinstance(concealer, protocol):
        absent = [member for member in sorted(_members(protocol)) if not hasattr(concealer, member)]
        problem = f"has no {', '.join(absent)}" if absent else "cannot be called"
        raise InvalidValueError(f"concealer '{name}'{CONCEALERS.provider_suffix(name)} is no concealer: it {problem}")
    return concealer


def find_temporal(name: str) -> Registration:
    """Returns the registration of a concealer of sequences.

    Raises:
        UnknownNameError: If no concealer of sequences has that name.
        InvalidValueError: If the providing package is broken.
    """
    named = CONCEALERS.find(name)
    if named is None or named.temporal is None:
        raise UnknownNameError("concealer of clips", name, temporal_names())
    return named.temporal


def _registered(name: str) -> Registration:
    named = CONCEALERS[name]
    if named.static is None:
        raise UnknownNameError("concealer of still scenes", name, _static_concealers())
    return named.static


def _static_concealers() -> dict[str, Registration]:
    """Returns the registered concealers of static scenes, by name."""
    return {name: named.static for name, named in CONCEALERS.all().items() if named.static is not None}


def _members(protocol: type) -> set[str]:
    """Returns the names of the public attributes of a protocol."""
    return {word for word in (*vars(protocol), *getattr(protocol, "__annotations__", {})) if not word.startswith("_")}


def _kinds(need: Need) -> tuple[type, ...]:
    return need if isinstance(need, tuple) else (need,)
