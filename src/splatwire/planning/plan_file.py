"""Plan files (JSON): written by `splatwire plan`, read by `splatwire serve --plan`."""

import json
import math
from dataclasses import asdict, dataclass, fields
from typing import Any

from splatwire.arguments import checked
from splatwire.errors import InvalidValueError, UnsupportedVersionError
from splatwire.transport.protocol.protection import Protection

FORMAT, VERSION = "splatwire plan", 1
MAX_BYTES = 1 << 18
MAX_TIERS = 8
FORMER_KEYS = {
    "side_repair": "init_repair", "side_lead": "init_until", "side_symbol_bytes": "init_symbol_bytes",
    "head_share": "bundled_share", "resend": "retransmit_share", "resend_until": "retransmit_until",
}  # fmt: skip
"""Current names of the keys of a plan's protection, by the names that releases before 0.3.0 wrote."""
MAX_GROUPS = 4096
"""Maximum number of groups of pictures with their own amount of redundancy."""


@dataclass(frozen=True)
class Plan:
    """Redundancy that a planner has chosen, and the quality that is expected with it.

    Attributes:
        protection: Redundancy for the server to apply.
        variant: Index of the chosen stream variant.
        psnr: Mean PSNR over simulated transfers (and frames of a sequence), decibels.
        lost: Mean lost fraction of each part of the stream, 0 to 1. The parts of a scene are its importance tiers. The
            parts of a sequence are the motion of each group of pictures.
        sent_bytes: Bytes that a transfer sends within the budget. Retransmissions of keyframe packets do not count.
    """

    protection: Protection
    variant: int
    psnr: float
    lost: tuple[float, ...]
    sent_bytes: int


@checked
def plan_content(protection: Protection, stream_id: int, facts: dict[str, Any]) -> dict[str, Any]:
    """Returns the content of a plan file (JSON object).

    Args:
        protection: Redundancy for the server to apply.
        stream_id: Id of the stream.
        facts: Further values to store for information, such as the expected PSNR.
    """
    fixed_fields = {
        "format": FORMAT,
        "version": VERSION,
        "stream_id": f"{stream_id:08x}",
        "protection": asdict(protection),
    }
    return {**facts, **fixed_fields}


@checked
def read_plan(data: bytes, name: str) -> tuple[Protection, int]:
    """Parses a plan file.

    Args:
        data: JSON text.
        name: File name for messages.

    Returns:
        Redundancy to apply, and id of the stream for which the plan was made.

    Raises:
        InvalidValueError: If the data is not a plan, or a value is invalid.
        UnsupportedVersionError: If the plan has a version that this release does not support.
    """
    try:
        # Integers are parsed as floats, because huge ones are slow to parse; limits are checked next.
        content = json.loads(data, parse_int=float) if len(data) <= MAX_BYTES else None
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
    current = (
        {FORMER_KEYS.get(str(key), str(key)): value for key, value in values.items()}
        if isinstance(values, dict)
        else {}
    )
    if set(current) | {"motion"} != known or len(current) != len(values):
        raise InvalidValueError(f"the plan's protection must have {', '.join(sorted(known))} and nothing else")
    repair, optional = current["tier_repair"], {"init_symbol_bytes", "retransmit_share"}
    if not (isinstance(repair, list) and len(repair) <= MAX_TIERS):
        raise InvalidValueError(f"the plan's tier_repair is not a list of at most {MAX_TIERS} numbers")
    numbers = {key: _number(key, value) for key, value in current.items()
               if key not in {"tier_repair", "motion"} and not (value is None and key in optional)}  # fmt: skip
    size = numbers.pop("init_symbol_bytes", None)
    if size is not None and not size.is_integer():
        raise InvalidValueError(f"the plan's init_symbol_bytes is no whole number, but {size}")
    return Protection(
        **numbers, init_symbol_bytes=None if size is None else int(size),
        tier_repair=tuple(_number("tier_repair", value) for value in repair),
        motion=_parse_motion_protection(current.get("motion", [])),
    )  # fmt: skip


def _parse_motion_protection(values: Any) -> tuple[tuple[float, float], ...]:
    """Parses how much parity a plan file requires for the motion packets of a sequence.

    Args:
        values: Value of the key `motion` in the plan file.

    Returns:
        One pair of numbers for each group of pictures. The first is the share of the group's motion packets that are
        protected by parity, 0 to 1. The second is the number of repair symbols per protected packet.

    Raises:
        InvalidValueError: If the value is not a list of pairs of numbers, or is too long.
    """
    fine = isinstance(values, list) and len(values) <= MAX_GROUPS
    if not (fine and all(isinstance(pair, list) and len(pair) == 2 for pair in values)):
        raise InvalidValueError(f"the plan's motion is not a list of at most {MAX_GROUPS} pairs of numbers")
    return tuple((_number("motion", share), _number("motion", repair)) for share, repair in values)


def _number(key: str, value: Any) -> float:
    if not (isinstance(value, float) and math.isfinite(value)):
        raise InvalidValueError(f"the plan's {key} is no number")
    return value
