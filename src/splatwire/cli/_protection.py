"""Amount of redundancy that `splatwire serve` and `splatwire live` send, from a plan file or from options."""

import re
from collections.abc import Sequence
from pathlib import Path

from splatwire.errors import InvalidValueError
from splatwire.planning.plan_file import MAX_BYTES, read_plan
from splatwire.transport import Protection


def plan_of_file(path: Path) -> tuple[Protection, int]:
    """Reads a plan for redundancy written by `splatwire plan`.

    Returns:
        The redundancy, and the id of the stream for which it was planned.
    """
    with path.open("rb") as file:
        return read_plan(file.read(MAX_BYTES + 1), str(path))


def protection_of(init_repair: float, texts: Sequence[str]) -> Protection:
    """Converts the options for redundancy to a `Protection`.

    Args:
        init_repair: Repair symbols per source symbol of the side information.
        texts: `motion=REPAIR` for the motion of clips, or `tierN=REPAIR` for importance tier N: repair
            symbols per packet.

    Raises:
        InvalidValueError: If the text has another form, or a number is out of range.
    """
    motion = [match for match in (re.fullmatch(r"motion=([0-9]*\.?[0-9]+)", text.strip()) for text in texts) if match]
    tiers = parse_tiers([text for text in texts if not text.strip().startswith("motion=")])
    return Protection(
        init_repair=init_repair, tier_repair=tiers, motion=tuple((1.0, float(match[1])) for match in motion[-1:])
    )


def parse_tiers(texts: Sequence[str]) -> tuple[float, ...]:
    """Parses the redundancy of importance tiers from texts of the form `tier0=0.5`.

    Args:
        texts: One text for each tier, in any order.

    Returns:
        Repair symbols per source symbol of each tier, from tier 0; 0 for tiers that are not named.

    Raises:
        InvalidValueError: If the text has another form, or a tier is named twice.
    """
    repair_by_tier: dict[int, float] = {}
    for text in texts:
        match = re.fullmatch(r"tier([0-7])=([0-9]*\.?[0-9]+)", text.strip())
        if match is None or int(match[1]) in repair_by_tier:
            raise InvalidValueError(f"'{text}' is not parity for a tier such as tier0=0.4, or names one again")
        repair_by_tier[int(match[1])] = float(match[2])
    return tuple(repair_by_tier.get(tier, 0.0) for tier in range(max(repair_by_tier, default=-1) + 1))
