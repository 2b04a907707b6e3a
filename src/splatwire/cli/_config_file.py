"""Configuration file of `splatwire serve`: a TOML file whose keys are the names of the options."""

import dataclasses
import difflib
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, get_type_hints

from splatwire.errors import InvalidValueError
from splatwire.files.read_limited import read_limited

OPTION = "config"
"""Name of the option with the path of the configuration file."""
MAX_BYTES = 1 << 20
"""Maximum size of a configuration file, bytes."""


def config_path(words: Sequence[str]) -> Path | None:
    """Returns the value of the option `--config` among command-line arguments; None without this option."""
    for index, word in enumerate(words):
        name, equals, value = word.partition("=")
        if name == f"--{OPTION}":
            return Path(value) if equals else Path(words[index + 1]) if index + 1 < len(words) else None
    return None


def words_of_file(path: Path, settings: type, positional: str, former: Iterable[str] = ()) -> list[str]:
    """Converts a configuration file to the command-line arguments with the same meaning.

    Args:
        path: TOML file. A key is the name of an option, with dashes or underscores; a flag is true or false, and an
            option with several values is a list.
        settings: Options class of the subcommand.
        positional: Name of the positional argument, which has several values.
        former: Former names of options. They are also accepted as keys, and are not replaced by the current names.

    Raises:
        InvalidValueError: If the file is missing or is not TOML, a key is not an option, or a value has the wrong type.
    """
    names = {*_names(settings), *(name.replace("-", "_") for name in former)} - {OPTION}
    first, options = list[str](), list[str]()
    for key, value in _content(path).items():
        name = key.replace("-", "_")
        if name not in names:
            similar = difflib.get_close_matches(name, names, n=1)
            hint = f"; is it '{similar[0].replace('_', '-')}'?" if similar else ""
            raise InvalidValueError(f"{path}: '{key}' is no option of this verb{hint}")
        if name == positional:
            first = _option_words(path, key, value)
        elif isinstance(value, bool):
            options += [f"--{name.replace('_', '-')}"] * value
        elif value != []:
            options += [f"--{name.replace('_', '-')}", *_option_words(path, key, value)]
    return [*first, *options]


def without_flags(options: Any) -> Any:
    """Returns a copy of the options of a configuration file in which all flags (boolean options) are off."""
    # The copy provides the defaults for parsing the command line, because a flag that is on by default would be called
    # `--no-NAME`. After parsing, `with_flags` sets the flags of the file again.
    off = {field.name: False for field in dataclasses.fields(options) if getattr(options, field.name) is True}
    nested = {
        field.name: without_flags(getattr(options, field.name))
        for field in dataclasses.fields(options)
        if dataclasses.is_dataclass(getattr(options, field.name))
    }
    return dataclasses.replace(options, **off, **nested)


def with_flags(options: Any, configured: Any) -> Any:
    """Combines the flags (boolean options) of command line and configuration file: a flag set in either is on.

    Args:
        options: Options from the command line.
        configured: Options from the configuration file.

    Returns:
        The options with the combined flags.
    """
    on = {field.name: True for field in dataclasses.fields(options) if getattr(configured, field.name) is True}
    nested = {
        field.name: with_flags(getattr(options, field.name), getattr(configured, field.name))
        for field in dataclasses.fields(options)
        if dataclasses.is_dataclass(getattr(options, field.name))
    }
    return dataclasses.replace(options, **on, **nested)


def _names(settings: type) -> Iterator[str]:
    kinds = get_type_hints(settings)
    for field in dataclasses.fields(settings):
        if dataclasses.is_dataclass(kinds[field.name]):
            yield from _names(kinds[field.name])
        else:
            yield field.name


def _content(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_limited(path, MAX_BYTES, InvalidValueError).decode())
    except OSError as error:
        raise InvalidValueError(f"--{OPTION} {path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InvalidValueError(f"{path}: is no TOML file: {error}") from error


def _option_words(path: Path, key: str, value: object) -> list[str]:
    """Returns the command-line arguments for an option's value in a configuration file.

    Args:
        path: The configuration file, for error messages.
        key: Name of the option, for error messages.
        value: A text, a number, or a list of them.
    """
    values = value if isinstance(value, list) else [value]
    for one in values:
        if isinstance(one, bool) or not isinstance(one, (str, int, float)):
            raise InvalidValueError(f"{path}: '{key}' is text, a number, true or false, or a list of texts or numbers")
        if "\0" in str(one):
            raise InvalidValueError(f"{path}: the value of '{key}' contains a zero byte")
    return [str(one) for one in values]
