"""A QUIC server around the core: native sessions, and WebTransport sessions that a browser opens."""

import asyncio
import os
from collections import Counter
from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from typing import Any

from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.asyncio.server import QuicServer as AioquicServer
from aioquic.quic import events
from aioquic.quic.connection import QuicConnection
from aioquic.quic.retry import QuicRetryTokenHandler

from splatwire.transport.admission import Network, makes_room, network_of
from splatwire.transport.certificate import Identity
from splatwire.transport.program import Program
from splatwire.transport.quic import (
    ALPN,
    ALPN_HTTP,
    FULL,
    INTERNAL,
    MALFORMED,
    STREAMS,
    UNREAD_BYTES,
    QuicLimits,
    configuration,
    has_token,
)
from splatwire.transport.quic_sessions import NativeSession, Session, WebTransportSessions
from splatwire.transport.sender import Server
from splatwire.transport.server_limits import ServerLimits
from splatwire.transport.udp import bound_socket

BATCH = 64
"""Datagrams that are handed to QUIC before reading gets its turn."""
SPARE = 16
"""Connections beyond twice the allowed number that may begin, so that even a server without places can say so."""
GREETINGS = 4
"""Handshakes at once from which on addresses have to show that they are theirs before one begins."""
FULL_SAID = "the server is full, or your network has its share of it"
GREETING_S = 10.0
"""A connection that has asked for nothing after this time is closed."""


class QuicServer:
    """Serves programs on one UDP socket until it is closed; use it inside a running event loop.

    While `GREETINGS` handshakes or more are going on, an address has to return a token (a QUIC Retry) before anything
    but that token is sent to it. Otherwise it gets at most three times the bytes that came from it until it has shown
    that it reads them (RFC 9000, 8.1): a Retry takes a round trip, and may be lost.

    Args:
        programs: Streams by name.
        host: Address to listen on.
        port: Port; 0 lets the system choose.
        identity: Certificate and key, or what gives those of the moment to each connection that begins.
        limits: What is spent on clients.
        quic_limits: What is spent on connections.

    Raises:
        InvalidValueError: If the address cannot be listened on.
    """

    def __init__(
        self, programs: Mapping[str, Program], host: str, port: int, *, identity: Identity | Callable[[], Identity],
        limits: ServerLimits | None = None, quic_limits: QuicLimits | None = None,
    ) -> None:  # fmt: skip
        limits = limits or ServerLimits()
        self.core = Server(
            programs, secret=os.urandom(32), random=os.urandom, limits=limits, on_failure=self._end_failed
        )
        self.limits = quic_limits or QuicLimits()
        self.num_refused = 0
        self.num_malformed = 0
        self.bytes_sent = 0
        self.connections: dict[_Connection, None] = {}  # the oldest first
        self.networks: Counter[Network] = Counter()
        self.greeting: set[_Connection] = set()
        self._socket = bound_socket(host, port)
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self._configuration = configuration(is_client=False, alpn=[ALPN, ALPN_HTTP], idle_s=limits.silence_s)
        self._identity = identity if callable(identity) else lambda: identity
        self.show_identity()
        self._endpoint: _Endpoint | None = None

    async def start(self) -> "QuicServer":
        """Begins to listen."""
        _, self._endpoint = await self._loop.create_datagram_endpoint(
            lambda: _Endpoint(self, self._configuration), sock=self._socket
        )
        return self

    def show_identity(self) -> None:
        """Has connections that begin from here on shown the certificate of the moment."""
        self._configuration.certificate, chain, self._configuration.private_key = self._identity()
        self._configuration.certificate_chain = list(chain)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._socket.getsockname()[1])

    def renew(self, name: str, program: Program) -> None:
        """See `Server.renew`."""
        self.core.renew(name, program)
        self.pump()

    def close(self) -> None:
        """Closes all connections and stops."""
        if self._timer:
            self._timer.cancel()
        (self._endpoint or self._socket).close()

    def sent(self, num_bytes: int) -> None:
        """Counts a UDP datagram."""
        self.bytes_sent += num_bytes

    def hear(self, session: Session, data: bytes) -> None:
        """Takes a frame of a session, unless its connection was ended because of what came before."""
        if session.connection not in self.connections:
            return
        network = session.connection.network
        answer = self.core.receive(session, data, self._loop.time(), reliable=True, network=network)
        if answer is not None:
            session.send(answer)
        self.pump()

    def gone(self, session: Hashable) -> None:
        """A session has ended."""
        self.core.forget(session)

    def pump(self) -> None:
        """Hands what is due to QUIC, and sets the alarm for the rest."""
        if self._timer:
            self._timer.cancel()
            self._timer = None
        now = self._loop.time()
        due = self.core.poll(now, BATCH)
        touched: set[Any] = set()
        for session, data in due:
            assert isinstance(session, Session)
            if session.connection not in self.connections:  # it failed with a datagram before this one
                continue
            try:
                session.send(data)
            except Exception as error:  # a defect of the server, which must not end other clients' transfers
                self.core.fail(session, error)
            touched.add(session.connection)
        for connection in touched:
            connection.guarded(connection.transmit)
        at = self.core.next_at()
        if at is not None:
            self._timer = self._loop.call_at(max(at, now), self.pump)
        elif self.core.num_transfers:
            self._timer = self._loop.call_at(now + 0.25, self.pump)

    def _end_failed(self, address: Hashable) -> None:
        """Closes the connection of a session after an error of the server itself."""
        connection = address.connection if isinstance(address, Session) else address
        assert isinstance(connection, _Connection)
        with suppress(Exception):  # closing sends, too; the connection is forgotten before
            connection.end(INTERNAL, "the server made an error and ended this transfer")

    def accept(self, connection: "_Connection") -> None:
        """Counts a connection that begins."""
        self.connections[connection] = None
        self.greeting.add(connection)
        self.networks[connection.network] += 1

    def leave(self, connection: "_Connection") -> None:
        """Counts a connection that has ended, once."""
        self.greeting.discard(connection)
        if connection in self.connections:
            del self.connections[connection]
            self.networks -= Counter([connection.network])

    def crowded(self, network: Network, *, begins: bool = False) -> bool:
        """Whether there are too many connections, in all or of a network: more than allowed, or no place to begin."""
        counts = ((len(self.connections), self.limits.connections), (self.networks[network], self.limits.per_network))
        return any(taken >= 2 * most + SPARE if begins else taken > most for taken, most in counts)

    def gives_way(self, network: Network, newcomer: "_Connection | None" = None) -> "_Connection | None":
        """Whose place one more of a network gets, which may begin already: the newest of who has most of them.

        Args:
            network: The network.
            newcomer: The connection that is to have it, if it has begun.
        """
        if self.networks[network] > self.limits.per_network:
            return None
        held = self.networks - Counter([] if newcomer is None else [network])
        full = makes_room(held, network)
        some = (other for other in reversed(self.connections) if other.network == full)
        return next((other for other in some if other is not newcomer), None)


class _Endpoint(AioquicServer):
    """aioquic's listening socket, whose bytes are counted."""

    def __init__(self, owner: QuicServer, settings: Any) -> None:
        super().__init__(configuration=settings, create_protocol=self._accept)
        self._owner = owner
        self._network: Network = ()
        self._retries: Any = QuicRetryTokenHandler()
        self._retry: Any = None

    def _accept(self, quic: QuicConnection, stream_handler: Any = None) -> "_Connection":
        while self._owner.crowded(self._network, begins=True):  # by now the address is known to be the client's
            other = self._owner.gives_way(self._network)
            if other is None:
                break
            other.end(FULL, FULL_SAID)
        connection = _Connection(quic, self._owner, self._network)
        for limit in (quic._local_max_streams_bidi, quic._local_max_streams_uni):  # aioquic has no option for it
            limit.value = limit.sent = STREAMS
        self._owner.accept(connection)
        return connection

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(_Watched(transport, self._owner.sent))

    def datagram_received(self, data: bytes | str, addr: Any) -> None:
        """Begins no connection while twice as many as allowed are there: until then, each is told why it has to go.

        Those of a network that has fewer than others begin in place of theirs.
        """
        assert isinstance(data, bytes)
        if len(data) > 6 and data[0] & 0x80 and data[6 : 6 + data[5]] not in self._protocols:
            self._network = network_of(addr)
            crowded, token = self._owner.crowded(self._network, begins=True), has_token(data)
            if crowded and token and self._owner.gives_way(self._network) is None:
                self._owner.num_refused += 1
                return
            self._owner.show_identity()
            retried = crowded or token or len(self._owner.greeting) >= GREETINGS
            self._retry = self._retries if retried else None
        super().datagram_received(data, addr)

    def error_received(self, exc: Exception) -> None:
        """What an earlier datagram met with, e.g. a port that nobody listens on any more."""


class _Watched:
    """A datagram transport whose bytes are counted."""

    def __init__(self, transport: Any, sent: Callable[[int], None]) -> None:
        self._transport, self._sent = transport, sent

    def sendto(self, data: bytes, addr: Any = None) -> None:
        self._sent(len(data))
        self._transport.sendto(data, addr)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)


class _Connection(QuicConnectionProtocol):
    """One QUIC connection; the application protocol that its client chose decides what runs over it."""

    def __init__(self, quic: QuicConnection, owner: QuicServer, network: Network) -> None:
        super().__init__(quic)
        self.network = network
        self.quic = quic
        self.owner = owner
        self._sessions: NativeSession | WebTransportSessions | None = None
        self._over = False
        self._read = 0
        self._patience = self._loop.call_later(GREETING_S, self._impatient)

    def datagram_received(self, data: bytes | str, addr: Any) -> None:
        """Takes a UDP datagram. aioquic widens its windows with what comes, whether or not it can be read."""
        self.guarded(super().datagram_received, data, addr)
        if not self._over and self.quic._local_max_data.used - self._read > UNREAD_BYTES:
            self.malformed("too much waits for what is missing before it")

    def quic_event_received(self, event: events.QuicEvent) -> None:
        """Takes an event of QUIC; whatever is wrong with it ends this connection and nothing else."""
        if isinstance(event, events.StreamDataReceived):
            self._read += len(event.data)
        match event:
            case events.ProtocolNegotiated():
                self._sessions = WebTransportSessions(self) if event.alpn_protocol == ALPN_HTTP else NativeSession(self)
            case events.HandshakeCompleted():
                self.owner.greeting.discard(self)
                while not self._over and self.owner.crowded(self.network):
                    # Not told before: the reason would not reach the client.
                    self.owner.num_refused += 1
                    (self.owner.gives_way(self.network, self) or self).end(FULL, FULL_SAID)
            case events.ConnectionTerminated():
                self._ended()
            case _ if self._sessions is not None and not self._over:
                self._sessions.event(event)

    def guarded(self, work: Callable[..., object], *arguments: object) -> None:
        """Does some work for this connection; an error of the server itself ends this connection and no other."""
        try:
            work(*arguments)
        except Exception as error:  # asyncio would print a traceback for each datagram
            self.owner.core.fail(self, error)

    def _handle_timer(self) -> None:
        self.guarded(super()._handle_timer)

    def end(self, code: int, reason: str) -> None:
        """Closes the connection because of what its client did."""
        if not self._over:
            self._ended()
            self.close(code, reason)

    def malformed(self, reason: str) -> None:
        """Closes the connection because something that came makes no sense."""
        self.owner.num_malformed += 1
        self.end(MALFORMED, reason[:200])

    def _ended(self) -> None:
        self._over = True
        self._patience.cancel()
        self.owner.leave(self)
        if self._sessions is not None:
            self._sessions.end()

    def _impatient(self) -> None:
        if self._sessions is None or not self._sessions.asked:
            self.end(FULL, "nothing was asked for")
