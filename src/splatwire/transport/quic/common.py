"""Parts shared by QUIC client and server: configuration, framing of the reliable stream, congestion control."""

import functools
import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.congestion.base import QuicCongestionControl, register_congestion_control

from splatwire.errors import BitstreamError
from splatwire.transport.congestion.delivery_rate import DeliveryRateWindow
from splatwire.transport.http.origins import is_loopback_origin
from splatwire.transport.protocol.wire import MAX_DATAGRAM, STREAM_MESSAGES, message_kind

ALPN = "splatwire/1"
ALPN_HTTP = "h3"
WEBTRANSPORT_PATH = "/splatwire"
SESSION_STREAM = 0
"""Number of the reliable QUIC stream in a session without HTTP/3: the client's first bidirectional stream."""
MAX_UDP_BYTES = 1232
"""Maximum UDP payload of QUIC packets, bytes: fits the IPv6 minimum MTU of 1280. Leaves room for a datagram of
`MAX_DATAGRAM` bytes and QUIC's headers.
"""
MAX_DATAGRAM_FRAME = 1 << 16
WINDOW_BYTES = 4 << 20
"""Maximum number of bytes in flight per connection; also the flow-control window of clients for a server's data."""
MAX_UNREAD_BYTES = 1 << 16
"""Maximum number of bytes, over all streams and the handshake of a client, that are buffered because earlier bytes are
missing.
"""
MIN_COUNTED_BYTES = 512
"""Minimum number of bytes that a QUIC packet of a server counts in flight. It limits the number of small packets in
flight, which take as much memory as large ones.
"""
MAX_UNACKNOWLEDGED = 3 * WINDOW_BYTES // (2 * MIN_COUNTED_BYTES)
"""Maximum number of sent QUIC packets per connection that wait for an acknowledgement: 1.5 times the packets that may
be in flight. The others contain only acknowledgements, which `WINDOW_BYTES` does not limit.
"""
MAX_OUTSIDE_BYTES = 1 << 13
"""Maximum number of bytes that an HTTP/3 client may send during a connection outside the stream of its WebTransport
session: settings, requests and header compression. The limit is needed because aioquic buffers incomplete HTTP/3 frames
and parses an incomplete frame again with every fragment.
"""
MIN_FRAGMENT_BYTES = 16
"""Minimum number of bytes that a fragment of a frame counts towards `MAX_OUTSIDE_BYTES`."""
MAX_STREAMS = 16
"""Maximum number of open QUIC streams per client and direction."""
RATE_CONTROL, CLIENT_RATE_CONTROL = "splatwire", "splatwire client"
MAX_PROBE_INTERVAL_S = 0.4
"""Time up to which the interval of QUIC's probes (PTO) doubles with each probe, seconds. On paths with long round
trips, the interval may be longer; it then doubles `MIN_BACKOFF` times.

Without a limit, a path that loses half of its packets, or a flood at the server, delays a handshake by many seconds.
With a limit on the number of doublings only, probes on paths with short round trips would be too many.
"""
MIN_BACKOFF = 1
"""Number of doublings of the probe interval that are always permitted."""

REFUSED, MALFORMED, FULL, INTERNAL = 1, 2, 3, 4
"""Application error codes of closed connections.

`REFUSED`: the client refuses the certificate. Sent by the server: `MALFORMED`, a message is invalid; `FULL`, the server
is full, or no request arrived in time; `INTERNAL`, an error of the server.
"""


@dataclass(frozen=True)
class QuicLimits:
    """Limits of a QUIC server on connections.

    Attributes:
        connections: Maximum number of concurrent connections, including handshakes.
        per_network: Maximum number of concurrent connections of one network: an IPv4 address or a /64 prefix of IPv6.
        origins: Web origins whose pages may open WebTransport sessions, such as `https://example.org`; None allows all,
            within `only_local`.
        only_local: True to allow, without `origins`, only pages of this machine and clients that are no pages.
    """

    connections: int = 512
    per_network: int = 32
    origins: tuple[str, ...] | None = None
    only_local: bool = False

    def allows_origin(self, header: bytes | None) -> bool:
        """Returns True if a page may open a session.

        Args:
            header: Value of its `Origin` header, which all browsers send; None without the header.
        """
        origin = None if header is None else header.decode("ascii", "replace")
        if self.origins is not None:
            return origin in self.origins
        return not self.only_local or origin is None or is_loopback_origin(origin)


class MessageReader:
    """Splits a reliable byte stream into messages of the wire protocol.

    The size of each message (u16, little-endian) precedes the message.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Adds received bytes and returns the messages that are complete.

        Raises:
            BitstreamError: If the size of a message is invalid; the rest of the stream cannot be parsed.
        """
        self._buffer += data
        messages, at = [], 0
        while len(self._buffer) - at >= 2:
            size = int.from_bytes(self._buffer[at : at + 2], "little")
            if not 1 <= size <= MAX_DATAGRAM:
                raise BitstreamError(f"a message of {size} bytes on the stream")
            if len(self._buffer) - at < 2 + size:
                break
            messages.append(bytes(self._buffer[at + 2 : at + 2 + size]))
            at += 2 + size
        del self._buffer[:at]
        return messages


def length_prefixed(data: bytes) -> bytes:
    """Returns the bytes of a message on the reliable stream: its size (u16, little-endian), then the message."""
    return len(data).to_bytes(2, "little") + data


def is_stream_message(data: bytes) -> bool:
    """True if a message is sent on the reliable QUIC stream instead of in a DATAGRAM frame."""
    return message_kind(data) in STREAM_MESSAGES


def send_on_stream(quic: Any, stream: int, data: bytes) -> bool:
    """Writes bytes to a QUIC stream.

    Args:
        quic: Connection of aioquic.
        stream: Number of the stream.
        data: Bytes to write.

    Returns:
        True if the bytes were accepted for sending, False if the peer has reset the stream.
    """
    try:
        quic.send_stream_data(stream, data)
    except (RuntimeError, ValueError):
        return False
    return True


def limit_backoff(quic: Any) -> None:
    """Limits the interval between QUIC's probes to `MAX_PROBE_INTERVAL_S`; aioquic has no option for this.

    Args:
        quic: Connection of aioquic.
    """
    loss = quic._loss
    first = loss.get_probe_timeout(include_max_ack_delay=loss.handshake_confirmed)
    doublings = max(MIN_BACKOFF, int(math.log2(MAX_PROBE_INTERVAL_S / first)))
    loss._pto_count = min(loss._pto_count, doublings)


def configuration(*, is_client: bool, alpn: list[str], idle_s: float) -> Any:
    """Returns an aioquic configuration for a client or server.

    Args:
        is_client: True for a client, False for a server.
        alpn: Names of the application protocols for the TLS handshake.
        idle_s: Idle timeout of connections, seconds.
    """
    _register_rate_control()
    return QuicConfiguration(
        is_client=is_client,
        alpn_protocols=alpn,
        idle_timeout=idle_s,
        max_datagram_size=MAX_UDP_BYTES,
        max_datagram_frame_size=MAX_DATAGRAM_FRAME,
        max_data=WINDOW_BYTES if is_client else 1 << 18,
        max_stream_data=WINDOW_BYTES if is_client else 1 << 16,
        congestion_control_algorithm=CLIENT_RATE_CONTROL if is_client else RATE_CONTROL,
    )


@functools.cache
def _register_rate_control() -> None:
    """Registers congestion controllers in aioquic that limit the bytes in flight by the measured delivery rate.

    There is one for servers and one for clients.
    """

    # QUIC's usual controllers would reduce the rate at every random loss. `pacing.RateControl` sets the sending rate of
    # datagrams; this limit also covers the reliable stream and QUIC's retransmissions.
    class Bounded(QuicCongestionControl):
        min_counted_bytes = MIN_COUNTED_BYTES

        def __init__(self, *, max_datagram_size: int) -> None:
            super().__init__(max_datagram_size=max_datagram_size)
            self._window = DeliveryRateWindow()
            self.congestion_window = int(self._window.bytes)

        def on_packet_acked(self, *, now: float, packet: Any) -> None:
            self.bytes_in_flight -= self._counted_bytes(packet)
            self._window.on_acked(now, float(self._counted_bytes(packet)), now - packet.sent_time)
            self.congestion_window = min(int(self._window.bytes), WINDOW_BYTES)

        def on_packet_sent(self, *, packet: Any) -> None:
            self.bytes_in_flight += self._counted_bytes(packet)

        def on_packets_expired(self, *, packets: Iterable[Any]) -> None:
            self.bytes_in_flight -= sum(map(self._counted_bytes, packets))

        def on_packets_lost(self, *, now: float, packets: Iterable[Any]) -> None:
            self.bytes_in_flight -= sum(map(self._counted_bytes, packets))

        def on_persistent_congestion(self) -> None:
            pass  # the server's feedback timeout ends the transfer

        def on_rtt_measurement(self, *, now: float, rtt: float) -> None:
            pass

        def _counted_bytes(self, packet: Any) -> int:
            return max(int(packet.sent_bytes), self.min_counted_bytes)

    class BoundedClient(Bounded):
        min_counted_bytes = 0  # a client has few packets in flight, and its small reports must not wait

    register_congestion_control(RATE_CONTROL, Bounded)
    register_congestion_control(CLIENT_RATE_CONTROL, BoundedClient)
    logging.getLogger("quic").addHandler(logging.NullHandler())  # errors are reported as events, not printed
