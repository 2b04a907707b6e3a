"""Checks of type and shape of arrays that users pass in; errors name the expected type and shape."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.ops.arrays import to_numpy
from splatwire.reprs import summarize
from splatwire.types.origin import check_precision

Shape = tuple[int | str, ...]
"""Expected shape of an array. A letter is a free dimension; the same letter means the same size in all arrays of a
record."""

_FLOATS = ("float16", "bfloat16", "float32", "float64")


def check_arrays(
    record: Any,
    shapes: Mapping[str, Shape],
    *,
    boolean: tuple[str, ...] = (),
    tensors: bool = True,
    positions: str | None = None,
) -> None:
    """Checks the type and shape of array fields of a dataclass instance.

    Args:
        record: Dataclass instance with array fields, e.g. `Splats`.
        shapes: Expected shape of each array, by field name.
        boolean: Names of the boolean fields; the others are floating-point.
        tensors: True to accept torch tensors too, for training.
        positions: Field with positions, which float32 must represent precisely enough; None for no check.

    Raises:
        InvalidValueError: If a field is not an array or has the wrong type or shape, or if positions are float64 and
            far from 0.
    """
    extents: dict[str, int] = {}
    for name, shape in shapes.items():
        value = getattr(record, name)
        kind = "bool" if name in boolean else "float32"
        tensor = hasattr(value, "is_floating_point")
        if isinstance(value, np.ma.MaskedArray):
            raise _wrong(record, name, kind, shape, "a masked array: `.filled(value)` makes one without a mask")
        if not isinstance(value, np.ndarray) and not (tensors and tensor):
            how = ": `.detach().cpu().float().numpy()` makes one" if tensor else ""
            raise _wrong(record, name, kind, shape, f"{type(value).__module__}.{type(value).__name__}{how}")
        values = str(value.dtype).removeprefix("torch.")
        right = values in (("bool",) if name in boolean else _FLOATS)
        fits = len(value.shape) == len(shape) and all(
            extent == (wanted if isinstance(wanted, int) else extents.setdefault(wanted, extent))
            for extent, wanted in zip(value.shape, shape, strict=True)
        )
        if not (right and fits):
            stated = ", ".join(f"{letter} = {extent}" for letter, extent in extents.items() if letter in shape)
            raise _wrong(record, name, kind, shape, summarize(value) + (f" ({stated})" if stated else ""))
    if positions is not None and "float64" in str(getattr(record, positions).dtype):
        check_precision(to_numpy(getattr(record, positions)), f"{type(record).__name__}.{positions}")


def _wrong(record: Any, name: str, kind: str, shape: Shape, actual: str) -> InvalidValueError:
    extents = ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "")
    return InvalidValueError(f"{type(record).__name__}.{name}: expected a {kind} array ({extents}), not {actual}")


def check_mask(mask: Any, count: int, name: str) -> None:
    """Checks a mask of elements.

    Args:
        mask: The argument; a boolean array or tensor is expected.
        count: Number of elements.
        name: Name of the argument, for the message.

    Raises:
        InvalidValueError: If the argument is anything else, or has another length.
    """
    if str(getattr(mask, "dtype", "")).removeprefix("torch.") != "bool" or tuple(mask.shape) != (count,):
        raise InvalidValueError(f"{name}: expected a bool array ({count:,},), not {summarize(mask)}")


def check_hints(hints: Any, count: int) -> None:
    """Checks that the arrays of the rendering hints have one entry for each element of a scene.

    Args:
        hints: `RenderHints` of the scene, or None.
        count: Number of elements of the scene.

    Raises:
        InvalidValueError: If an array of the hints has another length.
    """
    if hints is None:
        return
    for name in ("size_gain", "left_out", "opacity_gain"):
        values = getattr(hints, name)
        if values is not None and values.shape[0] != count:
            raise InvalidValueError(f"hints.{name} is for {values.shape[0]:,} elements, and the scene has {count:,}")


def indices_of(index: Any, count: int) -> np.ndarray:
    """Converts a selection of elements to their indices.

    Args:
        index: Whole numbers, a boolean mask of all elements, or a slice; an array, a tensor or a list.
        count: Number of elements.

    Raises:
        InvalidValueError: If `index` is anything else, a mask has another length, or an index is out of range.
    """
    if isinstance(index, slice):
        try:
            return np.arange(count)[index]
        except (TypeError, ValueError) as error:  # text as a bound, or a step of 0
            raise InvalidValueError(f"index: expected a slice of whole numbers, not {index}: {error}") from error
    try:
        array = np.asarray(to_numpy(index))
    except ValueError:  # a ragged list
        array = np.zeros((), np.object_)
    if array.dtype == np.bool_ and array.shape == (count,):
        return np.flatnonzero(array)
    if array.shape == (0,) and array.dtype.kind in "fiu":
        return np.zeros(0, np.int64)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise InvalidValueError(f"index: expected whole numbers (M,) or a mask ({count:,},), not {summarize(index)}")
    if array.size and not (-count <= int(array.min()) and int(array.max()) < count):
        allowed = f"numbers from {-count:,} to {count - 1:,}" if count else "none, as there are no elements"
        raise InvalidValueError(f"index: expected {allowed}, not {int(array.min()):,} to {int(array.max()):,}")
    return array
