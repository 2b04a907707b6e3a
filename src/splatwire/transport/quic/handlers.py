"""Clients of the QUIC server, and handlers of their connections.

A connection has splatwire's own application protocol, or WebTransport over HTTP/3.
"""

from typing import Any

from aioquic.buffer import encode_uint_var
from aioquic.h3.connection import H3Connection, ProtocolError
from aioquic.h3.events import DatagramReceived, H3Event, HeadersReceived, WebTransportStreamDataReceived
from aioquic.quic import events

from splatwire.errors import BitstreamError
from splatwire.transport.protocol.messages import Welcome
from splatwire.transport.protocol.wire import MAX_DATAGRAM, WELCOME, decode, message_kind
from splatwire.transport.quic.common import (
    MAX_OUTSIDE_BYTES,
    MIN_FRAGMENT_BYTES,
    SESSION_STREAM,
    WEBTRANSPORT_PATH,
    WINDOW_BYTES,
    MessageReader,
    is_stream_message,
    length_prefixed,
    send_on_stream,
)

REDUNDANT_FRAMES = 8
"""Number of messages at the start of the reliable stream that are also sent as DATAGRAM frames. For most streams these
are the server's first response (welcome) and the init segment, without which nothing can be decoded. A loss on the
reliable stream costs two round trips; with two copies, the first to arrive counts.
"""
MAX_PENDING_MESSAGES = 512
"""Maximum number of messages that wait until the client opens the reliable stream: the client's request as DATAGRAM may
overtake the opening of the stream. The side information of a large scene has some hundred messages.
"""
MAX_PENDING_DATAGRAMS = 2048
"""Maximum number of DATAGRAM frames that wait in QUIC until earlier bytes are acknowledged; further frames are dropped,
as in a full queue on the path. The limit is needed because a client may report datagrams to the protocol core as
received, but never acknowledge them to QUIC.
"""


class ConnectedClient:
    """The server's end of a session with one client: sends messages to the client, and reads those of the client.

    Requests, their responses and the init segment are sent as messages on a reliable stream. Copies of the first few
    of these messages are also sent in QUIC DATAGRAM frames, because the copies may arrive earlier, but not those of a
    second init segment. All other messages are sent in QUIC DATAGRAM frames only.

    Args:
        connection: QUIC connection of the client.
        stream: Number of the reliable stream; None until the client opens the stream.
        prefix: First bytes of every DATAGRAM frame: the number of the WebTransport session; empty without HTTP/3.
    """

    def __init__(self, connection: Any, stream: int | None, prefix: bytes = b"") -> None:
        self.connection = connection
        self.stream = stream
        self._prefix = prefix
        self._reader = MessageReader()
        self._copies = REDUNDANT_FRAMES
        self._init_segment_digest: bytes | None = None
        self._max_unacknowledged = WINDOW_BYTES
        self._pending_messages: list[bytes] = []

    def send(self, data: bytes) -> None:
        """Queues a message of the wire protocol for sending."""
        quic = self.connection.quic
        if message_kind(data) == WELCOME and isinstance(message := decode(data), Welcome):
            # a long init segment may follow a welcome
            self._max_unacknowledged = max(self._max_unacknowledged, WINDOW_BYTES + 2 * message.init_segment_bytes)
            if self._init_segment_digest not in (None, message.digest):
                self._copies = 0  # symbols of two init segments cannot be told apart without their order
            self._init_segment_digest = message.digest
        copied = is_stream_message(data) and self._copies > 0
        if is_stream_message(data):
            self._send_on_stream(length_prefixed(data))
        if copied or not is_stream_message(data):
            self._copies -= copied
            if len(quic._datagrams_pending) < MAX_PENDING_DATAGRAMS:
                quic.send_datagram_frame(self._prefix + data)

    def _send_on_stream(self, message: bytes) -> None:
        quic = self.connection.quic
        if self.stream is not None:
            if not send_on_stream(quic, self.stream, message):
                self.connection.malformed("the stream was given up")
            elif len(quic._streams[self.stream].sender._buffer) > self._max_unacknowledged:
                self.connection.malformed("the client acknowledges nothing on the stream")
        elif len(self._pending_messages) < MAX_PENDING_MESSAGES:
            self._pending_messages.append(message)
        else:
            self.connection.malformed("no stream for the request")

    def opened(self, stream: int) -> None:
        """Stores the number of the reliable stream that the client has opened, and sends waiting messages."""
        self.stream = stream
        for message in self._pending_messages:
            self._send_on_stream(message)
        self._pending_messages.clear()

    def stream_data(self, data: bytes) -> None:
        """Processes bytes received on the reliable stream.

        Raises:
            BitstreamError: If the bytes contain an invalid message.
        """
        for message in self._reader.feed(data):
            self.connection.owner.on_message(self, message)

    def datagram(self, data: bytes) -> None:
        """Processes the content of a received QUIC DATAGRAM frame."""
        if len(data) <= MAX_DATAGRAM:
            self.connection.owner.on_message(self, data)


class NativeHandler:
    """Handler of a connection without HTTP/3: one client with one reliable stream and DATAGRAM frames.

    Args:
        connection: QUIC connection of the client.
    """

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self._client = ConnectedClient(connection, SESSION_STREAM)
        self.has_request = False

    def event(self, event: events.QuicEvent) -> None:
        """Processes an event of the QUIC connection: data on the reliable stream, or a DATAGRAM frame."""
        match event:
            case events.StreamDataReceived():
                if event.stream_id != SESSION_STREAM:
                    self._connection.malformed(f"a stream {event.stream_id}")
                    return
                self.has_request = True
                try:
                    self._client.stream_data(event.data)
                except BitstreamError as error:
                    self._connection.malformed(str(error))
            case events.DatagramFrameReceived():
                self._client.datagram(event.data)
            case events.StreamReset() | events.StopSendingReceived():
                self._connection.malformed("the stream was given up")

    def end(self) -> None:
        """Ends the transfers of the client after its connection has closed."""
        self._connection.owner.on_closed(self._client)


class WebTransportHandler:
    """Handler of an HTTP/3 connection: one client in one WebTransport session, with one reliable stream and datagrams.

    Args:
        connection: QUIC connection of the client.
    """

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self._http = H3Connection(connection.quic, enable_webtransport=True)
        self._id: int | None = None
        self._client: ConnectedClient | None = None
        self._answered_streams: set[int] = set()
        self._num_outside_bytes = 0
        self.has_request = False

    def event(self, event: events.QuicEvent) -> None:
        """Passes an event of the QUIC connection to HTTP/3, and processes the resulting events of its session."""
        if isinstance(event, (events.StreamDataReceived, events.StreamReset, events.StopSendingReceived)):
            inside = self._client is not None and event.stream_id == self._client.stream
            if isinstance(event, events.StopSendingReceived) and (inside or event.stream_id == self._id):
                self._connection.malformed("the stream was given up")
                return
            self._num_outside_bytes += 0 if inside else max(MIN_FRAGMENT_BYTES, len(getattr(event, "data", b"")))
            if self._num_outside_bytes > MAX_OUTSIDE_BYTES:
                self._connection.malformed("more than any session says outside its stream")
                return
        try:
            http_events = self._http.handle_event(event)
        except (RuntimeError, ValueError):  # aioquic replies on a stream that the client has reset
            self._connection.malformed("a stream was given up")
            return
        for reported in http_events:
            self._on_event(reported)
        if isinstance(event, (events.StreamDataReceived, events.StreamReset)) and event.stream_id == self._id:
            ended = isinstance(event, events.StreamReset) or event.end_stream
            if ended:
                self._connection.end(0, "the session was closed")

    def end(self) -> None:
        """Ends the transfers of the client after its connection has closed."""
        if self._client is not None:
            self._connection.owner.on_closed(self._client)

    def _on_event(self, event: H3Event) -> None:
        match event:
            case HeadersReceived() if event.stream_id not in self._answered_streams:  # others are trailers
                self._answer(event.stream_id, self._status(dict(event.headers)))
            case WebTransportStreamDataReceived():
                self._stream_data(event)
            case DatagramReceived() if self._client is not None and event.stream_id == self._id:
                self.has_request = True
                self._client.datagram(event.data)

    def _status(self, headers: dict[bytes, bytes]) -> int:
        """Returns the HTTP status of the response to a request for a WebTransport session."""
        wanted = headers.get(b":path", b"").split(b"?")[0]
        if wanted.decode("ascii", "replace") != WEBTRANSPORT_PATH:
            return 404
        if headers.get(b":method") != b"CONNECT" or headers.get(b":protocol") not in (
            b"webtransport",
            b"webtransport-h3",
        ):
            return 405
        if not self._connection.owner.limits.allows_origin(headers.get(b"origin")):
            return 403
        return 200 if self._id is None else 429

    def _answer(self, stream_id: int, status: int) -> None:
        headers = [(b":status", str(status).encode())]
        if status == 200:
            self._id, self._client = stream_id, ConnectedClient(self._connection, None, encode_uint_var(stream_id // 4))
            headers.append((b"sec-webtransport-http3-draft", b"draft02"))
        self._answered_streams.add(stream_id)
        try:
            self._http.send_headers(stream_id, headers, end_stream=status != 200)
        except (RuntimeError, ValueError, ProtocolError):  # the client has cancelled its request
            self._connection.malformed("a request was given up")

    def _stream_data(self, event: WebTransportStreamDataReceived) -> None:
        if self._client is None or event.session_id != self._id or event.stream_id % 4:
            self._connection.malformed(f"a stream {event.stream_id} of no session")
            return
        if self._client.stream is None:
            self.has_request = True
            self._client.opened(event.stream_id)
        if event.stream_id != self._client.stream:
            self._connection.malformed("a second stream")
            return
        try:
            self._client.stream_data(event.data)
        except BitstreamError as error:
            self._connection.malformed(str(error))
