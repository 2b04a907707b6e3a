"""Prepares a live sequence for sending: each new group of pictures is added to the stream."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from splatwire.bitstream import Manifest, Packet, make_packet
from splatwire.errors import InvalidValueError
from splatwire.transport.fec import MAX_SYMBOLS, symbol_bytes_for
from splatwire.transport.protocol.layout import init_segment
from splatwire.transport.protocol.messages import ParityRange
from splatwire.transport.protocol.motion_parity import GroupPackets, ProtectedOrder, order_and_protect
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.send_schedule import ScheduledDatagram, build_send_schedule
from splatwire.transport.protocol.served_stream import (
    MAX_PACKET_BYTES,
    ServedStream,
    default_symbol_bytes,
    encode_init_segment,
    parity_symbols,
)
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL, PARITY

PROTECTION = Protection(init_repair=0.6)
"""Default redundancy of live streams: repair symbols for the init segment, which is small and sent with every group of
pictures.
"""

ImportanceFunction = Callable[[Sequence[Packet]], Sequence[float]]
"""Function that returns, for each of the given packets of the newest group of pictures, the cost of losing the packet
(for example the added error of the pictures). Only the ratios of these costs matter.
"""


@dataclass(frozen=True, eq=False)
class LiveSnapshot(ServedStream):
    """Live stream prepared for sending, in its state after a new group of pictures.

    `schedule` is what a client that joins now gets: init segment, keyframe packets so far, and the newest group.
    `packets` has empty bytes for packets that have expired (see `is_still_needed`).

    Attributes:
        persistent: One byte per packet: 1 if later groups of pictures also need the packet, else 0.
        newest_start: Index in sending order of the first packet of the newest group of pictures.
    """

    persistent: bytes = b""
    newest_start: int = 0

    def is_still_needed(self, index: int) -> bool:
        """Returns True if clients still need a packet.

        These are the packets of the newest group of pictures, and packets that later groups also need.

        Args:
            index: Index of the packet in sending order.
        """
        return index < len(self.packets) and (index >= self.newest_start or bool(self.persistent[index]))


class LivePackager:
    """Prepares a growing live stream for sending, each time a group of pictures is complete.

    Args:
        protection: Redundancy of the init segment and of the motion packets.
        importance: Function that returns the cost of losing each packet. The motion packets with the highest costs get
            parity. None for equal costs.
    """

    def __init__(self, protection: Protection = PROTECTION, importance: ImportanceFunction | None = None) -> None:
        self._protection, self._importance = protection, importance
        self._packets: list[bytes] = []
        self._persistent = bytearray()
        self._newest_start = self._num_groups = self._num_parity_groups = 0
        self._parity_ranges: tuple[ParityRange, ...] = ()
        self._parity: tuple[tuple[bytes, ...], ...] = ()
        self._newest_schedule: tuple[ScheduledDatagram, ...] = ()

    def add(self, manifest: Manifest, side_info: bytes, packets: Sequence[Packet]) -> LiveSnapshot:
        """Adds a group of pictures and returns the new state of the stream.

        Args:
            manifest: Manifest of the stream, including the new group.
            side_info: Side information of the stream, including the new group.
            packets: Packets of the new group in sending order. In the result, keyframe packets come first, then the
                motion packets that repair symbols protect, then the others. The result has copies of the packets, with
                the id of the stream.

        Raises:
            InvalidValueError: If a packet is too large for a datagram, or the manifest has another packet count.
            BackendUnavailableError: If parity is requested and the package `raptorq` is not installed.
        """
        plan = manifest.plan
        for index in range(self._newest_start, len(self._packets)):
            if not self._persistent[index]:
                self._packets[index] = b""
        self._newest_start = len(self._packets)
        ordered = sorted(packets, key=lambda packet: not plan.is_keyframe(packet.id.block))
        protected = self._order_and_protect(ordered, manifest)
        for packet in (ordered[index] for index in protected.order):
            data = make_packet(packet.id, packet.num_elements, packet.payload, manifest.stream_id).data
            if len(data) > MAX_PACKET_BYTES:
                raise InvalidValueError(f"a packet of {len(data)} bytes fits no datagram")
            self._packets.append(data)
            self._persistent.append(plan.is_keyframe(packet.id.block))
        if len(self._packets) != manifest.num_packets:
            raise InvalidValueError(f"{len(self._packets)} packets, and the manifest says {manifest.num_packets}")
        self._schedule_with_parity(protected.parity_ranges)
        return self._snapshot(manifest, side_info)

    def _order_and_protect(self, ordered: Sequence[Packet], manifest: Manifest) -> ProtectedOrder:
        plan, (share, repair) = manifest.plan, self._protection.motion_of(self._num_groups)
        importance = self._importance(ordered) if self._importance and repair and share < 1 else None
        is_keyframe = [plan.is_keyframe(packet.id.block) for packet in ordered]
        kinds = ([n for n, found in enumerate(is_keyframe) if found is kind] for kind in (True, False))
        group = GroupPackets(*map(tuple, kinds))
        self._num_groups += 1
        return order_and_protect([group], importance, self._protection, self._num_groups - 1)

    def _schedule_with_parity(self, ranges: tuple[ParityRange, ...]) -> None:
        """Computes the repair symbols of the newest group of pictures, and the order in which its datagrams are sent.

        Args:
            ranges: Ranges of packets that get parity. The order of the packets is fixed already.
        """
        # The repair symbols of earlier groups of pictures are dropped; the numbers of their parity groups stay taken.
        # Each parity group, also one without symbols, has at most `MAX_SYMBOLS` packets.
        num_earlier_parity_groups = max(self._num_parity_groups, -(-self._newest_start // MAX_SYMBOLS))
        packets = self._packets[self._newest_start :]
        earlier_ranges = (ParityRange(self._newest_start, num_earlier_parity_groups, 0),) if self._newest_start else ()
        num_earlier_parity_groups = num_earlier_parity_groups if earlier_ranges else 0
        parity = parity_symbols(packets, ranges, symbol_bytes_for(MAX_PACKET_BYTES))
        schedule = build_send_schedule(
            [], ranges, [*map(len, parity)], replace(self._protection, parity_until=0.0), [len(packets)]
        )
        first_indices = {DATA: self._newest_start, PARITY: 0}
        self._parity_ranges, self._parity = (*earlier_ranges, *ranges), (*((),) * num_earlier_parity_groups, *parity)
        self._newest_schedule = tuple(
            (kind, group + num_earlier_parity_groups * (kind == PARITY), index + first_indices[kind])
            for kind, group, index in schedule
        )
        self._num_parity_groups = num_earlier_parity_groups + len(parity)

    def _snapshot(self, manifest: Manifest, side_info: bytes) -> LiveSnapshot:
        data = init_segment(manifest, side_info)
        symbol_bytes = default_symbol_bytes(len(data))
        init_symbols, num_init_symbols = encode_init_segment(data, symbol_bytes, self._protection)
        init_items = [
            (INIT_SYMBOL, source_block, symbol)
            for source_block, count in enumerate(num_init_symbols)
            for symbol in range(count)
        ]
        keyframes = ((DATA, 0, index) for index in range(self._newest_start) if self._persistent[index])
        return LiveSnapshot(
            manifest.stream_id, len(data), hashlib.sha256(data).digest(), symbol_bytes, init_symbols,
            tuple(self._packets), MAX_PACKET_BYTES, 0, self._parity_ranges or (ParityRange(0, 0, 0),), self._parity,
            (*init_items, *keyframes, *self._newest_schedule), is_live=True, persistent=bytes(self._persistent),
            newest_start=self._newest_start,
        )  # fmt: skip
