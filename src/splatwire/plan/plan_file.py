"""A plan as a JSON object: what `splatwire plan` writes and `splatwire serve --plan` takes."""

import json
import math
from dataclasses import asdict, fields
from typing import Any

from splatwire.errors import InvalidValueError, UnsupportedVersionError
from splatwire.transport.protection import Protection

FORMAT, VERSION = "splatwire plan", 1
MOST_BYTES = 1 << 18
MOST_TIERS = 8
MOST_GROUPS = 4096
"""Groups of frames of a clip with a protection of their own."""


def plan_content(protection: Protection, stream_id: int, facts: dict[str, Any]) -> dict[str, Any]:
    """The object.

    Args:
        protection: Where redundancy goes.
        stream_id: The stream that this was planned for.
        facts: What else a person may want to know; nobody reads it back.
    """
    own = {"format": FORMAT, "version": VERSION, "stream_id": f"{stream_id:08x}", "protection": asdict(protection)}
    return {**facts, **own}


def read_plan(data: bytes, name: str) -> tuple[Protection, int]:
    """Inverse of `plan_content`.

    Args:
        data: The JSON text, which may come from anywhere.
        name: Of the file, for messages.

    Returns:
        Where redundancy goes, and the id of the stream that this was planned for.

    Raises:
        InvalidValueError: If it is no plan, or one that is impossible.
        UnsupportedVersionError: If another version wrote it.
    """
    try:
        # whole numbers as floats: of 5,000 digits or not, they are compared with limits next
        content = json.loads(data, parse_int=float) if len(data) <= MOST_BYTES else None
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InvalidValueError(f"{name} is no plan, as `splatwire plan -o FILE` writes one")
    if content.get("version") != VERSION:
        raise UnsupportedVersionError(f"{name} is a plan of version {content.get('version')!s:.20}, not {VERSION}")
    try:
        return _protection(content.get("protection")), _stream_id(content.get("stream_id"))
    except InvalidValueError as error:
        raise InvalidValueError(f"{name}: {error}") from None


def _stream_id(value: Any) -> int:
    if not (isinstance(value, str) and len(value) == 8 and set(value) <= set("0123456789abcdef")):
        raise InvalidValueError("the plan's stream_id is not 8 hexadecimal digits")
    return int(value, 16)


def _protection(values: Any) -> Protection:
    known = {field.name for field in fields(Protection)}
    if not (isinstance(values, dict) and set(values) | {"motion"} == known):
        raise InvalidValueError(f"the plan's protection must have {', '.join(sorted(known))} and nothing else")
    repair, optional = values["tier_repair"], {"side_symbol_bytes", "resend"}
    if not (isinstance(repair, list) and len(repair) <= MOST_TIERS):
        raise InvalidValueError(f"the plan's tier_repair is not a list of at most {MOST_TIERS} numbers")
    numbers = {key: _number(key, value) for key, value in values.items()
               if key not in {"tier_repair", "motion"} and not (value is None and key in optional)}  # fmt: skip
    size = numbers.pop("side_symbol_bytes", None)
    if size is not None and not size.is_integer():
        raise InvalidValueError(f"the plan's side_symbol_bytes is no whole number, but {size}")
    return Protection(
        **numbers, side_symbol_bytes=None if size is None else int(size),
        tier_repair=tuple(_number("tier_repair", value) for value in repair), motion=_motion(values.get("motion", [])),
    )  # fmt: skip


def _motion(values: Any) -> tuple[tuple[float, float], ...]:
    """Share and repair of each group of frames."""
    fine = isinstance(values, list) and len(values) <= MOST_GROUPS
    if not (fine and all(isinstance(pair, list) and len(pair) == 2 for pair in values)):
        raise InvalidValueError(f"the plan's motion is not a list of at most {MOST_GROUPS} pairs of numbers")
    return tuple((_number("motion", share), _number("motion", repair)) for share, repair in values)


def _number(key: str, value: Any) -> float:
    if not (isinstance(value, float) and math.isfinite(value)):
        raise InvalidValueError(f"the plan's {key} is no number")
    return value
