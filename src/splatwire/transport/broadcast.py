"""A stream that grows while it is served: an edition of its program after each group of frames."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from splatwire.errors import InvalidValueError
from splatwire.packets import Manifest, Packet, make_packet
from splatwire.transport.fec import MAX_SYMBOLS, framed_bytes
from splatwire.transport.frames import MORE, TierHead
from splatwire.transport.layout import head_object
from splatwire.transport.motion import Arranged, GroupPackets, arrange
from splatwire.transport.program import MAX_PACKET_BYTES, Program, head_symbols, parity_symbols, side_symbol_bytes
from splatwire.transport.protection import Protection
from splatwire.transport.timetable import timetable
from splatwire.transport.wire import DATA, PARITY, SIDE

PROTECTION = Protection(side_repair=0.6)
"""Of the head objects, which are small and come with every group."""

Worth = Callable[[Sequence[Packet]], Sequence[float]]
"""What losing each of some packets of the newest group costs."""


@dataclass(frozen=True, eq=False)
class Edition(Program):
    """All that may be sent of a stream by now.

    Attributes:
        lasting: Which packets are sent again until they are there, a byte each; of others the content is forgotten
            once their time has passed.
        newest: The first packet whose time has not.
    """

    lasting: bytes = b""
    newest: int = 0

    def resends(self, index: int) -> bool:
        """Whether a packet is worth sending, once or again."""
        return index < len(self.packets) and (index >= self.newest or bool(self.lasting[index]))


class Broadcast:
    """Makes editions; packets keep their places from one to the next.

    Args:
        protection: Where redundancy goes: repair of head objects, which are small and come with every group, and parity
            for the motion of each group.
        worth: Tells what losing each of some packets of motion costs; None: all alike.
    """

    def __init__(self, protection: Protection = PROTECTION, worth: Worth | None = None) -> None:
        self._protection, self._worth = protection, worth
        self._packets: list[bytes] = []
        self._lasting = bytearray()
        self._newest = self._groups = self._codes = 0
        self._runs: tuple[TierHead, ...] = ()
        self._parity: tuple[tuple[bytes, ...], ...] = ()
        self._fresh: tuple[tuple[int, int, int], ...] = ()

    def add(self, manifest: Manifest, side_info: bytes, packets: Sequence[Packet]) -> Edition:
        """The program after one more group.

        Args:
            manifest: Of the stream so far.
            side_info: Its side information so far.
            packets: Of the group, of no stream yet, in the order in which they shall leave; what lasts leaves first.

        Raises:
            InvalidValueError: If a packet is too large for a datagram, or the manifest counts others.
            BackendUnavailableError: If parity is asked for and the package `raptorq` is not installed.
        """
        plan = manifest.plan
        for index in range(self._newest, len(self._packets)):
            if not self._lasting[index]:
                self._packets[index] = b""
        self._newest = len(self._packets)
        ordered = sorted(packets, key=lambda packet: not plan.lasting(packet.id.block))
        found = self._arranged(ordered, manifest)
        for packet in (ordered[number] for number in found.order):
            named = make_packet(packet.id, packet.num_elements, packet.payload, manifest.stream_id)
            if len(named.data) > MAX_PACKET_BYTES:
                raise InvalidValueError(f"a packet of {len(named.data)} bytes fits no datagram")
            self._packets.append(named.data)
            self._lasting.append(plan.lasting(packet.id.block))
        if len(self._packets) != manifest.num_packets:
            raise InvalidValueError(f"{len(self._packets)} packets, and the manifest says {manifest.num_packets}")
        self._protect(found.tiers)
        return self._edition(manifest, side_info, more=True)

    def end(self, manifest: Manifest, side_info: bytes) -> Edition:
        """The program after the last group."""
        return self._edition(manifest, side_info, more=False)

    def _arranged(self, ordered: Sequence[Packet], manifest: Manifest) -> Arranged:
        plan, (share, repair) = manifest.plan, self._protection.motion_of(self._groups)
        worth = self._worth(ordered) if self._worth and repair and share < 1 else None
        lasting = [plan.lasting(packet.id.block) for packet in ordered]
        kinds = ([n for n, lasts in enumerate(lasting) if lasts is kind] for kind in (True, False))
        group = GroupPackets(*map(tuple, kinds))
        self._groups += 1
        return arrange([group], worth, self._protection, self._groups - 1)

    def _protect(self, tiers: tuple[TierHead, ...]) -> None:
        """Makes the parity of the newest packets; codes of those before have passed, and keep their numbers."""
        before, newest = max(self._codes, -(-self._newest // MAX_SYMBOLS)), self._packets[self._newest :]
        past = (TierHead(self._newest, before, 0),) if self._newest else ()
        before = before if past else 0
        parity = parity_symbols(newest, tiers, framed_bytes(MAX_PACKET_BYTES))
        items = timetable([], tiers, [*map(len, parity)], replace(self._protection, parity_until=0.0), [len(newest)])
        firsts = {DATA: self._newest, PARITY: 0}
        self._runs, self._parity = (*past, *tiers), (*((),) * before, *parity)
        self._fresh = tuple((kind, group + before * (kind == PARITY), n + firsts[kind]) for kind, group, n in items)
        self._codes = before + len(parity)

    def _edition(self, manifest: Manifest, side_info: bytes, *, more: bool) -> Edition:
        data = head_object(manifest, side_info)
        symbol_bytes = side_symbol_bytes(len(data))
        head, scheduled = head_symbols(data, symbol_bytes, self._protection)
        side = [(SIDE, segment, symbol) for segment, count in enumerate(scheduled) for symbol in range(count)]
        bases = ((DATA, 0, n) for n in range(self._newest) if self._lasting[n])
        runs = self._runs or (TierHead(0, 0, 0),)
        return Edition(
            manifest.stream_id, len(data), hashlib.sha256(data).digest(), symbol_bytes, head, tuple(self._packets),
            MAX_PACKET_BYTES, 0, (*runs, *((MORE,) if more else ())), self._parity,
            (*side, *bases, *self._fresh), lasting=bytes(self._lasting), newest=self._newest,
        )  # fmt: skip
