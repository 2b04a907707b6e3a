"""Where redundancy goes: what a sender may choose, and which runs of packets share a code."""

from collections.abc import Sequence
from dataclasses import dataclass

from splatwire.errors import InvalidValueError
from splatwire.transport.fec import ALIGNMENT, MAX_REPAIR, MAX_SYMBOLS, num_symbols
from splatwire.transport.frames import TierHead
from splatwire.transport.wire import MAX_DATAGRAM, SIDE_OVERHEAD

SIDE_SYMBOL_BYTES = (MAX_DATAGRAM - SIDE_OVERHEAD) // ALIGNMENT * ALIGNMENT - 32
MIN_SYMBOL_BYTES = 64
MOST_RESENT = 4.0


@dataclass(frozen=True)
class Protection:
    """Where redundancy goes.

    Attributes:
        side_repair: Repair symbols of manifest and side information for each symbol, 0 to 2. With a way back they are
            sent again on request anyway.
        side_lead: Symbols of the head object are sent between this first share of the packets, 0 to 1: 0 sends them
            first of all, which shows something soon; large survives longer bursts without a way back.
        side_symbol_bytes: Size of the symbols of the head object, a multiple of 8; None chooses. Many small ones need
            fewer repair bytes (the share of many that is lost varies less), yet each has its own headers.
        head_share: Share of the packets, the first in sending order, that travel in the head object, 0 to 1: they are
            there when it is, and under its repair. A small tier costs less there than under parity of its own, because
            the share that is lost of many symbols varies less than that of few; nothing is drawn before the head object
            is complete anyway.
        tier_repair: Repair symbols for each packet of the stream's tiers of importance, tier 0 (which travels first)
            first, 0 to 2; tiers beyond have no parity.
        parity_until: Parity of a tier leaves between its middle and this share of all packets (or its own end, if that
            is later), 0 to 1: small brings lost packets back soon, large survives longer bursts.
        tier_spread: How far tiers overlap in time: 0 sends one after the other, 1 mixes all of them evenly over the
            whole transfer. A tier that is sent in one go is short, and one burst takes much of it; a tier that is
            spread loses its own share of whatever is cut off at the end.
        resend: Most bytes that are sent again because a client asks, as a share of one pass, 0 to 4. What the head
            object lacks is sent in any case and counts first; what is left is for packets in the order in which they
            are missed, which is that of importance while tiers travel one after the other. None: whatever is asked for,
            up to the limits of the server.
        resend_until: Share of the packets, the first in sending order, that are sent again at all, 0 to 1. Of a stream
            with tiers these are the important ones: what is spent then goes to them in every transfer, where `resend`
            alone runs out in those that lose most and buys little in those that lose least.
        motion: Of a clip, group after group of frames: share of the packets of its motion that are protected, 0 to 1
            (the dearest ones), and repair symbols for each of them, 0 to 2. The last pair goes on for the groups after
            it. Parity of a group leaves with its motion: it is of no use later.

    Raises:
        InvalidValueError: If a number is out of range.
    """

    side_repair: float = 0.35
    side_lead: float = 0.0
    side_symbol_bytes: int | None = None
    head_share: float = 0.0
    tier_repair: tuple[float, ...] = ()
    parity_until: float = 1.0
    tier_spread: float = 0.0
    resend: float | None = None
    resend_until: float = 1.0
    motion: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        checks = [("side_repair", self.side_repair, 2.0), ("side_lead", self.side_lead, 1.0)]
        checks += [("parity_until", self.parity_until, 1.0), ("tier_spread", self.tier_spread, 1.0)]
        checks += [("head_share", self.head_share, 1.0), ("resend", self.resend or 0.0, MOST_RESENT)]
        checks += [("resend_until", self.resend_until, 1.0)]
        checks += [("repair of a tier", repair, 2.0) for repair in self.tier_repair]
        checks += [("share of motion", share, 1.0) for share, _ in self.motion]
        checks += [("repair of motion", repair, 2.0) for _, repair in self.motion]
        for name, value, high in checks:
            if not 0.0 <= value <= high:
                raise InvalidValueError(f"{name} must be from 0 to {high}, not {value}")
        size = self.side_symbol_bytes
        if size is not None and not (MIN_SYMBOL_BYTES <= size <= SIDE_SYMBOL_BYTES and size % ALIGNMENT == 0):
            raise InvalidValueError(
                f"symbols of side information have a multiple of {ALIGNMENT} bytes from {MIN_SYMBOL_BYTES} to "
                f"{SIDE_SYMBOL_BYTES}, not {size}"
            )

    def motion_of(self, group: int) -> tuple[float, float]:
        """Share of a group's motion that is protected, and repair symbols for each packet of it."""
        return self.motion[min(group, len(self.motion) - 1)] if self.motion else (0.0, 0.0)

    @property
    def limits_resending(self) -> bool:
        """Whether less is sent again than what is asked for."""
        return self.resend is not None or self.resend_until < 1


def carried_packets(num_packets: int, protection: Protection) -> int:
    """How many packets travel in the head object."""
    return round(protection.head_share * num_packets)


def protected_tiers(tiers: Sequence[int], protection: Protection) -> tuple[TierHead, ...]:
    """Protection of runs of packets; those in the head object, which come first, need no parity.

    Args:
        tiers: Tier of importance of each packet, in sending order: ascending.
        protection: Where redundancy goes.

    Raises:
        InvalidValueError: If there is parity for tiers that the stream does not have.
    """
    present, carried = max(tiers, default=0) + 1, carried_packets(len(tiers), protection)
    if len(protection.tier_repair) > present:
        raise InvalidValueError(
            f"parity for {len(protection.tier_repair)} tiers, and the stream has {present}: encode with --tiers"
        )
    runs = [(tiers[carried:].count(tier), repair) for tier, repair in enumerate(protection.tier_repair)]
    return _tier_heads([(carried, 0.0), *runs], len(tiers))


def packets_in_tiers(tiers: Sequence[int], protection: Protection) -> tuple[int, ...]:
    """Packets of each tier of importance outside of the head object; all in one unless tiers are spread.

    Args:
        tiers: Tier of importance of each packet, in sending order: ascending.
        protection: Whether tiers are spread.
    """
    carried = carried_packets(len(tiers), protection)
    if not protection.tier_spread:
        return (len(tiers) - carried,)
    return tuple(tiers[carried:].count(tier) for tier in range(max(tiers, default=0) + 1))


def _tier_heads(runs: Sequence[tuple[int, float]], num_packets: int) -> tuple[TierHead, ...]:
    heads, first = [], 0
    for size, share in runs:
        groups = -(-size // MAX_SYMBOLS) if share else 0
        repair = min(round(share * num_symbols(size, groups)), MAX_REPAIR) if groups else 0
        if size:
            heads.append(TierHead(size, groups if repair else 0, repair))
            first += size
    if first < num_packets or not heads:
        heads.append(TierHead(num_packets - first, 0, 0))
    return tuple(heads)
