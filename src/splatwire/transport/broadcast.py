"""A stream that grows while it is served: an edition of its program after each group of frames."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

from splatwire.errors import InvalidValueError
from splatwire.packets import Manifest, Packet, make_packet
from splatwire.transport.frames import MORE, TierHead
from splatwire.transport.layout import head_object
from splatwire.transport.program import MAX_PACKET_BYTES, Program, head_symbols, side_symbol_bytes
from splatwire.transport.protection import Protection
from splatwire.transport.wire import DATA, SIDE

PROTECTION = Protection(side_repair=0.6)
"""Of the head objects, which are small and come with every group."""


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
    """Makes editions; packets keep their places from one to the next."""

    def __init__(self) -> None:
        self._packets: list[bytes] = []
        self._lasting = bytearray()
        self._newest = 0

    def add(self, manifest: Manifest, side_info: bytes, packets: Sequence[Packet]) -> Edition:
        """The program after one more group.

        Args:
            manifest: Of the stream so far.
            side_info: Its side information so far.
            packets: Of the group, of no stream yet; what lasts leaves first.

        Raises:
            InvalidValueError: If a packet is too large for a datagram, or the manifest counts others.
        """
        plan = manifest.plan
        for index in range(self._newest, len(self._packets)):
            if not self._lasting[index]:
                self._packets[index] = b""
        self._newest = len(self._packets)
        for packet in sorted(packets, key=lambda packet: not plan.lasting(packet.id.block)):
            named = make_packet(packet.id, packet.num_anchors, packet.payload, manifest.stream_id)
            if len(named.data) > MAX_PACKET_BYTES:
                raise InvalidValueError(f"a packet of {len(named.data)} bytes fits no datagram")
            self._packets.append(named.data)
            self._lasting.append(plan.lasting(packet.id.block))
        if len(self._packets) != manifest.num_packets:
            raise InvalidValueError(f"{len(self._packets)} packets, and the manifest says {manifest.num_packets}")
        return self._edition(manifest, side_info, more=True)

    def end(self, manifest: Manifest, side_info: bytes) -> Edition:
        """The program after the last group."""
        return self._edition(manifest, side_info, more=False)

    def _edition(self, manifest: Manifest, side_info: bytes, *, more: bool) -> Edition:
        data = head_object(manifest, side_info)
        symbol_bytes = side_symbol_bytes(len(data))
        head, scheduled = head_symbols(data, symbol_bytes, PROTECTION)
        side = [(SIDE, segment, symbol) for segment, count in enumerate(scheduled) for symbol in range(count)]
        count = len(self._packets)
        worth = (n for n in range(count) if n >= self._newest or self._lasting[n])
        return Edition(
            manifest.stream_id, len(data), hashlib.sha256(data).digest(), symbol_bytes, head, tuple(self._packets),
            MAX_PACKET_BYTES, 0, (TierHead(count, 0, 0), *((MORE,) if more else ())), (),
            (*side, *((DATA, 0, n) for n in worth)), lasting=bytes(self._lasting), newest=self._newest,
        )  # fmt: skip
