"""File names for things that people named."""

from collections.abc import Iterable

_MAX_CHARACTERS = 80
_MAX_BYTES = 200
"""A name may have 255 bytes on common file systems; a number and a suffix are still to come."""


def safe_name(name: str, instead: str = "unnamed") -> str:
    """A file name without folders or surprises; `instead` where nothing of the name is left."""
    plain = "".join(c if c.isalnum() or c in "-_." else "_" for c in name).strip("._")[:_MAX_CHARACTERS]
    return plain.encode("utf-8")[:_MAX_BYTES].decode("utf-8", "ignore") or instead


def distinct_names(names: Iterable[str], instead: str = "unnamed") -> tuple[str, ...]:
    """Safe file names of which no two are equal, not even where case does not count; later ones get a number."""
    found: list[str] = []
    taken: set[str] = set()
    last: dict[str, int] = {}
    for name in names:
        plain = chosen = safe_name(name, instead)
        while chosen.casefold() in taken:
            last[plain.casefold()] = number = last.get(plain.casefold(), 1) + 1
            chosen = f"{plain}_{number}"
        taken.add(chosen.casefold())
        found.append(chosen)
    return tuple(found)
