"""State of a transfer on the receiver: the stream as far as it has been received."""

import warnings

from splatwire.bitstream import Manifest, ReadReport, SceneStream
from splatwire.transport.protocol.collect import InitSegmentCollector, PacketCollector
from splatwire.transport.protocol.events import Finished
from splatwire.transport.protocol.messages import Data, Welcome

MAX_WAITING_PACKETS = 512
"""Maximum number of packets kept until the server's updated declaration (welcome) of a live stream arrives. Over QUIC,
datagrams may overtake the declaration, which is sent on the reliable stream.
"""


class ReceiveState:
    """State of a transfer on the receiver: stream received so far, and counters.

    Attributes:
        finished: Result of the transfer; None while the transfer runs.
        num_datagrams: Number of received datagrams that belong to this transfer.
        num_rejected: Number of received datagrams that are invalid or do not belong to this transfer.
        num_bytes: Total size of all valid datagrams in bytes.
    """

    def __init__(self) -> None:
        self.finished: Finished | None = None
        self.num_datagrams = self.num_rejected = self.num_bytes = 0
        self._welcome: Welcome | None = None
        self._init_segment: InitSegmentCollector | None = None
        self._collector: PacketCollector | None = None
        self._manifest: Manifest | None = None
        self._side_info = b""
        self._waiting_packets: list[Data] = []
        self._was_live = False
        self._num_before_joining = self._num_missed_before = 0

    def _begin(self, welcome: Welcome, *, discard: bool) -> None:
        """Prepares to receive the stream that the server has declared.

        Args:
            welcome: Server's response with the sizes of the stream, already checked.
            discard: True to discard all data received before.
        """
        if discard or self._collector is None:
            self._num_missed_before = self.num_missed
            self._num_before_joining = welcome.num_packets if welcome.is_live else 0
        self._welcome, self._init_segment = welcome, InitSegmentCollector(welcome)
        self._was_live = welcome.is_live or (self._was_live and not discard)
        if discard or self._collector is None:
            self._collector, self._manifest, self._side_info = PacketCollector(welcome), None, b""
        else:
            self._collector.extend(welcome)
        waiting, self._waiting_packets = self._waiting_packets, []
        for message in waiting:
            self._collector.add(message)

    def _resume(self, before: Welcome, welcome: Welcome) -> bool:
        """Continues an interrupted transfer with the data received before the interruption.

        Args:
            before: Server's response in the earlier transfer.
            welcome: Server's response in the new transfer.

        Returns:
            True if the transfer continues. False if this is impossible, because no data were received before or the
            server now offers a different stream.
        """
        if self._collector is None or welcome.stream_id != before.stream_id:
            return False
        is_same = welcome.digest == before.digest and _order_parameters(welcome) == _order_parameters(before)
        has_grown = before.is_live and welcome.num_packets >= before.num_packets
        if not is_same and not has_grown:
            return False
        if is_same:
            self._welcome = welcome
        else:
            self._begin(welcome, discard=False)
        return True

    def _is_for_next_state(self, message: Data) -> bool:
        """Returns True if a datagram belongs to a newer state of a live stream than the server has declared so far.

        Such a datagram is stored until the server declares that state. If too many are stored already, it is dropped.

        Args:
            message: Datagram with a packet.
        """
        welcome = self._welcome
        if welcome is None or not welcome.is_live:
            return False
        is_declared = message.packet_index < welcome.num_packets and message.packet[1:5] == welcome.stream_id.to_bytes(
            4, "little"
        )
        if not is_declared and len(self._waiting_packets) < MAX_WAITING_PACKETS:
            self._waiting_packets.append(message)
        return not is_declared

    @property
    def was_live(self) -> bool:
        """True if the stream is a live stream, or was one until it ended."""
        return self._was_live

    @property
    def is_live(self) -> bool:
        """Deprecated name of `was_live`."""
        warnings.warn("Receiver.is_live is deprecated, use was_live", DeprecationWarning, stacklevel=2)
        return self.was_live

    @property
    def num_missed(self) -> int:
        """Number of packets of a live sequence that have not arrived, counted since this receiver joined."""
        if self._welcome is None or self._collector is None or not self._was_live:
            return self._num_missed_before
        # Packets from before it joined do not count: the server does not send their motion to late receivers.
        missing = self._collector.missing(self._num_before_joining, self._welcome.num_packets)
        return self._num_missed_before + sum(1 for _ in missing)

    @property
    def welcome(self) -> Welcome | None:
        """Server's response with the sizes of the stream (welcome), or None before its arrival."""
        return self._welcome

    @property
    def preview(self) -> bytes:
        """Encoded preview; empty before the server's response, or without a preview."""
        return self._welcome.preview if self._welcome else b""

    @property
    def collector(self) -> PacketCollector | None:
        """Collector of the packets; None before the server's response."""
        return self._collector

    def stream(self) -> SceneStream | None:
        """Returns the stream with the packets received so far, or None until the side information is complete."""
        if self._manifest is None or self._collector is None:
            return None
        return SceneStream(self._manifest, self._side_info, self._collector.packets)

    def report(self) -> ReadReport | None:
        """Returns the numbers of received, missing and damaged packets; None until the side information is complete."""
        intake = self._collector.intake if self._collector else None
        return intake.report() if intake else None

    def describe_missing(self) -> str:
        """Returns a message about missing data, or an empty text before the server's response."""
        if self._welcome is None or self._collector is None:
            return ""
        packets = f"{self._collector.num_packets} of {self._welcome.num_packets} packets arrived"
        if self._init_segment is None:
            return packets
        missing, total = self._init_segment.num_missing, self._init_segment.num_symbols
        return f"of the side information at least {missing} of {total} pieces are missing; {packets}"


def _order_parameters(welcome: Welcome) -> tuple[object, ...]:
    """Returns the parameters of a stream that determine the sending order of its packets."""
    sizes = welcome.init_segment_bytes, welcome.symbol_bytes, welcome.num_packets, welcome.num_bundled
    return *sizes, welcome.parity_ranges, welcome.is_live, welcome.view_dependent
