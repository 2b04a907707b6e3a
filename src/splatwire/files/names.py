"""Safe file names for user-supplied names, and validation of paths."""

import itertools
import os
from collections.abc import Iterable
from pathlib import Path

from splatwire.errors import InvalidValueError

_MAX_CHARACTERS = 80
_MAX_BYTES = 200
"""Maximum length of a file name, bytes. Common file systems allow 255; the rest is reserved for a number and a
suffix."""


def safe_name(name: str, fallback: str = "unnamed") -> str:
    """Converts a name to a file name without separators and special characters; `fallback` if nothing is left."""
    plain = "".join(c if c.isalnum() or c in "-_." else "_" for c in name).strip("._")[:_MAX_CHARACTERS]
    return plain.encode("utf-8")[:_MAX_BYTES].decode("utf-8", "ignore") or fallback


def distinct_names(names: Iterable[str], fallback: str = "unnamed") -> tuple[str, ...]:
    """Converts names to file names that differ even if letter case is ignored. Repeated names get a number."""
    distinct: list[str] = []
    taken: set[str] = set()
    last: dict[str, int] = {}
    for name in names:
        plain = chosen = safe_name(name, fallback)
        while chosen.casefold() in taken:
            last[plain.casefold()] = number = last.get(plain.casefold(), 1) + 1
            chosen = f"{plain}_{number}"
        taken.add(chosen.casefold())
        distinct.append(chosen)
    return tuple(distinct)


def real_path(path: Path) -> Path:
    """Returns the absolute path with symbolic links replaced by their targets, as far as the links can be followed."""
    return Path(os.path.realpath(path))  # `Path.resolve` fails for a link to itself


def unused_path(path: Path) -> Path:
    """Returns a path at which nothing exists: the given one, or one with a number before its suffix."""
    numbered = (path.with_name(f"{path.stem}_{number}{path.suffix}") for number in itertools.count(2))
    return next(one for one in itertools.chain([path], numbered) if not os.path.lexists(one))


def path_of(value: object, content: str = "a file or folder") -> Path:
    """Validates a path argument of a public function, and converts it to a `Path`.

    Args:
        value: Text or a path.
        content: Expected content at the path, for the message.

    Raises:
        InvalidValueError: If `value` has another type (also bytes), is empty or is not a valid path.
    """
    if not isinstance(value, (str, os.PathLike)) or not isinstance(os.fspath(value), str):
        type_name = type(value).__name__
        raise InvalidValueError(
            f"expected the path of {content}, such as 'scene.ply' or pathlib.Path('scene.ply'), not {type_name}"
        )
    text = os.fspath(value)
    if not text or "\0" in text:
        raise InvalidValueError(
            f"expected the path of {content}, not {'an empty text' if not text else repr(text[:60])}"
        )
    return value if isinstance(value, Path) else Path(text)
