"""Packets that a client already has when it resumes a transfer, and that the server does not send again."""

from splatwire.transport.protocol.messages import Have
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.protocol.wire import DATA, DATA_OVERHEAD, PARITY, WELCOME


class KnownPackets:
    """Packets that a client has reported as received in an earlier transfer."""

    def __init__(self) -> None:
        self._packets = bytearray()
        self._has_init_segment = False

    def add(self, message: Have, stream: ServedStream) -> int:
        """Records which packets a client already has, and returns the number of bytes that therefore need not be sent.

        Args:
            message: Datagram of the client with a list of its packets. Ignored if the list is for another stream or a
                live stream, or begins after the last packet.
            stream: Stream that the server sends to the client.
        """
        count, at = len(stream.packets), message.first // 8
        if message.stream_id != stream.stream_id or stream.is_live or message.first >= count:
            return 0
        size = stream.init_segment_bytes if message.has_init_segment and not self._has_init_segment else 0
        self._has_init_segment = self._has_init_segment or bool(message.has_init_segment)
        end = min(at + len(message.held), -(-count // 8))
        self._packets.extend(bytes(max(end - len(self._packets), 0)))
        for byte in range(at, end):
            if new := message.held[byte - at] & ~self._packets[byte]:
                self._packets[byte] |= new
                new_packets = (8 * byte + n for n in range(8) if new >> n & 1)
                size += sum(DATA_OVERHEAD + len(packet) for n in new_packets for packet in stream.packets[n : n + 1])
        return size

    def has(self, item: tuple[int, int, int], stream: ServedStream) -> bool:
        """True if the server can skip a datagram, because the client has data of an earlier transfer.

        This is the case for a packet that the client has, and for a repair symbol if the client has all packets of its
        parity group. If the client has the init segment, it is also the case for the symbols of the init segment.

        Args:
            item: The datagram as three integers, as in `SendSchedule.datagrams`.
            stream: Stream that the server sends to the client.
        """
        kind, group, symbol = item
        if kind == DATA:
            return self._has_packet(symbol)
        if kind == PARITY:
            if not self._packets:
                return False
            parity_group = stream.parity_groups[group]
            return all(self._has_packet(parity_group.packet_of(number)) for number in range(parity_group.size))
        return self._has_init_segment and kind != WELCOME

    def _has_packet(self, index: int) -> bool:
        """True if the client has the packet with this index in sending order."""
        return index // 8 < len(self._packets) and bool(self._packets[index // 8] >> index % 8 & 1)
