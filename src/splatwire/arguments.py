"""Checks of the arguments of public functions and constructors against their annotations.

`checked` decorates a function; a dataclass derives from `CheckedFields`. A wrong argument raises an `InvalidValueError`
that names it.
"""

import dataclasses
import functools
import inspect
import itertools
from collections.abc import Callable, Iterable
from typing import Any, ParamSpec, TypeVar

import numpy as np

from splatwire.annotation_rules import READERS, Rule, annotation_of, array_like_rule, array_rule, rule_of
from splatwire.errors import InvalidValueError, check_kind, shown, whole_number

P = ParamSpec("P")
R = TypeVar("R")

MAX_THREADS = 1024
"""Maximum number of threads that a function accepts."""
_NUM_ITEMS = 1000
"""Maximum number of items of a wrong list that are examined for the types in a message."""
_VARIADIC = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator for public functions: checks and converts the arguments according to their type annotations.

    Where an annotation requires it, NumPy integers become `int`, text becomes `Path`, and lists become tuples.
    """
    return checked_except()(function)


def checked_except(*excepted: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Returns a decorator that checks and converts a function's arguments by annotation, except for some parameters.

    Args:
        *excepted: Names of the parameters that are passed on unchanged, because the decorated function checks them
            itself.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        return _checking(function, excepted)

    return decorate


def _checking(function: Callable[P, R], excepted: tuple[str, ...]) -> Callable[P, R]:
    @functools.cache
    def known() -> tuple[list[str], dict[str, Rule]]:
        """Returns the parameter names of the decorated function, and the type check of each checked parameter."""
        # Built at the first call, because annotations may name classes that are defined later.
        parameters = inspect.signature(function).parameters.values()
        names = [parameter.name for parameter in parameters if parameter.kind not in _VARIADIC]
        return names, _rules(function, [name for name in names if name not in excepted], arrays=array_like_rule)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        names, rules = known()
        positional: list[Any] = []
        for name, value in zip(names, args, strict=False):
            rule = rules.get(name)
            positional.append(value if rule is None else _check(rule, value, name))
        if len(args) > len(names):  # too many arguments, or those of `*args`
            positional.extend(args[len(names) :])
        for name, value in kwargs.items():
            if (rule := rules.get(name)) is not None:
                kwargs[name] = _check(rule, value, name)
        return function(*positional, **kwargs)

    return call


def check_fields(record: Any) -> None:
    """Checks and converts the fields of a dataclass instance by annotation.

    Call this function in `__post_init__`.

    Raises:
        InvalidValueError: If a field has another type; the message names the field and what it accepts.
    """
    kind: Any = type(record)
    extents: dict[str, int] = {}
    for name, rule in _rules_of_fields(kind).items():
        value = getattr(record, name)
        checked = _check(rule, value, name, kind.__name__)
        if checked is not value:
            object.__setattr__(record, name, checked)
        if rule.dims and value is not None:
            for dim, extent in zip(rule.dims, value.shape, strict=True):
                if extent != (int(dim) if dim.isdigit() else extents.setdefault(dim, extent)):
                    fits = f" ({dim} = {extents[dim]})" if dim in extents else ""
                    raise InvalidValueError(
                        f"{kind.__name__}.{name}: expected {rule.expected}, not {shown(value)}{fits}"
                    )


class CheckedFields:
    """Base class of dataclasses that check the types of their fields."""

    def __post_init__(self) -> None:
        check_fields(self)


@functools.cache
def _rules_of_fields(kind: Any) -> dict[str, Rule]:
    names = [field.name for field in dataclasses.fields(kind) if field.init]
    return _rules(kind, names, arrays=array_rule)


def _rules(owner: Any, names: list[str], arrays: Callable[[Any], Rule]) -> dict[str, Rule]:
    """Builds a check for each annotated parameter of a function, or each annotated field of a dataclass.

    Args:
        owner: The function or the dataclass.
        names: Names of the parameters or fields.
        arrays: Function that builds the check for an array annotation.

    Returns:
        Check of each parameter or field, by name. Parameters and fields whose annotation accepts every value are
        omitted.
    """
    rules = {}
    for name in names:
        hint = annotation_of(owner, name)
        rule = rule_of(hint, arrays)
        if rule.expected:
            rules[name] = rule
    return rules


def _check(rule: Rule, value: Any, name: str, owner: str = "") -> Any:
    if rule.accepts(value):
        return value if rule.convert is None else rule.convert(value)
    where = f"{owner}.{name}" if owner else name
    if rule.kind is not None and (reader := READERS.get(rule.kind.__name__)) is not None:
        check_kind(value, rule.kind, reader, where)
    raise InvalidValueError(f"{where}: expected {rule.expected}, not {_shown_with_items(value)}")


def _shown_with_items(value: Any) -> str:
    """Describes a wrong argument for a message; for a list, tuple or dictionary, with the types of its items."""
    if not isinstance(value, list | tuple | dict) or not value:
        return shown(value)
    text = f"{shown(value)} of {_type_names(value.values() if isinstance(value, dict) else value)}"
    return f"{text} by {_type_names(value)}" if isinstance(value, dict) else text


def _type_names(values: Iterable[Any]) -> str:
    """Returns the names of up to three types of items."""
    names = (type(value).__name__ for value in itertools.islice(values, _NUM_ITEMS))
    return ", ".join(list(dict.fromkeys(names))[:3])


def array_of(
    value: Any, name: str, shape: tuple[int | str, ...] | None, kind: str = "f", least: float | int | None = None,
    most: float | int | None = None,
) -> np.ndarray:  # fmt: skip
    """Converts an argument to an array, and checks its type, shape and range.

    Args:
        value: An array, a torch tensor, a list of them, or nested lists of numbers.
        name: Name of the argument, for the error message.
        shape: Expected shape: the size of each axis, or a letter for any size. None for any shape.
        kind: Expected type: `f` for numbers that are not NaN, `i` for whole numbers, `b` for True and False.
        least: Minimum value; None for no minimum.
        most: Maximum value; None for no maximum.

    Returns:
        The array. Its dtype is not converted.

    Raises:
        InvalidValueError: If the value is not such an array; the message names what is expected.
    """
    words = {"f": "numbers", "i": "whole numbers", "b": "True and False"}[kind]
    limits = "" if least is None or most is None else f" from {least:g} to {most:g}"
    extents = "" if shape is None else f" ({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
    expected = f"{name}: expected an array{extents} of {words}{limits}"
    try:
        array = np.asarray([_numbers(item) for item in value] if isinstance(value, list | tuple) else _numbers(value))
    except (TypeError, ValueError, RuntimeError) as error:
        raise InvalidValueError(f"{expected}, not {shown(value)}") from error
    fits = shape is None or (
        len(array.shape) == len(shape)
        and all(isinstance(extent, str) or extent == size for extent, size in zip(shape, array.shape, strict=True))
    )
    if not fits or array.dtype.kind not in {"f": "fiu", "i": "iu", "b": "b"}[kind]:
        raise InvalidValueError(f"{expected}, not {shown(array)}")
    if array.size and (least is not None or most is not None):
        low, high = array.min(), array.max()  # NaN if one value is
        if not ((least is None or low >= least) and (most is None or high <= most)):
            raise InvalidValueError(f"{expected}, not {low:.4g} to {high:.4g}")
    return array


def _numbers(value: Any) -> Any:
    """Returns the array of a torch tensor on any device, without gradients; any other value unchanged."""
    return np.asarray(value.detach().cpu()) if hasattr(value, "detach") else value


def check_threads(threads: int | None) -> None:
    """Checks a number of threads; None means one per processor.

    Raises:
        InvalidValueError: If the argument is neither None nor a whole number from 0 to `MAX_THREADS`.
    """
    if threads is not None:
        whole_number(threads, "threads", 0, MAX_THREADS)
