"""UDP server and client on asyncio sockets."""

import abc
import asyncio
import errno
import logging
import math
import os
import socket
from collections import deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from splatwire.errors import UnknownHostError
from splatwire.transport.address import Address
from splatwire.transport.daemon_thread import start_thread
from splatwire.transport.event_log import RepeatedEvent
from splatwire.transport.pcap import Endpoint
from splatwire.transport.protocol.events import Event, Interrupted
from splatwire.transport.protocol.receiver import Receiver
from splatwire.transport.protocol.receiver_options import ReceiverOptions
from splatwire.transport.protocol.response_budget import ResponseBudget
from splatwire.transport.protocol.sender import Server
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.protocol.server_limits import ServerLimits
from splatwire.transport.protocol.wire import HELLO, TO_SERVER, message_kind
from splatwire.transport.socket_group import SOCKET_BUFFER, UDP_CLASSES, Instruction, SocketGroup

LOG = logging.getLogger(__name__)
BATCH = 256
"""Maximum number of datagrams sent, or read by a client, in one turn of the event loop; timers run between turns."""
MAX_DATAGRAM_READ = 2048
EVENT_INTERVAL_S = 10.0
"""Minimum interval of log lines about the same event, such as dropped connection attempts, seconds."""
MIN_DROPPED = 100
"""Minimum number of dropped connection attempts for a log line."""
MAX_PENDING_RESPONSES = 1024
"""Maximum number of datagrams that wait while the socket accepts none; further responses to clients are dropped."""
FROM_KNOWN = TO_SERVER - {HELLO}
"""Kinds of messages of clients that have a token or a transfer. All others count as connection attempts."""
NO_ROUTE_ERRORS = (errno.EADDRNOTAVAIL, errno.EHOSTUNREACH, errno.ENETDOWN, errno.ENETUNREACH)
"""Error codes of connecting and sending if this machine has no route to the server, or no address.

On Windows, Python gives these names the values of its socket errors, such as WSAENETUNREACH.
"""
ADDRESS_LOST_ERROR = errno.EINVAL
"""Error code of sending if this machine no longer has the address of the socket."""

ServerAddress = tuple[socket.AddressFamily, Any]
"""One of the addresses of a server: its family and its numeric socket address."""
ADDRESS_TIMEOUT_S = 2.0
"""Time without an answer after which a client tries the next address of its server, seconds."""
Tap = Callable[[Endpoint, Endpoint, bytes], None]
"""Callback for every datagram sent or received, with its source, its destination and its payload."""


class SocketServer(abc.ABC):
    """Base class of servers on a UDP socket. Requires a running event loop.

    Args:
        core: Server without sockets, which decides what is sent and when.
        host: Address to listen on.
        port: UDP port; 0 selects a free port.
        classes: Program that classifies received datagrams, as in `SocketGroup`.

    Attributes:
        bytes_sent: Bytes of all UDP datagrams that were sent.
        num_dropped: Number of datagrams dropped without a response, because clients sent too many first datagrams.

    Raises:
        InvalidValueError: If the address cannot be bound.
    """

    def __init__(self, core: Server, host: str, port: int, classes: Sequence[Instruction]) -> None:
        self.core = core
        self._group = SocketGroup(host, port, classes)
        self._socket, self._local_addresses = self._group.sockets[0], self._group.local_addresses
        self._port = self._group.port
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self.bytes_sent = self.num_dropped = 0
        dropped = "connection attempts dropped"
        self._dropped_event = RepeatedEvent(LOG, dropped, interval_s=EVENT_INTERVAL_S, min_count=MIN_DROPPED)

    @property
    def port(self) -> int:
        """UDP port that the server listens on, or listened on before it was closed."""
        return self._port

    def set_stream(self, name: str, stream: ServedStream) -> None:
        """Adds a stream, or updates a live stream and notifies the clients that receive it.

        Args:
            name: Name of the stream.
            stream: Prepared stream, or the new state of a live stream.
        """
        self.core.set_stream(name, stream)
        self.pump()

    def drop(self, now: float) -> None:
        """Counts a dropped connection attempt. A warning is logged once many attempts were dropped.

        Args:
            now: Time, seconds.
        """
        self.num_dropped += 1
        self._dropped_event.record(now)

    @abc.abstractmethod
    def pump(self) -> None:
        """Sends datagrams that are due, at most a batch, and sets a timer for the next ones."""

    def _cancel_timer(self) -> None:
        if self._timer:
            self._timer.cancel()
            self._timer = None

    def _set_timer(self, now: float) -> None:
        """Schedules the next call of `pump` while transfers are running."""
        due_at = self.core.next_at()
        if due_at is not None:
            self._timer = self._loop.call_at(max(due_at, now), self.pump)
        elif self.core.num_transfers:
            self._timer = self._loop.call_at(now + 0.25, self.pump)


class UdpServer(SocketServer):
    """Server of streams on one UDP port; runs until `close`. Requires a running event loop.

    Args:
        streams: Prepared streams by name; a client that requests no name gets the first.
        host: Address to listen on.
        port: UDP port; 0 selects a free port.
        limits: Limits on the transfers of clients.

    Raises:
        InvalidValueError: If the address cannot be bound.
    """

    def __init__(
        self, streams: Mapping[str, ServedStream], host: str, port: int, *, limits: ServerLimits | None = None
    ) -> None:
        core = Server(streams, secret=os.urandom(32), random=os.urandom, limits=limits)
        super().__init__(core, host, port, UDP_CLASSES)
        self._backlog: deque[tuple[Hashable, bytes]] = deque()
        self._blocked = False
        self._responses = ResponseBudget()
        self._group.add_readers(self._loop, self._readable)

    def close(self) -> None:
        """Stops the server by closing its sockets, which cuts off running transfers."""
        self._group.remove_readers(self._loop)
        self._loop.remove_writer(self._socket)
        self._cancel_timer()
        self._group.close()

    def _readable(self, source: socket.socket, max_datagrams: int) -> None:
        for _ in range(max_datagrams):
            try:
                if self._local_addresses is None:
                    data, address = source.recvfrom(MAX_DATAGRAM_READ)
                else:
                    data, address = self._local_addresses.receive(source, MAX_DATAGRAM_READ)
            except BlockingIOError:
                break
            except OSError:  # ICMP error of an earlier datagram, e.g. port unreachable
                continue
            now = self._loop.time()
            if message_kind(data) not in FROM_KNOWN and not self._responses.take(address, now):
                self.drop(now)
                continue
            response = self.core.receive(address, data, now)
            if response is not None and len(self._backlog) < MAX_PENDING_RESPONSES:
                self._backlog.append((address, response))
        self.pump()

    def pump(self) -> None:
        """Sends waiting responses and up to `BATCH` datagrams that are due, and sets a timer for the next ones."""
        self._cancel_timer()
        now = self._loop.time()
        # Also with waiting responses: a flood of requests, which need responses, must not delay transfers.
        if not self._blocked and len(self._backlog) <= MAX_PENDING_RESPONSES:
            self._backlog.extend(self.core.poll(now, BATCH))
        while self._backlog:
            address, data = self._backlog[0]
            try:
                if self._local_addresses is None:
                    self._socket.sendto(data, address)  # type: ignore[call-overload]
                else:
                    self._local_addresses.send(self._socket, data, address)
            except BlockingIOError:
                self._wait_writable()
                return
            except OSError:  # the client is unreachable
                pass
            else:
                self.bytes_sent += len(data)
            self._backlog.popleft()
        self._set_timer(now)

    def _wait_writable(self) -> None:
        if not self._blocked:
            self._blocked = True
            self._loop.add_writer(self._socket, self._writable)

    def _writable(self) -> None:
        self._blocked = False
        self._loop.remove_writer(self._socket)
        self.pump()


async def resolve(address: Address) -> list[ServerAddress]:
    """Resolves the host name of a server to its addresses, the preferred one first.

    Raises:
        UnknownHostError: If the host name cannot be resolved.
        OSError: If a resource is missing, such as a file descriptor.
    """
    try:
        addresses = await start_thread(
            partial(socket.getaddrinfo, address.host, address.port, type=socket.SOCK_DGRAM), "resolver"
        )
    except (socket.gaierror, UnicodeError) as error:  # a label of more than 63 characters is a UnicodeError
        reason = getattr(error, "strerror", None) or "it is no host name"
        raise UnknownHostError(f"the host '{address.host:.80}' is not known: {reason}") from error
    return list(dict.fromkeys((family, target) for family, *_, target in addresses))


async def resolve_before(
    end: "asyncio.Future[Any] | None", address: Address, most_s: float | None = None
) -> list[ServerAddress]:
    """Like `resolve`, but gives up when the transfer ends: without an answer, resolvers take up to half a minute.

    Args:
        end: Future that ends the transfer when it is done; None for no such future.
        address: Address of the server.
        most_s: Maximum duration, seconds; None for no limit.

    Returns:
        The addresses; empty if the transfer ends first.
    """
    resolving = asyncio.ensure_future(resolve(address))
    try:
        await asyncio.wait(
            {resolving} if end is None else {resolving, end}, timeout=most_s, return_when=asyncio.FIRST_COMPLETED
        )
        return resolving.result() if resolving.done() else []
    finally:
        resolving.cancel()


def connected_socket(family: socket.AddressFamily, target: Any) -> socket.socket:
    """Returns a UDP socket that receives datagrams from one server only.

    Raises:
        OSError: If there is no route to the server, or no further file descriptor.
    """
    connection = socket.socket(family, socket.SOCK_DGRAM)
    connection.setblocking(False)
    with suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER)
    try:
        connection.connect(target)
    except OSError:
        connection.close()
        raise
    return connection


async def receive_udp(
    address: Address, options: ReceiverOptions, on_event: Callable[[Event], Any] | None = None, tap: Tap | None = None,
    stop: asyncio.Future[None] | None = None,
) -> Receiver:  # fmt: skip
    """Receives one stream over UDP.

    Args:
        address: Address of the server; the stream's name is in `options`.
        options: Options of the receiver.
        on_event: Called with every event of the receiver, such as an arrived packet.
        tap: Called with the source, destination and payload of every datagram sent or received.
        stop: Future whose completion ends the transfer; received data are kept.

    Returns:
        The finished receiver; `Receiver.finished` has the reason.

    Raises:
        UnknownHostError: If the host name cannot be resolved.
        OSError: If there is no route to the server, or no further file descriptor.
    """
    receiver = Receiver(new_nonce(), asyncio.get_running_loop().time(), options)
    if stop is not None and stop.done():
        receiver.stop()
        return receiver
    addresses = await resolve_before(stop, address, options.deadline_s)
    if not addresses:
        receiver.stop("stopped" if stop is not None and stop.done() else "deadline")
        return receiver
    client = _Client(addresses, receiver, on_event, tap)
    if stop is not None:
        stop.add_done_callback(client.stopped)
    try:
        return await client.run()
    finally:
        if stop is not None:
            stop.remove_done_callback(client.stopped)


class _Client:
    """Runs a receiver on a UDP socket: passes datagrams and the time to the receiver, and sends its datagrams.

    If the server has several addresses, such as `localhost` on many systems, they are tried in turn until one answers.
    Silent ones are tried for `ADDRESS_TIMEOUT_S` each: at most five are reached before the handshake fails.
    """

    def __init__(
        self, addresses: Sequence[ServerAddress], receiver: Receiver, on_event: Callable[[Event], Any] | None,
        tap: Tap | None,
    ) -> None:  # fmt: skip
        self._receiver, self._on_event, self._tap = receiver, on_event, tap
        self._loop = asyncio.get_running_loop()
        self._addresses = deque(addresses)  # the current one first; empty once the server has answered
        while True:
            try:
                self._use(connected_socket(*self._addresses[0]))
                break
            except OSError:  # no route to this address
                if len(self._addresses) == 1:
                    raise
                self._addresses.popleft()
        self._finished = self._loop.create_future()
        self._timer: asyncio.TimerHandle | None = None

    async def run(self) -> Receiver:
        self._loop.add_reader(self._socket, self._readable)
        try:
            self._tick()
            await self._finished
        finally:
            self._loop.remove_reader(self._socket)
            if self._timer:
                self._timer.cancel()
            try:
                self._send_and_report(*self._receiver.stop())
            finally:
                self._socket.close()
        return self._receiver

    def stopped(self, _: asyncio.Future[None]) -> None:
        """Ends the transfer because the caller's `stop` future is done."""
        if self._finished.done():
            return
        self._send_and_report(*self._receiver.stop())
        self._tick()

    def _readable(self) -> None:
        try:
            for _ in range(BATCH):
                try:
                    data = self._socket.recv(MAX_DATAGRAM_READ)
                except BlockingIOError:
                    break
                except ConnectionRefusedError:
                    is_new = self._receiver.welcome is None and not self._receiver.may_resume(self._loop.time())
                    if is_new and not self._try_next_address(is_refused=True):
                        self._send_and_report(*self._receiver.stop("nothing listens there"))
                    break
                except OSError:
                    break
                self._addresses.clear()
                if self._tap:
                    self._tap(self._server_address, self._local_address, data)
                self._send_and_report(*self._receiver.receive(data, self._loop.time()))
            self._tick()
        except Exception as error:  # raised by the caller's callback: re-raised in `receive_udp`
            self._fail(error)

    def _tick(self) -> None:
        """Polls the receiver, sends its datagrams, and sets a timer for the next poll."""
        if self._timer:
            self._timer.cancel()
            self._timer = None
        if self._loop.time() >= self._address_until:
            self._try_next_address()
        datagrams, events = self._receiver.poll(self._loop.time())
        if self._is_unusable or any(isinstance(event, Interrupted) for event in events):
            self._replace_socket()
        self._send_and_report(datagrams, events)
        due_at = self._receiver.next_at()
        if due_at is not None:
            self._timer = self._loop.call_at(due_at, self._alarm)
        elif not self._finished.done():
            self._finished.set_result(None)

    def _replace_socket(self) -> None:
        """Opens a new socket, because the local address of this machine may have changed."""
        with suppress(OSError):  # no route to the server yet
            replacement = connected_socket(self._socket.family, self._socket.getpeername())
            self._loop.remove_reader(self._socket)
            self._socket.close()
            self._use(replacement)
            self._loop.add_reader(replacement, self._readable)

    def _use(self, connection: socket.socket) -> None:
        self._socket, self._is_unusable = connection, False
        self._local_address, self._server_address = connection.getsockname()[:2], connection.getpeername()[:2]
        self._address_until = self._loop.time() + ADDRESS_TIMEOUT_S

    def _try_next_address(self, *, is_refused: bool = False) -> bool:
        """Continues with the next address of a server that has not answered yet; returns False if there is none.

        Args:
            is_refused: True if nothing listens at the current address, which is then not tried again.
        """
        while len(self._addresses) > 1 and self._receiver.finished is None:
            if is_refused:
                self._addresses.popleft()
            else:
                self._addresses.rotate(-1)
            try:
                replacement = connected_socket(*self._addresses[0])
            except OSError:  # no route to this address
                is_refused = True
                continue
            self._loop.remove_reader(self._socket)
            self._socket.close()
            self._use(replacement)
            self._loop.add_reader(replacement, self._readable)
            return True
        self._address_until = math.inf
        return False

    def _alarm(self) -> None:
        try:
            self._tick()
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        if not self._finished.done():
            self._finished.set_exception(error)

    def _send_and_report(self, datagrams: list[bytes], events: list[Event]) -> None:
        for data in datagrams:
            if self._tap:
                self._tap(self._local_address, self._server_address, data)
            try:
                self._socket.send(data)
            except OSError as error:  # a datagram that cannot be sent counts as lost
                # A router may report an unreachable host though the socket is good.
                is_lost = error.errno in (*NO_ROUTE_ERRORS, ADDRESS_LOST_ERROR) and error.errno != errno.EHOSTUNREACH
                self._is_unusable = self._is_unusable or is_lost
        if self._on_event:
            for event in events:
                self._on_event(event)


def new_nonce() -> int:
    """Returns a random 64-bit number that identifies a connection attempt."""
    return int.from_bytes(os.urandom(8), "little")
