"""Run-time type checks with little overhead.

`jaxtyping.jaxtyped` binds the arguments of every call to compare their dimensions. Only functions with shapes in their
annotations need it. For the others beartype alone checks as much in a tenth of the time.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any, get_args, get_type_hints

import jaxtyping
from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, TypeCheckError

whole = jaxtyping.jaxtyped
plain = beartype(conf=BeartypeConf(violation_type=TypeCheckError))


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
    said = found.__annotations__
    hints = {name: _resolved(hint, found.__globals__) for name, hint in said.items()}
    if any(_has_shape(hint) for hint in hints.values()):
        return whole(found, typechecker=typechecker)
    if all(hint is Any for hint in hints.values()):
        return found
    found.__annotations__ = hints
    try:
        return plain(found)
    finally:
        found.__annotations__ = said


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
