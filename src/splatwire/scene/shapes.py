"""Checks of tensors that a user hands over: kind and shape, with an error that names what works."""

from collections.abc import Mapping
from typing import Any

import torch

from splatwire.errors import InvalidValueError
from splatwire.reprs import summarize

Shape = tuple[int | str, ...]
"""Extents of a tensor; a letter is the same extent everywhere in one record."""


def check_tensors(record: Any, shapes: Mapping[str, Shape], *, boolean: tuple[str, ...] = ()) -> None:
    """Checks the tensors of a record: floating-point numbers, or booleans where `boolean` names the field.

    Args:
        record: The record, e.g. `Splats`.
        shapes: Shape by name of the field.
        boolean: Fields with boolean values.

    Raises:
        InvalidValueError: If a field is no tensor, has another type, or has another shape.
    """
    extents: dict[str, int] = {}
    for name, shape in shapes.items():
        value = getattr(record, name)
        kind = "bool" if name in boolean else "float32"
        if not isinstance(value, torch.Tensor):
            how = ": `torch.from_numpy` makes one" if type(value).__module__ == "numpy" else ""
            raise _wrong(record, name, kind, shape, f"{type(value).__module__}.{type(value).__name__}{how}")
        right = value.dtype == torch.bool if name in boolean else value.is_floating_point()
        fits = len(value.shape) == len(shape) and all(
            extent == (wanted if isinstance(wanted, int) else extents.setdefault(wanted, extent))
            for extent, wanted in zip(value.shape, shape, strict=True)
        )
        if not (right and fits):
            known = ", ".join(f"{letter} = {extent}" for letter, extent in extents.items() if letter in shape)
            raise _wrong(record, name, kind, shape, summarize(value) + (f" ({known})" if known else ""))


def _wrong(record: Any, name: str, kind: str, shape: Shape, found: str) -> InvalidValueError:
    extents = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
    return InvalidValueError(f"{type(record).__name__}.{name}: expected a {kind} tensor ({extents}), not {found}")
