"""QUIC server for native clients, and for browsers over WebTransport."""

import asyncio
import logging
import os
import socket
import time
from collections import Counter, deque
from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from typing import Any

from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.asyncio.server import QuicServer as AioquicServer
from aioquic.quic import events
from aioquic.quic.connection import QuicConnection

from splatwire.transport.event_log import RepeatedEvent
from splatwire.transport.protocol.admission import Network, choose_eviction, network_of
from splatwire.transport.protocol.response_budget import ResponseBudget
from splatwire.transport.protocol.sender import Server
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.protocol.server_limits import ServerLimits
from splatwire.transport.protocol.wire import MAX_DATAGRAM, message_kind, refuse_other_transport
from splatwire.transport.quic.address_validation import (
    MAX_TOKEN_OFFSET,
    RetryTokens,
    is_unknown_version,
    parse_initial,
)
from splatwire.transport.quic.certificate import FileIdentity, Identity
from splatwire.transport.quic.common import (
    ALPN,
    ALPN_HTTP,
    FULL,
    INTERNAL,
    MALFORMED,
    MAX_STREAMS,
    MAX_UNACKNOWLEDGED,
    MAX_UNREAD_BYTES,
    QuicLimits,
    configuration,
    limit_backoff,
)
from splatwire.transport.quic.handlers import ConnectedClient, NativeHandler, WebTransportHandler
from splatwire.transport.quic.input_budget import MAX_DATAGRAM_S, MAX_HANDSHAKE_S, InputBudget, NetworkBudgets
from splatwire.transport.socket_group import QUIC_CLASSES, TOKEN_PREFIX, SocketGroup
from splatwire.transport.udp import EVENT_INTERVAL_S, MAX_DATAGRAM_READ, SocketServer

LOG = logging.getLogger(__name__)
BATCH = 64
"""Maximum number of datagrams passed to QUIC before the socket is read again."""
MAX_UNSENT = 1024
"""Maximum number of datagrams that wait while the socket accepts none; further ones are lost, as on the path."""
SPARE_CONNECTIONS = 16
"""Number of connections that may start a handshake beyond twice `QuicLimits.connections`. A full server can then still
tell clients the reason of its refusal, which needs a complete handshake.
"""
RETRY_HANDSHAKES = 4
"""Number of concurrent handshakes from which on clients must first return a token (QUIC Retry)."""
MIN_EXCESS = 1000
"""Minimum number of excess datagrams of connections for a log line."""
MIN_MALFORMED = 10
"""Minimum number of malformed connections for a log line."""
FULL_REASON = "the server is full, or your network has its share of it"
REQUEST_TIMEOUT_S = 10.0
"""Time after which a connection without a request is closed, seconds."""


class QuicServer(SocketServer):
    """QUIC server of streams on one UDP port; runs until `close`. Requires a running event loop.

    Args:
        streams: Prepared streams by name; a client that requests no name gets the first.
        host: Address to listen on.
        port: UDP port; 0 selects a free port.
        identity: Certificate and key, or a function that returns the current ones.
        limits: Limits on the transfers of clients.
        quic_limits: Limits on the connections of clients.

    Raises:
        InvalidValueError: If the address cannot be bound.
    """

    def __init__(
        self, streams: Mapping[str, ServedStream], host: str, port: int, *,
        identity: Identity | Callable[[], Identity], limits: ServerLimits | None = None,
        quic_limits: QuicLimits | None = None,
    ) -> None:  # fmt: skip
        limits = limits or ServerLimits()
        core = Server(streams, secret=os.urandom(32), random=os.urandom, limits=limits, on_failure=self._end_failed)
        super().__init__(core, host, port, QUIC_CLASSES)
        self.limits = quic_limits or QuicLimits()
        self.num_refused = 0
        self.num_malformed = 0
        malformed = "malformed connections ended"
        self.malformed_event = RepeatedEvent(LOG, malformed, interval_s=EVENT_INTERVAL_S, min_count=MIN_MALFORMED)
        self.num_excess = 0
        excess = "excess datagrams dropped"
        self._excess_event = RepeatedEvent(LOG, excess, interval_s=EVENT_INTERVAL_S, min_count=MIN_EXCESS)
        self.budgets = NetworkBudgets(self.limits.per_network)
        self._pump_soon: asyncio.Handle | None = None
        self.connections: dict[_Connection, None] = {}  # the oldest first
        self.networks: Counter[Network] = Counter()
        self.handshaking: set[_Connection] = set()
        self._configuration = configuration(is_client=False, alpn=[ALPN, ALPN_HTTP], idle_s=limits.silence_s)
        self._identity = identity if callable(identity) else lambda: identity
        self.load_identity()
        self._endpoint: _LimitedEndpoint | None = None

    async def start(self) -> "QuicServer":
        """Starts to listen for connections and returns this server."""
        self._endpoint = _LimitedEndpoint(self, self._configuration)
        self._endpoint.connection_made(_SocketTransport(self._group, self._endpoint, self._on_sent, self._on_batch))
        return self

    def load_identity(self) -> None:
        """Loads the current certificate and key for new connections."""
        self._configuration.certificate, chain, self._configuration.private_key = self._identity()
        self._configuration.certificate_chain = list(chain)

    def reload_identity(self) -> None:
        """Reads the certificate files again; new connections use the new certificate.

        Raises:
            InvalidValueError: If the files are invalid.
            OSError: If a file cannot be read.
        """
        if isinstance(self._identity, FileIdentity):
            self._identity.reload()
        self.load_identity()

    @property
    def certificate_end(self) -> float:
        """End of the validity of the current certificate, seconds since 1970."""
        return float(self._identity()[0].not_valid_after_utc.timestamp())

    def close(self) -> None:
        """Closes all connections and stops the server."""
        (self._endpoint or self._group).close()
        self._cancel_timer()
        self._cancel_pump()

    def _cancel_pump(self) -> None:
        if self._pump_soon is not None:
            self._pump_soon.cancel()
            self._pump_soon = None

    def count_excess(self, now: float) -> None:
        """Counts a datagram that was dropped because its connection takes too much processor time.

        Args:
            now: Time, seconds.
        """
        self.num_excess += 1
        self._excess_event.record(now)

    def _on_sent(self, num_bytes: int) -> None:
        """Counts the bytes of a UDP datagram that was sent."""
        self.bytes_sent += num_bytes

    def on_message(self, client: ConnectedClient, data: bytes) -> None:
        """Processes a message of a client, from the reliable stream or a DATAGRAM frame.

        Args:
            client: The client.
            data: Bytes of the message.
        """
        if client.connection not in self.connections:
            return
        network = client.connection.network
        answer = self.core.receive(client, data, self._loop.time(), reliable=True, network=network)
        if answer is not None:
            client.send(answer)
        if self._pump_soon is None:  # once for all messages that arrive together
            self._pump_soon = self._loop.call_soon(self.pump)

    def _on_batch(self) -> None:
        """Sends due datagrams (`pump`) after one socket was read, so that a flood does not delay them."""
        due_at = self.core.next_at()
        if self._pump_soon is not None or (due_at is not None and due_at <= self._loop.time()):
            self.pump()

    def on_closed(self, client: Hashable) -> None:
        """Ends the transfers of a client after its connection was closed."""
        self.core.forget(client)

    def pump(self) -> None:
        """Sends up to `BATCH` datagrams that are due, over QUIC, and sets a timer for the others and for later ones."""
        self._cancel_timer()
        self._cancel_pump()
        now = self._loop.time()
        due = self.core.poll(now, BATCH)
        touched: set[Any] = set()
        for client, data in due:
            assert isinstance(client, ConnectedClient)
            if client.connection not in self.connections:  # an earlier datagram of this batch closed it
                continue
            try:
                client.send(data)
            except Exception as error:  # a defect of the server must not end other clients' transfers
                self.core.fail(client, error)
            touched.add(client.connection)
        for connection in touched:
            connection.guarded(connection.transmit)
        self._set_timer(now)

    def _end_failed(self, client: Hashable) -> None:
        """Closes the connection of a client after an internal error of the server.

        Args:
            client: The client; or a connection, if the error occurred while it was handled.
        """
        connection = client.connection if isinstance(client, ConnectedClient) else client
        assert isinstance(connection, _Connection)
        with suppress(Exception):  # closing sends too and may fail; the connection is already forgotten
            connection.end(INTERNAL, "the server made an error and ended this transfer")

    def accept(self, connection: "_Connection") -> None:
        """Registers a new connection, and adds 1 to the number of connections from the client's network."""
        self.connections[connection] = None
        self.handshaking.add(connection)
        self.networks[connection.network] += 1

    def leave(self, connection: "_Connection") -> None:
        """Removes a closed connection from the counts of connections."""
        self.handshaking.discard(connection)
        if connection in self.connections:
            del self.connections[connection]
            self.networks -= Counter([connection.network])

    def is_full(self, network: Network, *, is_new: bool = False) -> bool:
        """True if the maximum number of connections is exceeded, in total or for one network.

        Args:
            network: Network of the client.
            is_new: True to test the higher limits, which apply before the handshake of a new connection is finished.
        """
        counts = ((len(self.connections), self.limits.connections), (self.networks[network], self.limits.per_network))
        return any(taken >= 2 * most + SPARE_CONNECTIONS if is_new else taken > most for taken, most in counts)

    def connection_to_evict(self, network: Network, newcomer: "_Connection | None" = None) -> "_Connection | None":
        """Chooses the connection that is closed in favour of a new one when the server is full.

        `choose_eviction` selects a network that has many connections. The newest connection of this network is chosen.

        Args:
            network: Network of the new connection.
            newcomer: The new connection if it is already among the counted connections. It is then never chosen itself.
                None if the new connection is not counted yet.

        Returns:
            Connection to close, or None to refuse the new one.
        """
        if self.networks[network] > self.limits.per_network:
            return None
        held = self.networks - Counter([] if newcomer is None else [network])
        full = choose_eviction(held, network)
        # The newest connection of the network that has the most.
        candidates = (other for other in reversed(self.connections) if other.network == full)
        return next((other for other in candidates if other is not newcomer), None)


class _LimitedEndpoint(AioquicServer):
    """Listening socket of aioquic that validates addresses and limits new connections."""

    def __init__(self, owner: QuicServer, settings: Any) -> None:
        super().__init__(configuration=settings, create_protocol=self._accept)
        self._owner = owner
        self._network: Network = ()
        self._tokens = RetryTokens()
        self._responses = ResponseBudget()
        self._retry: Any = None

    def _accept(self, quic: QuicConnection, stream_handler: Any = None) -> "_Connection":
        while self._owner.is_full(self._network, is_new=True):  # the address has been validated by now
            other = self._owner.connection_to_evict(self._network)
            if other is None:
                break
            other.end(FULL, FULL_REASON)
        connection = _Connection(quic, self._owner, self._network)
        for limit in (quic._local_max_streams_bidi, quic._local_max_streams_uni):  # aioquic has no option for it
            limit.value = limit.sent = MAX_STREAMS
        self._owner.accept(connection)
        return connection

    def datagram_received(self, data: bytes | str, addr: Any) -> None:
        """Passes a UDP datagram to aioquic, or drops a datagram that would start an excess connection.

        Args:
            data: Payload of the datagram.
            addr: Socket address of the client.
        """
        assert isinstance(data, bytes)
        if len(data) < 9 or not data[0] & 0x80:  # aioquic gives all its connections ids of 8 bytes
            known = self._protocols.get(data[1:9])
            if known is not None:
                known.datagram_received(data, addr)
            elif message_kind(data):
                self._refuse_udp(data, addr)
        elif data[6 : 6 + data[5]] in self._protocols or self._may_begin(data, addr):
            super().datagram_received(data, addr)

    def _may_begin(self, data: bytes, addr: Any) -> bool:
        """True if aioquic may start a connection because of a datagram that belongs to no known connection.

        Clients must first return a token (QUIC Retry) while the server has many handshakes or connections. Cheap checks
        come first, because these datagrams may be a flood with forged addresses.
        """
        owner, now = self._owner, self._loop.time()
        is_busy = len(owner.handshaking) >= RETRY_HANDSHAKES
        if is_busy and TOKEN_PREFIX not in data[:MAX_TOKEN_OFFSET] and not self._responses.may_respond(addr, now):
            owner.drop(now)
            return False
        initial = parse_initial(data)
        if initial is None:  # aioquic answers unknown versions with a list of its versions
            return is_unknown_version(data) and self._responses.take(addr, now)
        has_token = initial.has_retry_token
        if has_token and not self._tokens.is_valid(initial, addr, now):
            owner.drop(now)
            return False
        if not has_token and is_busy:
            self._send_retry(initial, addr, now)
            return False
        self._network = network_of(addr)
        # Beyond the limit, some more connections are accepted, so that their clients can be refused with a reason.
        # After that, a client must return a token, and replaces a connection of another network.
        if owner.is_full(self._network, is_new=True):
            if not has_token:
                self._send_retry(initial, addr, now)
                return False
            if owner.connection_to_evict(self._network) is None:
                owner.num_refused += 1
                return False
        if not owner.budgets.may_begin(self._network, now):
            owner.drop(now)
            return False
        owner.load_identity()
        # aioquic's attribute: with a handler it verifies the token of this datagram, with None it sends no Retry
        self._retry = self._tokens if has_token else None
        return True

    def _refuse_udp(self, data: bytes, addr: Any) -> None:
        """Sends a refusal to a client that uses plain UDP, because this port serves QUIC."""
        refusal = refuse_other_transport(data) if len(data) == MAX_DATAGRAM else None
        if refusal is not None and self._responses.take(addr, self._loop.time()):
            assert self._transport is not None
            self._transport.sendto(refusal, addr)

    def _send_retry(self, initial: Any, addr: Any, now: float) -> None:
        assert self._transport is not None
        if self._responses.take(addr, now):
            self._transport.sendto(self._tokens.retry_packet(initial, addr, now), addr)
        else:
            self._owner.drop(now)

    def error_received(self, exc: Exception) -> None:
        """Ignores an ICMP error, such as "port unreachable"."""


class _SocketTransport:
    """Datagram transport on a UDP socket that reads many datagrams at once.

    asyncio's own transport reads one datagram in each turn of the event loop, which is too slow for a flood.

    Args:
        group: Bound sockets of the port.
        protocol: Object that gets the received datagrams.
        on_sent: Called with the size of each sent datagram, bytes.
        on_batch: Called after the datagrams that could be read from a socket in one turn of the event loop.
    """

    def __init__(
        self, group: SocketGroup, protocol: asyncio.DatagramProtocol, on_sent: Callable[[int], None],
        on_batch: Callable[[], None],
    ) -> None:  # fmt: skip
        self._group, self._socket, self._protocol = group, group.sockets[0], protocol
        self._local_addresses = group.local_addresses
        self._on_sent, self._on_batch = on_sent, on_batch
        self._loop = asyncio.get_running_loop()
        self._unsent: deque[tuple[bytes, Any]] = deque()
        group.add_readers(self._loop, self._readable)

    def _readable(self, source: socket.socket, max_datagrams: int) -> None:
        for _ in range(max_datagrams):
            try:
                if self._local_addresses is None:
                    data, address = source.recvfrom(MAX_DATAGRAM_READ)
                else:
                    data, address = self._local_addresses.receive(source, MAX_DATAGRAM_READ)
            except OSError:  # nothing is left, an ICMP error of an earlier datagram, or closed meanwhile
                break
            self._protocol.datagram_received(data, address)
        self._on_batch()

    def sendto(self, data: bytes, addr: Any = None) -> None:
        """Sends a datagram now, or as soon as the socket accepts it.

        Args:
            data: Payload of the datagram.
            addr: Socket address of the client.
        """
        if self._unsent:
            if len(self._unsent) < MAX_UNSENT:
                self._unsent.append((data, addr))
            return
        try:
            if self._local_addresses is None:
                self._socket.sendto(data, addr)
            else:
                self._local_addresses.send(self._socket, data, addr)
        except BlockingIOError:
            self._unsent.append((data, addr))
            self._loop.add_writer(self._socket, self._writable)
        except OSError:  # the client is unreachable, or the socket closed
            pass
        else:
            self._on_sent(len(data))

    def _writable(self) -> None:
        self._loop.remove_writer(self._socket)
        waiting, self._unsent = self._unsent, deque()
        for data, address in waiting:
            self.sendto(data, address)

    def close(self) -> None:
        """Closes the socket; waiting datagrams are lost."""
        if self._socket.fileno() >= 0:
            self._group.remove_readers(self._loop)
            self._loop.remove_writer(self._socket)
            self._group.close()


class _Connection(QuicConnectionProtocol):
    """QUIC connection of one client, with splatwire's own application protocol or WebTransport."""

    def __init__(self, quic: QuicConnection, owner: QuicServer, network: Network) -> None:
        super().__init__(quic)
        self.network = network
        self.quic = quic
        self.owner = owner
        self._handler: NativeHandler | WebTransportHandler | None = None
        self._has_ended = False
        self._num_bytes_read = 0
        self._budget: InputBudget | None = None
        self._handshake_s = self._sending_s = 0.0
        self._request_timer = self._loop.call_later(REQUEST_TIMEOUT_S, self._on_request_timeout)

    def datagram_received(self, data: bytes | str, addr: Any) -> None:
        """Processes a UDP datagram of this connection.

        Args:
            data: Payload of the datagram.
            addr: Socket address of the client.
        """
        if self._has_ended:  # aioquic ignores further datagrams
            return
        now = self._loop.time()
        if self._has_spent(now):
            self.owner.count_excess(now)
            return
        budget, began, self._sending_s = self._budget, time.thread_time(), 0.0
        self.guarded(super().datagram_received, data, addr)
        self._spend(budget, time.thread_time() - began - self._sending_s, now)
        if not self._has_ended:
            self._limit_memory()

    def _limit_memory(self) -> None:
        """Ends the connection if aioquic keeps too much for this client.

        The limits of aioquic are higher: it extends flow-control windows even for data that have not been read, and
        keeps every packet of acknowledgements until the client acknowledges it.
        """
        handshake_bytes = (len(stream.receiver._buffer) for stream in self.quic._crypto_streams.values())
        if self.quic._local_max_data.used - self._num_bytes_read + sum(handshake_bytes) > MAX_UNREAD_BYTES:
            self.malformed("too much waits for what is missing before it")
        elif any(len(space.sent_packets) > MAX_UNACKNOWLEDGED for space in self.quic._spaces.values()):
            self.malformed("the client acknowledges nothing")

    def quic_event_received(self, event: events.QuicEvent) -> None:
        """Processes an event of aioquic, such as the end of the handshake or received data."""
        if isinstance(event, events.StreamDataReceived):
            self._num_bytes_read += len(event.data)
        match event:
            case events.ProtocolNegotiated():
                self._handler = WebTransportHandler(self) if event.alpn_protocol == ALPN_HTTP else NativeHandler(self)
            case events.HandshakeCompleted():
                self.owner.handshaking.discard(self)
                self._budget = self.owner.budgets.open(self.network, self._loop.time())
                while not self._has_ended and self.owner.is_full(self.network):
                    # Not refused earlier: the reason would not reach the client before the handshake.
                    self.owner.num_refused += 1
                    (self.owner.connection_to_evict(self.network, self) or self).end(FULL, FULL_REASON)
            case events.ConnectionTerminated():
                self._ended()
                self._loop.call_soon(self._release)  # aioquic still uses its objects in this turn
            case _ if self._handler is not None and not self._has_ended:
                self._handler.event(event)

    def transmit(self) -> None:
        """Sends the datagrams that are due, and sets the timer of QUIC."""
        limit_backoff(self.quic)
        quic, began = self.quic, time.thread_time()
        num_pending, num_stream_bytes = len(quic._datagrams_pending), quic._remote_max_data_used
        super().transmit()
        # A client may provoke any number of acknowledgements and other replies of QUIC.
        if len(quic._datagrams_pending) < num_pending or quic._remote_max_data_used > num_stream_bytes:
            seconds = time.thread_time() - began
            self._sending_s += seconds
            if self._budget is not None:
                self._budget.earn(seconds)

    def _has_spent(self, now: float) -> bool:
        """Returns True if the datagrams of this client have taken too much processor time."""
        if self._budget is not None:
            return self._budget.is_spent(self.owner.networks[self.network], now)
        return self._handshake_s >= MAX_HANDSHAKE_S or not self.owner.budgets.may_continue(self.network, now)

    def _spend(self, budget: InputBudget | None, seconds: float, now: float) -> None:
        """Counts the processor time for a datagram of this client.

        Args:
            budget: Budget of the connection; None for a datagram of the handshake.
            seconds: Processor time, seconds.
            now: Time, seconds.
        """
        if budget is None:
            self._handshake_s += min(seconds, MAX_DATAGRAM_S)
            self.owner.budgets.spend(self.network, seconds, now)
            return
        budget.spend(seconds)
        if self._has_ended:
            self.owner.budgets.close(self.network, budget, now)

    def guarded(self, work: Callable[..., object], *arguments: object) -> None:
        """Calls a function for this connection.

        An exception of the function closes this connection only.

        Args:
            work: Function to call.
            *arguments: Arguments of the function.
        """
        try:
            work(*arguments)
        except Exception as error:  # asyncio would print a traceback for each datagram
            # No transfer is registered under the connection: closing it (`_end_failed`) ends those of its client.
            self.owner.core.fail(self, error)

    def _handle_timer(self) -> None:
        self.guarded(super()._handle_timer)

    def end(self, code: int, reason: str) -> None:
        """Closes the connection with an application error code and a reason for the client."""
        if not self._has_ended:
            self._ended()
            self.close(code, reason)

    def malformed(self, reason: str) -> None:
        """Closes the connection after invalid input of the client, and counts the event."""
        self.owner.num_malformed += 1
        self.owner.malformed_event.record(self._loop.time())
        self.end(MALFORMED, reason[:200])

    def _ended(self) -> None:
        self._has_ended = True
        self._request_timer.cancel()
        self.owner.leave(self)
        if self._budget is not None:
            self.owner.budgets.close(self.network, self._budget, self._loop.time())
        if self._handler is not None:
            self._handler.end()

    def _release(self) -> None:
        """Frees the memory of a connection that is over.

        Objects of aioquic refer to each other. Without this method, only the garbage collector would free their memory.
        It runs rarely in a process with many objects, so that a flood of handshakes would take tens of megabytes.
        """
        if self._timer is not None:
            self._timer.cancel()
        vars(self.quic).clear()
        self._handler = None
        # Handlers of aioquic's server, bound to this object.
        self._connection_id_issued_handler = self._connection_id_retired_handler = lambda _: None
        self._connection_terminated_handler = lambda: None

    def _on_request_timeout(self) -> None:
        if self._handler is None or not self._handler.has_request:
            self.end(FULL, "no request was received")
