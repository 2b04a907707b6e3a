"""Conversion of torch tensors to numpy arrays."""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

Noun = TypeVar("Noun")


def to_numpy(values: Any) -> np.ndarray:
    """Converts an array or tensor to a numpy array, if possible without a copy.

    Args:
        values: A numpy array, or a torch tensor on any device; gradients are dropped.
    """
    if isinstance(values, np.ndarray):
        return values
    return values.detach().cpu().numpy() if hasattr(values, "detach") else np.asarray(values)


def where(mask: Any, values: Any, otherwise: Any) -> Any:
    """Returns `values` where `mask` is True and `otherwise` elsewhere.

    Args:
        mask: Booleans that broadcast against `values`, an array of the same library.
        values: A numpy array or a torch tensor.
        otherwise: An array of the same library, or a number.
    """
    if isinstance(values, np.ndarray):
        return np.where(to_numpy(mask), values, np.asarray(to_numpy(otherwise), values.dtype))
    return values.where(mask, otherwise)


def lower_median(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Returns the median along an axis. For an even number of values, it is the lower of the two middle values.

    Args:
        values: Numbers, at least one along the axis.
        axis: The axis that is reduced.
    """
    middle = (values.shape[axis] - 1) // 2
    return np.asarray(np.take(np.partition(values, middle, axis=axis), middle, axis=axis))


def to_arrays(value: Noun) -> Noun:
    """Converts torch tensors in a record to numpy arrays, if possible without a copy.

    Args:
        value: A tensor; or a tuple, dictionary or dataclass that contains tensors at any depth. Gradients are dropped.
    """
    return to_numpy(value) if hasattr(value, "detach") else map_items(value, to_arrays)  # type: ignore[return-value]


def map_items(value: Any, convert: Callable[[Any], Any]) -> Any:
    """Applies `convert` to each item of a tuple, dictionary or dataclass; returns any other value unchanged."""
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        return tuple(convert(part) for part in value)
    if isinstance(value, dict):
        return {name: convert(part) for name, part in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {f.name: convert(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
        same = all(changed[name] is getattr(value, name) for name in changed)
        return value if same else dataclasses.replace(value, **changed)
    return value
