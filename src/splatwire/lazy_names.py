"""Import of a package's public names on first use, and support for deprecated attribute names."""

import importlib
import re
import sys
import warnings
from collections.abc import Callable, Mapping
from typing import Any

from splatwire.errors import how_to_install

_IMPORT = re.compile(r"^from (\S+) import (\w+)", re.MULTILINE)


def lazy_names(
    package: str, file: str, renamed: Mapping[str, str] | None = None
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Returns `__all__`, `__getattr__` and `__dir__` of a package that imports its public names on first use (PEP 562).

    Args:
        package: The full name of the package.
        file: Path of the package's `__init__.py`.
        renamed: Current name of each deprecated name.
    """
    with open(f"{file.removesuffix('.py')}.pyi", encoding="utf-8") as stub:
        homes = {name: home for home, name in _IMPORT.findall(stub.read())}

    def get(name: str) -> Any:
        if renamed and name in renamed:
            text = f"{package}.{name} is deprecated, use {package}.{renamed[name]}"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            return get(renamed[name])
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        try:
            value = getattr(importlib.import_module(homes[name]), name)
        except ModuleNotFoundError as error:
            if how := how_to_install(error.name):
                error.add_note(how)
            raise
        setattr(sys.modules[package], name, value)
        return value

    return list(homes), get, lambda: sorted(homes)


def renamed_attributes(owner: str, renamed: Mapping[str, str]) -> Callable[[Any, str], Any]:
    """Returns a `__getattr__` for a class; for a deprecated attribute, it warns and returns the current attribute.

    Args:
        owner: Name of the class, for messages.
        renamed: Current name of each deprecated attribute.
    """

    def get(record: Any, name: str) -> Any:
        if name not in renamed:
            raise AttributeError(f"'{owner}' object has no attribute '{name}'")
        warnings.warn(f"{owner}.{name} is deprecated, use {renamed[name]}", DeprecationWarning, stacklevel=2)
        return getattr(record, renamed[name])

    return get
