"""Derives checks of arguments from type annotations, for the decorator `splatwire.arguments.checked`."""

import inspect
import operator
import os
import sys
import types
import typing
from collections import abc
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from splatwire.errors import InvalidValueError, shown
from splatwire.files.names import path_of

_MAX_BITS = 128
"""Maximum number of bits of an integer argument. Larger integers are probably errors, and make messages long."""
READERS = {
    "AnchorScene": "open_scene",
    "Cameras": "splatwire.data.load_cameras",
    "Dataset": "splatwire.data.open_dataset",
    "ReceivedScene": "decode_stream",
    "SceneStream": "read_stream",
    "SequenceScene": "decode_stream(...).scene",
    "SplatScene": "open_scene",
    "Splats": "splatwire.io.formats.read_splats",
}
"""For each type, the function or expression that returns an object of the type, for error messages."""
_CONVERTED = ("Scene", "Elements")
"""Annotations that accept every value here, because `splatwire.anchors.appearance.as_scene` converts and checks it."""


class Rule(NamedTuple):
    """Run-time check of a value against one type annotation.

    Attributes:
        expected: Description of accepted values; empty if every value is accepted.
        accepts: Returns True for accepted values.
        convert: Converts an accepted value to the annotated type; None if values are used unchanged.
        kind: The class of accepted values if the annotation is a class such as `Splats`; None for other annotations.
        dims: Size of each array dimension: a number, or a letter for a size that several fields share.
    """

    expected: str
    accepts: Callable[[Any], bool]
    convert: Callable[[Any], Any] | None = None
    kind: type | None = None
    dims: tuple[str, ...] = ()


_ANYTHING = Rule("", lambda value: True)


def annotation_of(owner: Any, name: str) -> Any:
    """Returns the annotation of a parameter or field as a type, or Any if the annotation cannot be evaluated.

    Args:
        owner: The function or class.
        name: Name of the parameter or field.
    """
    homes = [home for home in getattr(owner, "__mro__", (owner,)) if name in vars(home).get("__annotations__", {})]
    home = homes[0] if homes else owner
    hint = inspect.get_annotations(home).get(name, Any)
    if not isinstance(hint, str):
        return hint
    try:
        return eval(hint, vars(sys.modules[home.__module__]))
    except (NameError, SyntaxError, TypeError):
        return Any


def rule_of(hint: Any, arrays: Callable[[Any], Rule]) -> Rule:
    """Translates a type annotation into a rule that checks values at run time.

    Args:
        hint: The annotation as an object, not as text.
        arrays: Function that translates the annotation of an array.
    """
    hint = getattr(hint, "__value__", hint)
    if hint in _PLAIN:
        return _PLAIN[hint]
    if hint is None or hint is type(None):
        return Rule("None", lambda value: value is None)
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is os.PathLike:
        return _PLAIN[os.PathLike]
    if origin in (typing.Union, types.UnionType):
        return _union([rule_of(arg, arrays) for arg in args])
    if origin is typing.Literal:
        return Rule(" or ".join(map(repr, args)), lambda value: isinstance(value, str) and value in args)
    if origin is tuple or hint is tuple:
        return _tuplerule_of(args, arrays)
    if origin is type or hint is type:
        return Rule("a class", lambda value: isinstance(value, type))
    if origin is abc.Callable or hint is abc.Callable:
        return Rule("a function", callable)
    kind = origin if isinstance(origin, type) else hint
    if not isinstance(kind, type):
        return _ANYTHING
    if (hasattr(kind, "dims") and hasattr(kind, "array_type")) or kind.__name__ == "ndarray":
        return arrays(kind)
    if issubclass(kind, abc.Mapping):
        return _mapping_rule(kind, [rule_of(arg, arrays) for arg in args])
    if issubclass(kind, abc.Iterable) and kind.__module__ in ("collections.abc", "builtins"):
        return _items_rule(kind, rule_of(args[0], arrays) if args else _ANYTHING)
    if kind.__name__ in _CONVERTED:
        return _ANYTHING
    if getattr(kind, "_is_protocol", False):
        return _protocol_rule(kind)
    reader = READERS.get(kind.__name__)
    how = "is" if reader and "(" in reader else "returns"
    expected = kind.__name__ + (f" (`{reader}` {how} one)" if reader else "")
    return Rule(expected, lambda value: isinstance(value, kind), kind=kind)


def _union(rules: list[Rule]) -> Rule:
    if _PLAIN[str] in rules and (paths := _PLAIN[os.PathLike]) in rules:
        rules = [rule for rule in rules if rule not in (_PLAIN[str], paths)] + [_PATH]
    if not all(rule.expected for rule in rules):
        return _ANYTHING
    exact = [rule for rule in rules if rule.convert is None]
    loose = [rule for rule in rules if rule.convert is not None]
    kinds = [rule.kind for rule in rules if rule.kind is not None]

    def convert(value: Any) -> Any:
        if not loose or any(rule.accepts(value) for rule in exact):
            return value
        rule = next(rule for rule in loose if rule.accepts(value))
        assert rule.convert is not None
        return rule.convert(value)

    others = any(rule.kind is not None or rule.expected[:2] in ("a ", "an ") for rule in rules)
    words = list(dict.fromkeys("its name" if rule is _PLAIN[str] and others else rule.expected for rule in rules))
    expected = " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
    return Rule(
        expected,
        lambda value: any(rule.accepts(value) for rule in rules),
        convert if loose else None,
        kinds[0] if len(kinds) == 1 and len(rules) == 1 else None,
        next((rule.dims for rule in rules if rule.dims), ()),
    )


def _is_number(value: Any) -> bool:
    """True for real numbers of Python and NumPy except NaN and booleans."""
    if isinstance(value, bool) or not hasattr(value, "__float__") or isinstance(value, complex | str):
        return False
    if getattr(value, "shape", ()) != ():
        return False
    if isinstance(value, int) and value.bit_length() > _MAX_BITS:
        return False
    try:
        return bool(value == value) and float(value) == float(value)
    except (TypeError, ValueError, OverflowError):
        return False


def _is_whole(value: Any) -> bool:
    if type(value) is int:
        return value.bit_length() <= _MAX_BITS
    if isinstance(value, bool) or getattr(value, "shape", ()) != ():
        return False
    try:
        operator.index(value)
    except TypeError:
        return False
    return type(value).__name__ != "bool"


def _is_path(value: Any) -> bool:
    try:
        path_of(value)
    except InvalidValueError:
        return False
    return True


_PATH = Rule("the path of a file or folder", _is_path)
_PLAIN: dict[Any, Rule] = {
    Any: _ANYTHING,
    object: _ANYTHING,
    bool: Rule("True or False", lambda value: isinstance(value, bool) or type(value).__name__ in ("bool", "bool_")),
    int: Rule("a whole number", _is_whole, operator.index),
    float: Rule("a number", _is_number),
    str: Rule("text", lambda value: isinstance(value, str)),
    bytes: Rule("bytes", lambda value: isinstance(value, bytes)),
    Path: Rule("the path of a file or folder", _is_path, path_of),
    os.PathLike: Rule("a path", lambda value: isinstance(value, os.PathLike)),
}


def _tuplerule_of(args: tuple[Any, ...], arrays: Callable[[Any], Rule]) -> Rule:
    if not args:
        return Rule("a tuple", lambda value: isinstance(value, tuple | list), tuple)
    if len(args) == 2 and args[1] is Ellipsis:
        item = rule_of(args[0], arrays)
        return Rule(
            f"a tuple of {_plural(item)}",
            lambda value: isinstance(value, tuple | list) and all(map(item.accepts, value)),
            _as_tuple,
        )
    items = [rule_of(arg, arrays) for arg in args]
    words = {item.expected for item in items}
    expected = (
        f"of {len(items)} {_plural(items[0])}" if len(words) == 1 else f"({', '.join(i.expected for i in items)})"
    )
    return Rule(
        f"a tuple {expected}",
        lambda value: (
            isinstance(value, tuple | list)
            and len(value) == len(items)
            and all(item.accepts(own) for item, own in zip(items, value, strict=True))
        ),
        _as_tuple,
    )


def _plural(item: Rule) -> str:
    """Converts the description of a value, such as `a number`, to the plural for error messages."""
    plain = item.expected.removeprefix("a ")
    return f"{plain}s" if plain.endswith("number") else plain or "items"


def _as_tuple(value: Any) -> Any:
    return value if isinstance(value, tuple) else tuple(value)


def _mapping_rule(kind: type, rules: list[Rule]) -> Rule:
    key, item = rules if len(rules) == 2 else (_ANYTHING, _ANYTHING)

    def accepts(value: Any) -> bool:
        if not isinstance(value, kind) or not isinstance(value, abc.Mapping):
            return False
        return all(map(key.accepts, value)) and all(map(item.accepts, value.values()))

    expected = f"a dictionary of {_plural(item)} by {key.expected or 'key'}" if rules else "a dictionary"
    return Rule(expected, accepts)


def _items_rule(kind: type, item: Rule) -> Rule:
    """Builds the check of an argument annotated as a collection, such as `Sequence[int]` or `Iterable[Frame]`.

    Args:
        kind: Class of the collection, such as `Sequence`.
        item: Check of an item.
    """
    # An iterator can be read only once, so each of its items is checked when the decorated function reads it.
    sized = kind.__name__ in ("Sequence", "Collection", "list", "frozenset", "set")

    def accepts(value: Any) -> bool:
        if isinstance(value, str | bytes) or (isinstance(value, abc.Mapping) and kind.__name__ == "Sequence"):
            return False
        if kind.__module__ == "builtins":
            if not isinstance(value, kind):
                return False
        elif not isinstance(value, abc.Iterable) or (sized and not hasattr(value, "__len__")):
            return False
        if hasattr(value, "shape"):
            return len(value.shape) > 0 and (not value.shape[0] or item.accepts(value[0]))
        is_container = isinstance(value, list | tuple | set | frozenset | dict)
        return not is_container or all(map(item.accepts, value))

    def convert(value: Any) -> Any:
        return _checked_items(value, item) if isinstance(value, abc.Iterator) else value

    expected = f"a sequence of {_plural(item)}"
    return Rule(expected, accepts, convert) if not sized and item.expected else Rule(expected, accepts)


def _checked_items(values: Any, item: Rule) -> Any:
    """Yields the items of an iterator after checking each item.

    Args:
        values: The iterator.
        item: Rule that each item must satisfy.

    Raises:
        InvalidValueError: If an item does not pass the check.
    """
    for value in values:
        if not item.accepts(value):
            raise InvalidValueError(f"expected {item.expected} in each item, not {shown(value)}")
        yield value


def _protocol_rule(kind: type) -> Rule:
    """Builds the check of an argument annotated as a protocol: the argument must have all members of the protocol."""
    # Unlike `isinstance`, the check does not evaluate properties of the object.
    plain = set(dir(typing.Protocol)) | {"__annotations__", "__dataclass_fields__", "__protocol_attrs__"}
    member_names = {name for base in kind.__mro__ if getattr(base, "_is_protocol", False) for name in vars(base)}
    members = {name for name in member_names if not name.startswith("_") or name == "__call__"} - (plain - {"__call__"})

    def accepts(value: Any) -> bool:
        if isinstance(value, type):
            return False
        own = getattr(value, "__dict__", {})
        return all(name in own or hasattr(type(value), name) or hasattr(value, name) for name in members)

    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    return Rule(f"{article} {kind.__name__}", accepts)


def array_rule(kind: Any) -> Rule:
    """Builds the check of a value that is annotated as an array.

    The check covers class, dtype and number of dimensions.

    Args:
        kind: The annotation, such as `Float[np.ndarray, "N 3"]`, or a class of arrays.
    """
    if kind.__name__ == "ndarray":
        return Rule("an array", lambda value: isinstance(value, kind))
    dims, word = tuple(kind.dim_str.split()), kind.__name__.partition("[")[0].lower()
    exact = any(digit.isdigit() for digit in word)

    def accepts(value: Any) -> bool:
        if not hasattr(value, "shape") or not hasattr(value, "dtype"):
            return False
        dtype = str(value.dtype).removeprefix("torch.")
        fits = dtype == word if exact else word in dtype
        return (
            fits
            and (kind.array_type is Any or isinstance(value, kind.array_type))
            and ("*" in kind.dim_str or len(value.shape) == len(dims))
        )

    shape = ", ".join(dims) + ("," if len(dims) == 1 else "")
    name = "float32" if word == "float" else word
    return Rule(f"a {name} array ({shape})", accepts, dims=() if "*" in kind.dim_str else dims)


def array_like_rule(kind: Any) -> Rule:
    """Builds the check of an argument that a function converts to an array: any array, list or tuple."""
    return Rule("an array", lambda value: hasattr(value, "shape") or isinstance(value, list | tuple))
