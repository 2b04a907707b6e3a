"""Run-time type checks with little overhead.

beartype checks all functions. Functions with shapes in their annotations also get a context; there, jaxtyping compares
the dimensions of arguments and result; `jaxtyping.jaxtyped` itself checks all arguments twice. These functions are
checked in a sample of their calls. A check is generated when its function is called first: most processes call a part
of the package. A function within another one is a new object in each call of that one; these objects share one
generated check.
"""

import dataclasses
import functools
import inspect
import sys
import threading
import typing
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any, get_args, get_type_hints

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, TypeCheckError

whole = jaxtyping.jaxtyped
plain = beartype(conf=BeartypeConf(violation_type=TypeCheckError))
_OTHER_KINDS = inspect.CO_GENERATOR | inspect.CO_COROUTINE | inspect.CO_ASYNC_GENERATOR
_LOCK = threading.RLock()
"""Held while the annotations of a function are replaced by their values."""
_CHECKS_OF_CLOSURES: dict[CodeType, "_Check"] = {}
"""Checks of functions within other functions."""
CHECKED_CALLS, CHECK_INTERVAL = 64, 16
"""Of a function with shapes, the first 64 calls of a process are checked, and then each 16th: checks of all calls took
a tenth of the whole suite's time."""
_FITTING: set[tuple[type, type]] = set()
"""Protocols, each with a class whose objects have all its members."""


@dataclasses.dataclass(frozen=True)
class _Check:
    """Generated check of all functions with one code.

    Attributes:
        annotations: Annotations of these functions as they are written.
        has_shapes: True if an annotation has a shape.
        code: Code of the check; None if nothing is checked.
        scope: Global names of the check.
        defaults: Values that the check needs, by name.
        place: Name of the value that is the checked function.
    """

    annotations: dict[str, Any]
    has_shapes: bool
    code: CodeType | None = None
    scope: dict[str, Any] = dataclasses.field(default_factory=dict)
    defaults: dict[str, Any] = dataclasses.field(default_factory=dict)
    place: str = ""

    def of(self, found: Callable[..., Any]) -> Callable[..., Any]:
        """Returns a function with its check."""
        if self.code is None:
            return found
        checked = FunctionType(self.code, self.scope, found.__name__)
        checked.__kwdefaults__ = {**self.defaults, self.place: found}
        checked = functools.wraps(found)(checked)
        return _with_shapes(found, lambda: checked) if self.has_shapes else checked


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
    known = _CHECKS_OF_CLOSURES.get(found.__code__)
    if known is not None and known.annotations == annotations:
        return known.of(found)
    hints = {name: _resolved(hint, found.__globals__) for name, hint in annotations.items()}
    has_shapes = any(_has_shape(hint) for hint in hints.values())
    if all(hint is Any for hint in hints.values()):
        _keep_check(found, annotations, has_shapes, found)
        return found

    def make() -> Callable[..., Any]:
        with _LOCK:
            found.__annotations__ = hints
            try:
                checked = plain(found)
            finally:
                found.__annotations__ = annotations
        _keep_check(found, annotations, has_shapes, checked)
        return checked

    if found.__code__.co_flags & _OTHER_KINDS:
        return whole(found, typechecker=typechecker) if has_shapes else make()
    return _with_shapes(found, make) if has_shapes else _made_at_first_call(found, make)


def _keep_check(found: Any, annotations: dict[str, Any], has_shapes: bool, checked: Any) -> None:
    """Keeps the check of a function within another function, for later functions with the same code."""
    if "<locals>" not in found.__qualname__:
        return
    if checked is found:
        _CHECKS_OF_CLOSURES[found.__code__] = _Check(annotations, has_shapes)
        return
    defaults = checked.__kwdefaults__ or {}
    places = [name for name, value in defaults.items() if value is found]
    if len(places) == 1 and not checked.__code__.co_freevars and not checked.__defaults__:
        others = {
            name: value for name, value in defaults.items() if name != places[0]
        }  # not the function: it may hold data
        _CHECKS_OF_CLOSURES[found.__code__] = _Check(
            annotations, has_shapes, checked.__code__, checked.__globals__, others, places[0]
        )


def _with_shapes(found: Callable[..., Any], make: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """Wraps a function so that checks compare the dimensions of arguments and result."""
    checked: Callable[..., Any] | None = None
    num_calls = 0

    @functools.wraps(found)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked, num_calls
        num_calls += 1
        if num_calls > CHECKED_CALLS and num_calls % CHECK_INTERVAL:
            return found(*args, **kwargs)
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


def _is_instance(protocol: Any, found: Any) -> bool:
    """Replaces `isinstance` of Python 3.11 for runtime protocols, and never evaluates a property, as 3.12 does not.

    A property of a scene may examine all its elements, and every check of an annotation would evaluate it.
    """
    if not (getattr(protocol, "_is_protocol", False) and getattr(protocol, "_is_runtime_protocol", False)):
        return _protocol_check(protocol, found)
    if (protocol, type(found)) in _FITTING:
        return True
    for name in typing._get_protocol_attrs(protocol):  # type: ignore[attr-defined]
        value = inspect.getattr_static(found, name, _protocol_check)
        if value is _protocol_check or (value is None and callable(getattr(protocol, name, None))):
            return _protocol_check(protocol, found)
    _FITTING.add((protocol, type(found)))
    return True


if sys.version_info < (3, 12):
    _protocol_check: Any = type(typing.Protocol).__instancecheck__
    type(typing.Protocol).__instancecheck__ = _is_instance
