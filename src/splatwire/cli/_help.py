"""Help texts of options for `--help`: the docstring of each option's field as one paragraph."""

import dataclasses
import functools
import inspect
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import docstring_parser
import tyro

_NAMES = {"kind": "FORMAT", "model_dir": "MODEL"}
"""Names of positional arguments in help texts, by field, if they differ from the field's name in capitals."""


@functools.cache
def set_help_texts(settings: type) -> None:
    """Sets the help text of each command-line option from the docstring of its field.

    A positional argument is shown by the name of its field in capitals, such as STREAM, or `STREAM [STREAM ...]`.

    Args:
        settings: A dataclass with a docstring for each field.
    """
    # tyro alone would keep the line breaks of docstrings, which do not fit the terminal width, and would print defaults
    # that are None.
    for owner in settings.__mro__[:-1]:
        texts = {entry.arg_name: entry.description for entry in docstring_parser.parse_from_object(owner).params}
        own_annotations, kinds = inspect.get_annotations(owner), typing.get_type_hints(owner, include_extras=True)
        for name in own_annotations:
            nested = list(_dataclasses_in(kinds[name]))
            for part in nested:
                set_help_texts(part)
            if not nested and (text := texts.get(name)):
                shown = _shown_positional(name, kinds[name], optional=hasattr(owner, name))
                helped = tyro.conf.arg(help=" ".join(text.split()), help_behavior_hint=_default, metavar=shown)
                owner.__annotations__[name] = Annotated[kinds[name], helped]


def _dataclasses_in(kind: Any) -> Iterator[type]:
    if isinstance(kind, type):
        yield from (kind,) if dataclasses.is_dataclass(kind) else ()
    else:
        for part in typing.get_args(kind):
            yield from _dataclasses_in(part)


def _shown_positional(name: str, kind: Any, *, optional: bool) -> str | None:
    """Returns how help texts show a positional argument; None for options, and for arguments with a list of choices.

    Args:
        name: Name of the field.
        kind: Type of the field, with its annotations.
        optional: True if the argument may be absent.
    """
    base, *marks = typing.get_args(kind) or (kind,)
    if not any(mark in marks for mark in typing.get_args(tyro.conf.Positional[str])[1:]):
        return None
    word = _NAMES.get(name, name.upper())
    if base in (str, Path):
        return f"[{word}]" if optional else word
    if typing.get_origin(base) in (tuple, list):
        word = word.removesuffix("S")
        return f"[{word} ...]" if optional else f"{word} [{word} ...]"
    return None


def _default(value: str) -> str:
    # True is the default of a flag that is shown as `--no-NAME`, so that it would contradict the name.
    return "" if value in ("None", "", "''", "True") else f"(default: {value})"
