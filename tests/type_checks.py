"""Run-time type checks with little overhead.

beartype checks all functions. Functions with shapes in their annotations also get a context; there, jaxtyping compares
the dimensions of arguments and result; `jaxtyping.jaxtyped` itself checks all arguments twice. A check is generated
when its function is called first: most processes call a part of the package.
"""

import dataclasses
import functools
import inspect
import threading
from collections.abc import Callable
from types import FunctionType
from typing import Any, get_args, get_type_hints

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, TypeCheckError

whole = jaxtyping.jaxtyped
plain = beartype(conf=BeartypeConf(violation_type=TypeCheckError))
_OTHER_KINDS = inspect.CO_GENERATOR | inspect.CO_COROUTINE | inspect.CO_ASYNC_GENERATOR
_LOCK = threading.RLock()
"""Held while the annotations of a function are replaced by their values."""


def checking(*, typechecker: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Replaces `jaxtyping.jaxtyped` in modules that were imported through its hook."""
    return functools.partial(_checked, typechecker=typechecker)


def _checked(found: Any, *, typechecker: Callable[[Any], Any]) -> Any:
    if inspect.isclass(found):
        if dataclasses.is_dataclass(found) and "__init__" in vars(found):
            found.__init__ = _checked(found.__init__, typechecker=typechecker)  # type: ignore[misc]
        return found
    if not inspect.isfunction(found):
        return whole(found, typechecker=typechecker)
    annotations = found.__annotations__
    hints = {name: _resolved(hint, found.__globals__) for name, hint in annotations.items()}
    has_shapes = any(_has_shape(hint) for hint in hints.values())
    if all(hint is Any for hint in hints.values()):
        return found

    def make() -> Callable[..., Any]:
        with _LOCK:
            found.__annotations__ = hints
            try:
                return plain(found)
            finally:
                found.__annotations__ = annotations

    if found.__code__.co_flags & _OTHER_KINDS:
        return whole(found, typechecker=typechecker) if has_shapes else make()
    return _with_shapes(found, make) if has_shapes else _made_at_first_call(found, make)


def _with_shapes(found: Callable[..., Any], make: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """Wraps a function so that checks compare the dimensions of arguments and result."""
    checked: Callable[..., Any] | None = None

    @functools.wraps(found)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        checked = checked or make()
        with whole("context"):
            return checked(*args, **kwargs)

    return call


def _made_at_first_call(found: Callable[..., Any], make: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """Returns a function that becomes the checked one at its first call, and costs nothing more from then on."""

    def generate() -> Callable[..., Any]:
        checked = make()
        code, defaults = checked.__code__, checked.__kwdefaults__
        if checked is found or code.co_freevars or checked.__defaults__ or not defaults:
            wrapper.__kwdefaults__ = {"_generate": lambda: checked}
        else:  # beartype's code finds all it needs in its defaults
            # Both sets, for other threads between these two lines.
            wrapper.__kwdefaults__ = {"_generate": generate, **defaults}
            wrapper.__code__ = code
        return checked

    wrapper = FunctionType(_first_call.__code__, globals(), found.__name__)
    wrapper.__kwdefaults__ = {"_generate": generate}
    return functools.wraps(found)(wrapper)


def _first_call(*args: Any, _generate: Callable[[], Callable[..., Any]], **kwargs: Any) -> Any:
    return _generate()(*args, **kwargs)


def _resolved(hint: Any, scope: dict[str, Any]) -> Any:
    """Value of a string annotation; any type for names that are imported for type checkers only."""
    if type(hint) is type:
        return hint
    try:
        return get_type_hints(type("Holder", (), {"__annotations__": {"value": hint}}), scope)["value"]
    except (NameError, ValueError):
        return Any


def _has_shape(hint: Any) -> bool:
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        return True
    return any(_has_shape(part) for part in get_args(hint))
