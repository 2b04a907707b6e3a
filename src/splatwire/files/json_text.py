"""JSON serialisation of results with numbers that may not be finite."""

import json
import math
from collections.abc import Mapping
from typing import Any


def json_text(content: Mapping[str, Any], indent: int | None = None) -> str:
    """Serialises to JSON; numbers that are not finite become null.

    Args:
        content: Mappings, lists and plain values.
        indent: Spaces per level; None for one line.
    """
    return json.dumps(json_ready(content), indent=indent, allow_nan=False)


def json_ready(value: Any) -> Any:
    """Converts a value to one that JSON can express: numbers that are not finite become None, keys become strings."""
    if isinstance(value, Mapping):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_ready(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
