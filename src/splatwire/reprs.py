"""Short repr of dataclasses with arrays: dtype and shape instead of numbers."""

import dataclasses
from collections.abc import Mapping
from typing import Any

_LONG = 8
"""Maximum number of items of a tuple or mapping to show; longer ones are shown as their length."""
_MAX_TEXT = 80
"""Maximum number of characters of any other value."""

_MAX_BITS = 200
"""Maximum number of bits of an integer to show."""


def summary_repr(record: Any) -> str:
    """Returns the text of a dataclass instance with a summary of each field, for use as `__repr__`."""
    fields = ", ".join(f"{f.name}={summarize(getattr(record, f.name))}" for f in dataclasses.fields(record) if f.repr)
    return f"{type(record).__name__}({fields})"


def summarize(value: Any) -> str:
    """Returns a short text for a value, such as `float32 (1000, 3)` for an array."""
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        device = str(getattr(value, "device", "cpu"))
        where = "" if device == "cpu" else f" on {device}"
        return f"{str(value.dtype).removeprefix('torch.')} {tuple(value.shape)}{where}"
    if isinstance(value, bytes | bytearray | memoryview):
        return f"{len(value):,} bytes"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return repr(value)
    if isinstance(value, Mapping):
        if len(value) > _LONG:
            return f"{len(value):,} items"
        return "{" + ", ".join(f"{key!r}: {summarize(item)}" for key, item in value.items()) + "}"
    if isinstance(value, tuple | list):
        if len(value) > _LONG:
            return f"{type(value).__name__} of {len(value):,}"
        texts = ", ".join(map(summarize, value)) + ("," if isinstance(value, tuple) and len(value) == 1 else "")
        return f"({texts})" if isinstance(value, tuple) else f"[{texts}]"
    if isinstance(value, int) and value.bit_length() > _MAX_BITS:  # Python refuses to print very long ones
        return f"an integer of {value.bit_length()} bits"
    text = repr(value)
    return text if len(text) <= _MAX_TEXT else f"{text[:_MAX_TEXT]}…"
