"""JSON of figures."""

import json
import math
from collections.abc import Mapping
from typing import Any


def json_text(content: Mapping[str, Any], indent: int | None = None) -> str:
    """JSON text; numbers that JSON does not have become null.

    Args:
        content: Mappings, lists and plain values.
        indent: Blanks for each level; None for one line.
    """
    return json.dumps(json_ready(content), indent=indent, allow_nan=False)


def json_ready(value: Any) -> Any:
    """The same value as JSON has it: numbers that it does not have are None, keys text."""
    if isinstance(value, Mapping):
        return {str(key): json_ready(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_ready(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
