"""Checks of arrays that a user hands over: kind and shape, with an error that names what works."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.reprs import summarize

Shape = tuple[int | str, ...]
"""Extents of an array; a letter is the same extent everywhere in one record."""


def check_arrays(
    record: Any, shapes: Mapping[str, Shape], *, boolean: tuple[str, ...] = (), tensors: bool = True
) -> None:
    """Checks the arrays of a record: floating-point numbers, or booleans where `boolean` names the field.

    Args:
        record: The record, e.g. `Splats`.
        shapes: Shape by name of the field.
        boolean: Fields with boolean values.
        tensors: If True, torch tensors pass too, as training needs them.

    Raises:
        InvalidValueError: If a field is no array, has another type, or has another shape.
    """
    extents: dict[str, int] = {}
    for name, shape in shapes.items():
        value = getattr(record, name)
        kind = "bool" if name in boolean else "float32"
        tensor = hasattr(value, "is_floating_point")
        if not isinstance(value, np.ndarray) and not (tensors and tensor):
            how = ": `.numpy()` makes one" if tensor else ""
            raise _wrong(record, name, kind, shape, f"{type(value).__module__}.{type(value).__name__}{how}")
        values = str(value.dtype).removeprefix("torch.")
        right = values == "bool" if name in boolean else "float" in values
        fits = len(value.shape) == len(shape) and all(
            extent == (wanted if isinstance(wanted, int) else extents.setdefault(wanted, extent))
            for extent, wanted in zip(value.shape, shape, strict=True)
        )
        if not (right and fits):
            known = ", ".join(f"{letter} = {extent}" for letter, extent in extents.items() if letter in shape)
            raise _wrong(record, name, kind, shape, summarize(value) + (f" ({known})" if known else ""))


def _wrong(record: Any, name: str, kind: str, shape: Shape, found: str) -> InvalidValueError:
    extents = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
    return InvalidValueError(f"{type(record).__name__}.{name}: expected a {kind} array ({extents}), not {found}")
