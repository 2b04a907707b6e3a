"""Sending order of datagrams: symbols of the init segment and repair symbols are placed between the packets."""

from collections.abc import Sequence
from typing import TypeAlias

from splatwire.transport.protocol.messages import ParityRange
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL, PARITY

ScheduledDatagram: TypeAlias = tuple[int, int, int]
"""Datagram of a sending order or queue: kind, group and index.

* `DATA` (a packet): the group is 0, the index is that of the packet in sending order.
* `INIT_SYMBOL` (a symbol of the init segment): the group is the index of the source block, the part of the init segment
  that is coded separately. The index is that of the symbol in the source block.
* `PARITY` (a repair symbol of packets): the group is the index of the parity group, the index is that of the repair
  symbol in it.
* `WELCOME` (sizes of the stream): the group and the index are 0.

No named tuple: Python's garbage collector skips tuples of integers, and the queues of many clients are long.
"""


def build_send_schedule(
    num_init_symbols: Sequence[int],
    parity_ranges: Sequence[ParityRange],
    num_repair: Sequence[int],
    protection: Protection,
    tier_packets: Sequence[int] = (),
) -> tuple[ScheduledDatagram, ...]:
    """Returns the sending order of all datagrams of a stream: symbols of the init segment, packets, repair symbols.

    Args:
        num_init_symbols: For each source block (separately encoded part of the init segment), number of symbols to
            send.
        parity_ranges: Parity of consecutive ranges of packets, in sending order.
        num_repair: Number of repair symbols of each parity group.
        protection: Redundancy.
        tier_packets: Number of packets of each importance tier, without the packets bundled in the init segment. Empty
            if no packets are bundled and all packets count as one tier.

    Returns:
        Datagrams in sending order.
    """
    num_packets = sum(parity_range.num_packets for parity_range in parity_ranges)
    init_symbols = sorted(
        (n / count, block, n) for block, count in enumerate(num_init_symbols) for n in range(count)
    )  # fmt: skip
    timed = [
        ((n + 0.5) / len(init_symbols) * protection.init_until, INIT_SYMBOL, block, index)
        for n, (_, block, index) in enumerate(init_symbols)
    ]
    num_bundled = num_packets - sum(tier_packets or [num_packets])
    times = [0.0] * num_bundled + _packet_times(tier_packets or [num_packets], protection.tier_spread)
    timed += [(times[n], DATA, 0, n) for n in range(num_bundled, num_packets)]
    first = first_group = 0
    for parity_range in parity_ranges:
        groups = range(first_group, first_group + parity_range.groups)
        symbols = sorted((n / num_repair[group], group, n) for group in groups for n in range(num_repair[group]))
        end = first + parity_range.num_packets
        if symbols:
            start, last = sum(times[first:end]) / parity_range.num_packets, max(times[first:end])
            duration = max(last, protection.parity_until) - start
            timed += [
                (start + (n + 0.5) / len(symbols) * duration, PARITY, group, index)
                for n, (_, group, index) in enumerate(symbols)
            ]
        first, first_group = end, first_group + parity_range.groups
    return tuple((kind, group, index) for _, kind, group, index in sorted(timed))


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
