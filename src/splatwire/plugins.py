"""Registries that installed packages extend: concealers, schemas, loss models, file formats and metrics.

A package announces its entries by entry points (`importlib.metadata`); loading one calls `Registry.register`.
"""

import functools
import logging
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Generic, TypeVar

from splatwire.errors import InvalidValueError, UnknownNameError, how_to_install

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

_OWN = "splatwire"
_LOG = logging.getLogger(__name__)
Entry = TypeVar("Entry")


class Registry(Generic[Entry]):
    """Entries of one kind by name, such as all loss models, in the order of their registration.

    Installed packages announce their entries as entry points in the package metadata.

    Args:
        kind: Name of the kind of entry for messages, such as `loss model`.
        group: Name of the group of entry points for this kind of entry.
    """

    def __init__(self, kind: str, group: str) -> None:
        self.kind, self.group = kind, group
        self._entries: dict[str, Entry] = {}
        self._sources: dict[str, str] = {}
        self._loaded: list[EntryPoint] = []
        self._warned: set[str] = set()

    def register(self, name: str, entry: Entry, source: str) -> None:
        """Adds an entry under a name.

        Args:
            name: Name of the entry, not empty, without `:` and `,`.
            entry: The entry.
            source: Full dotted name of the class or function that defines the entry.

        Raises:
            InvalidValueError: If the name is invalid, or another source has registered it.
        """
        self.check_free(name, self._sources.get(name, source), source)
        self.put(name, entry, source)

    def put(self, name: str, entry: Entry, source: str) -> None:
        """Adds an entry, or replaces the entry of the same name.

        Raises:
            InvalidValueError: If the name is invalid.
        """
        if not isinstance(name, str) or not name or name != name.strip() or {":", ","} & set(name):
            raise InvalidValueError(f"{source}: {name!r} cannot be the name of a {self.kind}")
        self._entries[name], self._sources[name] = entry, source

    def check_free(self, name: str, other: str, source: str) -> None:
        """Checks that a new entry may replace an existing entry of the same name.

        An entry may be replaced by one with the same source. An entry of another package may also be replaced by an
        entry of splatwire itself; a warning is then logged.

        Args:
            name: Name of both entries.
            other: Full dotted name of the class or function that defines the existing entry (its source).
            source: Full dotted name of the class or function that defines the new entry.

        Raises:
            InvalidValueError: If the new entry may not replace the existing one.
        """
        if other == source:
            return
        text = f"two {self.kind}s are called '{name}': {other} and {source}"
        if not source.startswith(f"{_OWN}.") or other.startswith(f"{_OWN}."):
            raise InvalidValueError(text)
        self._warn(f"{text}, which is kept")

    def find(self, name: str) -> Entry | None:
        """Returns the entry with a given name; None if no installed package has such an entry.

        If the entry is not registered yet, the package that announces it is loaded.

        Raises:
            InvalidValueError: If the package that announces the entry cannot be loaded or does not register the entry,
                or if several packages announce the name.
        """
        if name not in self._entries and (points := [point for point in self._announced() if point.name == name]):
            self._load(self._chosen(name, points))
        return self._entries.get(name)

    def __getitem__(self, name: str) -> Entry:
        """Returns the entry with a given name.

        Raises:
            UnknownNameError: If no installed package has such an entry.
            InvalidValueError: See `find`.
        """
        entry = self.find(name)
        if entry is None:
            raise UnknownNameError(self.kind, name, self.known_names())
        return entry

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self.find(name) is not None

    def registered(self) -> dict[str, Entry]:
        """Returns the registered entries, without looking up entry points."""
        return dict(self._entries)

    def all(self) -> dict[str, Entry]:
        """Loads all installed packages that announce entries of this kind, and returns every entry by name.

        A package that cannot be loaded is skipped, with a warning in the log.
        """
        for point in self._announced():
            try:
                if point.name not in self._entries:
                    others = [other for other in self._announced() if other.name == point.name]
                    self._load(self._chosen(point.name, others))
                elif not self._is_provided_by(point):
                    taken = f"{self._sources[point.name]} has the name, which stays"
                    self._warn(f"{package_of(point)} announces {self.kind} '{point.name}': {taken}")
            except InvalidValueError as error:
                self._warn(str(error))
        return dict(self._entries)

    def known_names(self) -> set[str]:
        """Returns the names of all entries, including those of installed packages that are not loaded yet."""
        return {*self._entries, *(point.name for point in self._announced())}

    def packages(self, name: str) -> tuple[str, ...]:
        """Returns the installed packages that provide an entry, each as a text with its name and version.

        These are the packages that have registered the entry. If it is not registered yet, these are all packages that
        announce it. The result is empty for an entry of splatwire itself.
        """
        points = [point for point in self._announced() if point.name == name and not _is_own(point)]
        points = [point for point in points if name not in self._entries or self._is_provided_by(point)]
        return tuple(f"{point.dist.name} {point.dist.version}" for point in points if point.dist)

    def provider_suffix(self, name: str) -> str:
        """Returns the text ` of PACKAGE` for messages about an entry that another package registered.

        The text is empty for an entry of splatwire.

        Args:
            name: Name of the entry.
        """
        return "".join(f" of {package}" for package in self.packages(name)[:1])

    def _announced(self) -> Iterator["EntryPoint"]:
        yield from _entry_points(self.group, tuple(sys.path))

    def _chosen(self, name: str, points: list["EntryPoint"]) -> "EntryPoint":
        """Selects one of several entry points with the same name; an entry point of splatwire is preferred.

        Raises:
            InvalidValueError: If several packages announce the name, and none of them is splatwire.
        """
        own_points = [point for point in points if _is_own(point)]
        if own_points or len(points) == 1:
            return (own_points or points)[0]
        packages = " and ".join(map(package_of, points))
        raise InvalidValueError(f"{packages} announce a {self.kind} '{name}': uninstall all but one")

    def _load(self, point: "EntryPoint") -> None:
        try:
            point.load()
        except (Exception, SystemExit) as error:  # code of another package may raise anything
            how = how_to_install(error.name) if isinstance(error, ModuleNotFoundError) else None
            reason = how or str(error) or type(error).__name__
            raise InvalidValueError(
                f"{self.kind} '{point.name}' of {package_of(point)} cannot be loaded: {reason}"
            ) from error
        if point.name not in self._entries:
            raise InvalidValueError(
                f"{package_of(point)} announces {self.kind} '{point.name}' and does not register it"
            )
        self._loaded.append(point)

    def _is_provided_by(self, point: "EntryPoint") -> bool:
        """True if the package of an entry point has registered the entry with the entry point's name.

        False if another package has registered its own entry under the same name.

        Args:
            point: The entry point. An entry with its name must already be registered.
        """
        same = self._sources[point.name].partition(".")[0] == point.module.partition(".")[0]
        return same or point in self._loaded

    def _warn(self, text: str) -> None:
        if text not in self._warned:
            self._warned.add(text)
            _LOG.warning("%s", text)


def package_of(point: "EntryPoint") -> str:
    """Returns the name of the installed package that declares an entry point."""
    return point.dist.name if point.dist else "an installed package"


def source_of(defined: object) -> str:
    """Returns the full dotted name of a class or function, for `Registry.register`."""
    return f"{getattr(defined, '__module__', '?')}.{getattr(defined, '__qualname__', repr(defined))}"


def _is_own(point: "EntryPoint") -> bool:
    return point.dist is not None and point.dist.name == _OWN


@functools.cache
def _entry_points(group: str, path: tuple[str, ...]) -> tuple["EntryPoint", ...]:
    """Returns the entry points of a group that installed packages declare.

    The result is cached for each group and import path.

    Args:
        group: Name of the group.
        path: Import path (`sys.path`); only a key of the cache, so that a changed path leads to a new search.
    """
    from importlib.metadata import entry_points  # slow import: a tenth of a command's start time

    return tuple(entry_points(group=group))
