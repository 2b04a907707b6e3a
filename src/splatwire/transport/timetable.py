"""In which order everything leaves: packets by importance and hash position, side information and parity in between."""

from collections.abc import Sequence

from splatwire.transport.frames import TierHead
from splatwire.transport.protection import Protection
from splatwire.transport.wire import DATA, PARITY, SIDE


def timetable(
    head: Sequence[int],
    tiers: Sequence[TierHead],
    parity: Sequence[int],
    protection: Protection,
    present: Sequence[int] = (),
) -> tuple[tuple[int, int, int], ...]:
    """Spreads the head object over the first share of the packets, and each tier's parity from its middle on.

    Each datagram has a due time from 0 to 1; symbols of different segments and groups take turns.

    Args:
        head: Symbols of each segment of the head object, source and repair.
        tiers: Protection of the packets.
        parity: Repair symbols of each group.
        protection: When parity and head object are sent.
        present: Packets of each of the stream's tiers of importance that are not in the head object; one tier if not
            given. The packets before these are in it, and are not sent.

    Returns:
        What is sent, in order, as `Program.schedule`.
    """
    num_packets = sum(tier.num_packets for tier in tiers)
    head_items = sorted(((n / size, k, n) for k, size in enumerate(head) for n in range(size)))
    due = [((n + 0.5) / len(head_items) * protection.side_lead, SIDE, k, i) for n, (_, k, i) in enumerate(head_items)]
    carried = num_packets - sum(present or [num_packets])
    times = [0.0] * carried + _packet_times(present or [num_packets], protection.tier_spread)
    due += [(times[n], DATA, 0, n) for n in range(carried, num_packets)]
    first = group = 0
    for tier in tiers:
        groups = range(group, group + tier.groups)
        items = sorted((n / parity[k], k, n) for k in groups for n in range(parity[k]))
        last = first + tier.num_packets
        if items:
            start, end = sum(times[first:last]) / tier.num_packets, max(times[first:last])
            long = max(end, protection.parity_until) - start
            due += [(start + (n + 0.5) / len(items) * long, PARITY, k, i) for n, (_, k, i) in enumerate(items)]
        first, group = last, group + tier.groups
    return tuple((kind, group, symbol) for _, kind, group, symbol in sorted(due))


def _packet_times(present: Sequence[int], spread: float | int) -> list[float]:
    """When packets are due, 0 to 1: each tier evenly over a time that grows from its own share to all of it."""
    num_packets, first, times = max(sum(present), 1), 0, list[float]()
    for size in present:
        start, stop = first / num_packets, (first + size) / num_packets
        start, stop = (1 - spread) * start, (1 - spread) * stop + spread
        times += [start + (n + 0.5) / size * (stop - start) for n in range(size)]
        first += size
    return times
