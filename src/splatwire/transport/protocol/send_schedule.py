"""Sending order of datagrams: symbols of the init segment and repair symbols are placed between the packets."""

from collections.abc import Sequence

from splatwire.transport.protocol.messages import ParityRange
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL, PARITY


def build_send_schedule(
    block_symbols: Sequence[int],
    parity_ranges: Sequence[ParityRange],
    parity: Sequence[int],
    protection: Protection,
    tier_packets: Sequence[int] = (),
) -> tuple[tuple[int, int, int], ...]:
    """Returns the sending order of all datagrams of a stream: symbols of the init segment, packets, repair symbols.

    Args:
        block_symbols: For each source block (separately encoded part of the init segment), number of symbols to send.
        parity_ranges: Parity of consecutive ranges of packets, in sending order.
        parity: Number of repair symbols of each parity group.
        protection: Redundancy.
        tier_packets: Number of packets of each importance tier, without the packets bundled in the init segment. Empty
            if no packets are bundled and all packets count as one tier.

    Returns:
        Three integers for each datagram, as in `SendSchedule.datagrams`.
    """
    num_packets = sum(parity_range.num_packets for parity_range in parity_ranges)
    init_symbols = sorted(((n / size, k, n) for k, size in enumerate(block_symbols) for n in range(size)))
    due = [
        ((n + 0.5) / len(init_symbols) * protection.init_until, INIT_SYMBOL, k, i)
        for n, (_, k, i) in enumerate(init_symbols)
    ]
    num_bundled = num_packets - sum(tier_packets or [num_packets])
    times = [0.0] * num_bundled + _packet_times(tier_packets or [num_packets], protection.tier_spread)
    due += [(times[n], DATA, 0, n) for n in range(num_bundled, num_packets)]
    first = group = 0
    for parity_range in parity_ranges:
        groups = range(group, group + parity_range.groups)
        items = sorted((n / parity[k], k, n) for k in groups for n in range(parity[k]))
        last = first + parity_range.num_packets
        if items:
            start, end = sum(times[first:last]) / parity_range.num_packets, max(times[first:last])
            duration = max(end, protection.parity_until) - start
            due += [(start + (n + 0.5) / len(items) * duration, PARITY, k, i) for n, (_, k, i) in enumerate(items)]
        first, group = last, group + parity_range.groups
    return tuple((kind, group, symbol) for _, kind, group, symbol in sorted(due))


def _packet_times(tier_packets: Sequence[int], tier_overlap: float | int) -> list[float]:
    """Returns the time at which each packet is sent, as a fraction of the whole transfer, 0 to 1.

    Args:
        tier_packets: Number of packets to send of each importance tier, most important tier first.
        tier_overlap: Overlap of the tiers in time: 0 sends them one after another, 1 mixes them evenly.
    """
    num_packets, first, times = max(sum(tier_packets), 1), 0, list[float]()
    for size in tier_packets:
        start, stop = first / num_packets, (first + size) / num_packets
        start, stop = (1 - tier_overlap) * start, (1 - tier_overlap) * stop + tier_overlap
        times += [start + (n + 0.5) / size * (stop - start) for n in range(size)]
        first += size
    return times
