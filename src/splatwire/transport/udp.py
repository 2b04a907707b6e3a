"""UDP sockets around the core: the only place of this room that waits."""

import asyncio
import os
import socket
from collections import deque
from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from typing import Any

from splatwire.errors import InvalidValueError
from splatwire.transport.address import Address, cannot_listen
from splatwire.transport.events import Event
from splatwire.transport.pcap import Endpoint
from splatwire.transport.program import Program
from splatwire.transport.receiver import Receiver
from splatwire.transport.receiver_options import ReceiverOptions
from splatwire.transport.sender import Server
from splatwire.transport.server_limits import ServerLimits

SOCKET_BUFFER = 4 << 20
BATCH = 256
"""Datagrams that are read or written before timers get their turn."""
LARGEST_READ = 2048

Tap = Callable[[Endpoint, Endpoint, bytes], None]
"""Told every datagram: where it is from, where it goes, its content."""


class UdpServer:
    """Serves programs on one UDP socket until it is closed; use it inside a running event loop.

    Args:
        programs: Streams by name.
        host: Address to listen on.
        port: Port; 0 lets the system choose.
        limits: What is spent on clients.

    Raises:
        InvalidValueError: If the address cannot be listened on.
    """

    def __init__(
        self, programs: Mapping[str, Program], host: str, port: int, *, limits: ServerLimits | None = None
    ) -> None:
        self.core = Server(programs, secret=os.urandom(32), random=os.urandom, limits=limits)
        self._socket = bound_socket(host, port)
        self._loop = asyncio.get_running_loop()
        self._backlog: deque[tuple[Hashable, bytes]] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._blocked = False
        self.bytes_sent = 0
        self._loop.add_reader(self._socket, self._readable)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._socket.getsockname()[1])

    def renew(self, name: str, program: Program) -> None:
        """See `Server.renew`."""
        self.core.renew(name, program)
        self._pump()

    def close(self) -> None:
        """Stops at once."""
        self._loop.remove_reader(self._socket)
        self._loop.remove_writer(self._socket)
        if self._timer:
            self._timer.cancel()
        self._socket.close()

    def _readable(self) -> None:
        for _ in range(BATCH):
            try:
                data, address = self._socket.recvfrom(LARGEST_READ)
            except BlockingIOError:
                break
            except OSError:  # what an earlier datagram met with, e.g. a port that nobody listens on any more
                continue
            answer = self.core.receive(address, data, self._loop.time())
            if answer is not None:
                self._backlog.append((address, answer))
        self._pump()

    def _pump(self) -> None:
        """Sends what is due, as far as the system takes it, and sets the alarm for the rest."""
        if self._timer:
            self._timer.cancel()
            self._timer = None
        now = self._loop.time()
        if not self._backlog:
            self._backlog.extend(self.core.poll(now, BATCH))
        while self._backlog:
            address, data = self._backlog[0]
            try:
                self._socket.sendto(data, address)  # type: ignore[call-overload]
            except BlockingIOError:
                self._wait_writable()
                return
            except OSError:  # this one client cannot be reached
                pass
            else:
                self.bytes_sent += len(data)
            self._backlog.popleft()
        at = self.core.next_at()
        if at is not None:
            self._timer = self._loop.call_at(max(at, now), self._pump)
        elif self.core.num_transfers:
            self._timer = self._loop.call_at(now + 0.25, self._pump)

    def _wait_writable(self) -> None:
        if not self._blocked:
            self._blocked = True
            self._loop.add_writer(self._socket, self._writable)

    def _writable(self) -> None:
        self._blocked = False
        self._loop.remove_writer(self._socket)
        self._pump()


async def resolve(address: Address) -> tuple[socket.AddressFamily, Any]:
    """Family and numeric address of a server.

    Raises:
        InvalidValueError: If the host has none.
    """
    try:
        found = await asyncio.get_running_loop().getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    except OSError as error:
        raise InvalidValueError(f"the host '{address.host}' is not known: {error.strerror}") from error
    return found[0][0], found[0][4]


def connected_socket(family: socket.AddressFamily, target: Any) -> socket.socket:
    """A UDP socket that hears one server only: the system drops what is from anywhere else."""
    connection = socket.socket(family, socket.SOCK_DGRAM)
    connection.setblocking(False)
    with suppress(OSError):
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER)
    connection.connect(target)
    return connection


async def receive_udp(
    address: Address, options: ReceiverOptions, on_event: Callable[[Event], Any] | None = None, tap: Tap | None = None,
    stop: asyncio.Future[None] | None = None,
) -> Receiver:  # fmt: skip
    """Receives one stream.

    Args:
        address: Where from; which stream, the options say.
        options: What is wanted.
        on_event: Called with everything that happens, in the event loop.
        tap: Is told every datagram.
        stop: Ends the transfer when it is done; what arrived by then stays.

    Returns:
        The receiver, finished; what it has is up to `Receiver.finished`.

    Raises:
        InvalidValueError: If the host has no address.
    """
    family, target = await resolve(address)
    with connected_socket(family, target) as connection:
        receiver = Receiver(new_nonce(), asyncio.get_running_loop().time(), options)
        client = _Client(connection, receiver, on_event, tap)
        if stop is not None:
            stop.add_done_callback(lambda _: client.stop())
        return await client.run()


class _Client:
    """Drives a receiver with a connected socket."""

    def __init__(
        self, connection: socket.socket, receiver: Receiver, on_event: Callable[[Event], Any] | None, tap: Tap | None
    ) -> None:
        self._socket, self._receiver, self._on_event, self._tap = connection, receiver, on_event, tap
        self._here, self._there = connection.getsockname()[:2], connection.getpeername()[:2]
        self._loop = asyncio.get_running_loop()
        self._over = self._loop.create_future()
        self._timer: asyncio.TimerHandle | None = None

    async def run(self) -> Receiver:
        self._loop.add_reader(self._socket, self._readable)
        try:
            self._tick()
            await self._over
        finally:
            self._loop.remove_reader(self._socket)
            if self._timer:
                self._timer.cancel()
            self._act(*self._receiver.stop())
        return self._receiver

    def stop(self) -> None:
        """Ends the transfer here."""
        self._act(*self._receiver.stop())
        self._tick()

    def _readable(self) -> None:
        try:
            for _ in range(BATCH):
                try:
                    data = self._socket.recv(LARGEST_READ)
                except BlockingIOError:
                    break
                except ConnectionRefusedError:
                    if self._receiver.welcome is None:
                        self._act(*self._receiver.stop("nothing listens there"))
                    break
                except OSError:
                    break
                if self._tap:
                    self._tap(self._there, self._here, data)
                self._act(*self._receiver.receive(data, self._loop.time()))
            self._tick()
        except Exception as error:  # raised by the owner's callback: it belongs to whoever waits
            self._fail(error)

    def _tick(self) -> None:
        """Polls, and sets the alarm for the next time."""
        if self._timer:
            self._timer.cancel()
            self._timer = None
        self._act(*self._receiver.poll(self._loop.time()))
        at = self._receiver.next_at()
        if at is not None:
            self._timer = self._loop.call_at(at, self._alarm)
        elif not self._over.done():
            self._over.set_result(None)

    def _alarm(self) -> None:
        try:
            self._tick()
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        if not self._over.done():
            self._over.set_exception(error)

    def _act(self, datagrams: list[bytes], events: list[Event]) -> None:
        for data in datagrams:
            if self._tap:
                self._tap(self._here, self._there, data)
            with suppress(OSError):  # lost, as any datagram may be
                self._socket.send(data)
        if self._on_event:
            for event in events:
                self._on_event(event)


def new_nonce() -> int:
    """A random name of an attempt."""
    return int.from_bytes(os.urandom(8), "little")


def bound_socket(host: str, port: int) -> socket.socket:
    """A UDP socket that listens, with large buffers.

    Raises:
        InvalidValueError: If the address cannot be listened on.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE)
        family, kind, protocol, _, target = found[0]
        server = socket.socket(family, kind, protocol)
    except OSError as error:
        raise cannot_listen("UDP", host, port, error) from error
    try:
        server.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            with suppress(OSError):
                server.setsockopt(socket.SOL_SOCKET, option, SOCKET_BUFFER)
        server.bind(target)
    except OSError as error:
        server.close()
        raise cannot_listen("UDP", host, port, error) from error
    return server
