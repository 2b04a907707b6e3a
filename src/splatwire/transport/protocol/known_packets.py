"""Packets that a client already has when it resumes a transfer, and that the server does not send again."""

from splatwire.transport.protocol.messages import Have
from splatwire.transport.protocol.send_schedule import ScheduledDatagram
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.protocol.wire import DATA, DATA_OVERHEAD, PARITY, WELCOME


class KnownPackets:
    """Packets that a client has reported as received in an earlier transfer."""

    def __init__(self) -> None:
        self._packet_mask = bytearray()
        self._has_init_segment = False

    def add(self, message: Have, stream: ServedStream) -> int:
        """Records which packets a client already has, and returns the number of bytes that therefore need not be sent.

        Args:
            message: Datagram of the client with a list of its packets. Ignored if the list is for another stream or a
                live stream that may still grow, or begins after the last packet.
            stream: Stream that the server sends to the client.
        """
        num_packets, first_byte = len(stream.packets), message.first // 8
        if message.stream_id != stream.stream_id or stream.is_live or message.first >= num_packets:
            return 0
        num_bytes = stream.init_segment_bytes if message.has_init_segment and not self._has_init_segment else 0
        self._has_init_segment = self._has_init_segment or bool(message.has_init_segment)
        end = min(first_byte + len(message.held), -(-num_packets // 8))
        self._packet_mask.extend(bytes(max(end - len(self._packet_mask), 0)))
        for byte in range(first_byte, end):
            if new := message.held[byte - first_byte] & ~self._packet_mask[byte]:
                self._packet_mask[byte] |= new
                new_indices = (8 * byte + n for n in range(8) if new >> n & 1)
                num_bytes += sum(DATA_OVERHEAD + len(stream.packets[n]) for n in new_indices if n < num_packets)
        return num_bytes

    def has(self, item: ScheduledDatagram, stream: ServedStream) -> bool:
        """True if the server can skip a datagram, because the client has data of an earlier transfer.

        This is the case for a packet that the client has, and for a repair symbol if the client has all packets of its
        parity group. If the client has the init segment, it is also the case for the symbols of the init segment.

        Args:
            item: The datagram.
            stream: Stream that the server sends to the client.
        """
        kind, group, index = item
        if kind == DATA:
            return self._has_packet(index)
        if kind == PARITY:
            if not self._packet_mask:
                return False
            parity_group = stream.parity_groups[group]
            return all(self._has_packet(parity_group.packet_of(n)) for n in range(parity_group.size))
        return self._has_init_segment and kind != WELCOME

    def _has_packet(self, index: int) -> bool:
        """True if the client has the packet with this index in sending order."""
        return index // 8 < len(self._packet_mask) and bool(self._packet_mask[index // 8] >> index % 8 & 1)
