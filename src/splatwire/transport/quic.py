"""What both ends of a QUIC session share: configuration, framing of the reliable stream, who governs the rate."""

import functools
import logging
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from splatwire.errors import BackendUnavailableError, BitstreamError
from splatwire.transport.certificate import INSTALL
from splatwire.transport.delivered import DeliveredWindow
from splatwire.transport.wire import MAX_DATAGRAM, ON_STREAM, kind_of

ALPN = "splatwire/1"
ALPN_HTTP = "h3"
WEBTRANSPORT_PATH = "/splatwire"
STREAM = 0
"""The one stream of a native session: the client's first bidirectional one."""
MAX_UDP_BYTES = 1232
"""QUIC packets: what the smallest path of IPv6 (1280 bytes) carries. A datagram of ours and QUIC's headers fit."""
MAX_DATAGRAM_FRAME = 1 << 16
WINDOW_BYTES = 4 << 20
"""Most bytes in flight of one session, and most that a peer may send on streams ahead of their reading."""
UNREAD_BYTES = 1 << 16
"""Most bytes of a client's streams that may wait for a gap before them to be filled, all streams together."""
OUTSIDE_BYTES = 1 << 13
"""Most bytes that a client of HTTP/3 may say outside the stream of its session, as long as the connection lasts:
settings, requests, compression of headers. aioquic keeps a frame until it is whole and reads it again with every
piece."""
LEAST_BYTES = 16
"""What is counted for a piece, however small."""
STREAMS = 16
"""Streams of each direction that a client may have open."""
RATE_CONTROL = "splatwire"

REFUSED, MALFORMED, FULL, INTERNAL = 1, 2, 3, 4
"""Application error codes (native sessions and HTTP/3 connections that are closed by us)."""


@dataclass(frozen=True)
class QuicLimits:
    """What a QUIC server spends besides what `ServerLimits` says of its transfers.

    Attributes:
        connections: Connections at once, handshakes included.
        per_network: The same of one network (`admission.network_of`).
        origins: Web pages that may open WebTransport sessions, e.g. `https://example.org`; None lets all.
    """

    connections: int = 512
    per_network: int = 32
    origins: tuple[str, ...] | None = None


class FrameReader:
    """Cuts a reliable stream into frames: each behind its size, u16 little-endian."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Takes what came; gives the frames that are complete now.

        Raises:
            BitstreamError: If a size is impossible; nothing after it can be read.
        """
        self._buffer += data
        frames, at = [], 0
        while len(self._buffer) - at >= 2:
            size = int.from_bytes(self._buffer[at : at + 2], "little")
            if not 1 <= size <= MAX_DATAGRAM:
                raise BitstreamError(f"a frame of {size} bytes on the stream")
            if len(self._buffer) - at < 2 + size:
                break
            frames.append(bytes(self._buffer[at + 2 : at + 2 + size]))
            at += 2 + size
        del self._buffer[:at]
        return frames


def stream_frame(data: bytes) -> bytes:
    """A frame as it stands on the reliable stream."""
    return len(data).to_bytes(2, "little") + data


def on_stream(data: bytes) -> bool:
    """Whether a frame travels on the reliable stream rather than as a DATAGRAM."""
    return kind_of(data) in ON_STREAM


def send_on_stream(quic: Any, stream: int, data: bytes) -> bool:
    """Writes to a stream; tells whether QUIC took it.

    It does not where the peer has given up the stream: that is so before the event that says it has its turn.
    """
    try:
        quic.send_stream_data(stream, data)
    except (RuntimeError, ValueError):
        return False
    return True


def need_aioquic() -> Any:
    """The package `aioquic`.

    Raises:
        BackendUnavailableError: If it is not installed.
    """
    try:
        import aioquic
    except ImportError as error:
        raise BackendUnavailableError("aioquic", INSTALL) from error
    logging.getLogger("quic").addHandler(logging.NullHandler())  # what went wrong is told as an event, not printed
    return aioquic


def configuration(*, is_client: bool, alpn: list[str], idle_s: float) -> Any:
    """An aioquic configuration for either end."""
    need_aioquic()
    from aioquic.quic.configuration import QuicConfiguration

    _register_rate_control()
    return QuicConfiguration(
        is_client=is_client,
        alpn_protocols=alpn,
        idle_timeout=idle_s,
        max_datagram_size=MAX_UDP_BYTES,
        max_datagram_frame_size=MAX_DATAGRAM_FRAME,
        max_data=WINDOW_BYTES if is_client else 1 << 18,
        max_stream_data=WINDOW_BYTES if is_client else 1 << 16,
        congestion_control_algorithm=RATE_CONTROL,
    )


@functools.cache
def _register_rate_control() -> None:
    """Lets the transfer's own rate control govern: QUIC's usual ones take every random loss for a full path.

    Everything that a session sends, symbols of the reliable stream too, leaves when the transfer's pacer says so, and
    that follows the receiver's reports (`pacing.RateControl`). These tell nothing of the stream, nor of what QUIC sends
    again: what is under way is bounded here by what is delivered.
    """
    from aioquic.quic.congestion.base import QuicCongestionControl, register_congestion_control

    class Bounded(QuicCongestionControl):
        def __init__(self, *, max_datagram_size: int) -> None:
            super().__init__(max_datagram_size=max_datagram_size)
            self._window = DeliveredWindow()
            self.congestion_window = int(self._window.bytes)

        def on_packet_acked(self, *, now: float, packet: Any) -> None:
            self.bytes_in_flight -= packet.sent_bytes
            self._window.arrived(now, float(packet.sent_bytes), now - packet.sent_time)
            self.congestion_window = min(int(self._window.bytes), WINDOW_BYTES)

        def on_packet_sent(self, *, packet: Any) -> None:
            self.bytes_in_flight += packet.sent_bytes

        def on_packets_expired(self, *, packets: Iterable[Any]) -> None:
            self.bytes_in_flight -= sum(packet.sent_bytes for packet in packets)

        def on_packets_lost(self, *, now: float, packets: Iterable[Any]) -> None:
            self.bytes_in_flight -= sum(packet.sent_bytes for packet in packets)

        def on_persistent_congestion(self) -> None:
            pass  # the client's silence ends its transfer

        def on_rtt_measurement(self, *, now: float, rtt: float) -> None:
            pass

    register_congestion_control(RATE_CONTROL, Bounded)


def has_token(data: bytes) -> bool:
    """Whether a packet with a long header shows what an earlier Retry gave."""
    from aioquic.buffer import Buffer
    from aioquic.quic.packet import pull_quic_header

    try:
        return bool(pull_quic_header(Buffer(data=data)).token)
    except ValueError:
        return False
