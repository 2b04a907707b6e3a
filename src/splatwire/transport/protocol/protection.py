"""Redundancy options of a sender, and the parity of the packets of a still scene."""

from collections.abc import Sequence
from dataclasses import dataclass

from splatwire.arguments import check_fields
from splatwire.errors import InvalidValueError
from splatwire.transport.fec import ALIGNMENT, MAX_REPAIR, MAX_SYMBOLS, num_symbols
from splatwire.transport.protocol.messages import ParityRange
from splatwire.transport.protocol.wire import INIT_SYMBOL_OVERHEAD, MAX_DATAGRAM

MAX_INIT_SYMBOL_BYTES = (MAX_DATAGRAM - INIT_SYMBOL_OVERHEAD) // ALIGNMENT * ALIGNMENT - 32
MIN_SYMBOL_BYTES = 64
MAX_RETRANSMIT_SHARE = 4.0


@dataclass(frozen=True)
class Protection:
    """Redundancy of a transfer: repair symbols of the erasure code, sending order, and limits on retransmission.

    Attributes:
        init_repair: Repair symbols per source symbol of the init segment, 0 to 2.
        init_until: End of the interval in which the symbols of the init segment are sent, 0 to 1: 0 is the time of the
            first packet of the stream, 1 is the time of the last packet. With 0, the init segment is sent before all
            packets, so that the first picture appears early. Larger values survive longer bursts of losses.
        init_symbol_bytes: Size of the init segment's symbols in bytes, a multiple of 8; None for the default.
        bundled_share: Share of the packets that are bundled in the init segment, 0 to 1. These are the first packets in
            sending order. The repair symbols of the init segment protect the bundled packets, too.
        tier_repair: Repair symbols per packet, 0 to 2, for each importance tier, the most important first. Further
            tiers have no parity.
        parity_until: End of the interval in which the repair symbols of a tier are sent, 0 to 1 on the scale of
            `init_until`, but at least until the last packet of the tier. Small values recover packets early, large
            values survive longer bursts.
        tier_spread: Overlap of the tiers in time, 0 to 1: 0 sends the tiers one after another, 1 mixes all tiers
            evenly. Overlap protects small tiers from bursts of losses.
        retransmit_share: Maximum retransmitted bytes as a share of the bytes of the complete stream, 0 to 4; None for
            no limit.
        retransmit_until: Share of the packets, from the start of the sending order, that may be retransmitted, 0 to 1.
        motion: For a sequence, the parity of motion packets: one pair of numbers for each group of pictures. The first
            number is the share of the group's motion packets that get parity, 0 to 1. The second is the number of
            repair symbols per packet with parity, 0 to 2. The last pair applies to all later groups. Each period of a
            live sequence begins with the first pair.

    Raises:
        InvalidValueError: If a number is out of range.
    """

    init_repair: float = 0.35
    init_until: float = 0.0
    init_symbol_bytes: int | None = None
    bundled_share: float = 0.0
    tier_repair: tuple[float, ...] = ()
    parity_until: float = 1.0
    tier_spread: float = 0.0
    retransmit_share: float | None = None
    retransmit_until: float = 1.0
    motion: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)
        checks = [("init_repair", self.init_repair, 2.0), ("init_until", self.init_until, 1.0)]
        checks += [("parity_until", self.parity_until, 1.0), ("tier_spread", self.tier_spread, 1.0)]
        checks += [
            ("bundled_share", self.bundled_share, 1.0),
            ("retransmit_share", self.retransmit_share or 0.0, MAX_RETRANSMIT_SHARE),
        ]
        checks += [("retransmit_until", self.retransmit_until, 1.0)]
        checks += [("repair of a tier", repair, 2.0) for repair in self.tier_repair]
        checks += [("share of motion", share, 1.0) for share, _ in self.motion]
        checks += [("repair of motion", repair, 2.0) for _, repair in self.motion]
        for name, value, high in checks:
            if not 0.0 <= value <= high:
                raise InvalidValueError(f"{name} must be from 0 to {high}, not {value}")
        size = self.init_symbol_bytes
        if size is not None and not (MIN_SYMBOL_BYTES <= size <= MAX_INIT_SYMBOL_BYTES and size % ALIGNMENT == 0):
            raise InvalidValueError(
                f"symbols of side information have a multiple of {ALIGNMENT} bytes from {MIN_SYMBOL_BYTES} to "
                f"{MAX_INIT_SYMBOL_BYTES}, not {size}"
            )

    def motion_of(self, group: int) -> tuple[float, float]:
        """Returns the parity of a group's motion as two numbers.

        The first is the share of motion packets that get parity. The second is the number of repair symbols per packet
        with parity.

        Args:
            group: Index of the group of pictures, from 0.
        """
        return self.motion[min(group, len(self.motion) - 1)] if self.motion else (0.0, 0.0)

    @property
    def limits_retransmission(self) -> bool:
        """True if retransmission is limited to certain packets or to a number of bytes."""
        return self.retransmit_share is not None or self.retransmit_until < 1


def num_bundled_packets(num_packets: int, protection: Protection) -> int:
    """Returns how many packets are bundled in the init segment."""
    return round(protection.bundled_share * num_packets)


def protected_tiers(tiers: Sequence[int], protection: Protection) -> tuple[ParityRange, ...]:
    """Divides the packets of a stream into consecutive ranges, and returns the parity of each range in sending order.

    The first range has the packets that are bundled in the init segment. One range for each importance tier with parity
    follows. The last range has all other packets.

    Args:
        tiers: Importance tier of each packet in sending order, ascending.
        protection: Redundancy; `tier_repair` has the repair symbols per packet of each tier.

    Raises:
        InvalidValueError: If parity is requested for tiers that the stream does not have.
    """
    num_tiers, num_bundled = max(tiers, default=0) + 1, num_bundled_packets(len(tiers), protection)
    if len(protection.tier_repair) > num_tiers:
        raise InvalidValueError(
            f"parity for {len(protection.tier_repair)} tiers, and the stream has {num_tiers}: encode with --tiers"
        )
    sizes = [(tiers[num_bundled:].count(tier), repair) for tier, repair in enumerate(protection.tier_repair)]
    return _parity_ranges([(num_bundled, 0.0), *sizes], len(tiers))


def packets_in_tiers(tiers: Sequence[int], protection: Protection) -> tuple[int, ...]:
    """Counts the packets that are not bundled in the init segment, by importance tier.

    Args:
        tiers: Importance tier of each packet in sending order, ascending.
        protection: Redundancy.

    Returns:
        Number of packets of each tier. If the tiers are sent one after another (`tier_spread` is 0), a single number
        for all tiers together.
    """
    num_bundled = num_bundled_packets(len(tiers), protection)
    if not protection.tier_spread:
        return (len(tiers) - num_bundled,)
    return tuple(tiers[num_bundled:].count(tier) for tier in range(max(tiers, default=0) + 1))


def _parity_ranges(sizes: Sequence[tuple[int, float]], num_packets: int) -> tuple[ParityRange, ...]:
    ranges, first = [], 0
    for size, share in sizes:
        groups = -(-size // MAX_SYMBOLS) if share else 0
        repair = min(round(share * num_symbols(size, groups)), MAX_REPAIR) if groups else 0
        if size:
            ranges.append(ParityRange(size, groups if repair else 0, repair))
            first += size
    if first < num_packets or not ranges:
        ranges.append(ParityRange(num_packets - first, 0, 0))
    return tuple(ranges)
