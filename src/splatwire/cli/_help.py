"""Help texts of options for `--help`: the docstring of each option's field as one paragraph."""

import dataclasses
import functools
import inspect
import typing
from collections.abc import Iterator
from typing import Annotated, Any

import docstring_parser
import tyro


@functools.cache
def set_help_texts(settings: type) -> None:
    """Sets the help text of each command-line option from the docstring of its field.

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
                helped = tyro.conf.arg(help=" ".join(text.split()), help_behavior_hint=_default)
                owner.__annotations__[name] = Annotated[kinds[name], helped]


def _dataclasses_in(kind: Any) -> Iterator[type]:
    if isinstance(kind, type):
        yield from (kind,) if dataclasses.is_dataclass(kind) else ()
    else:
        for part in typing.get_args(kind):
            yield from _dataclasses_in(part)


def _default(value: str) -> str:
    return "" if value in ("None", "") else f"(default: {value})"
