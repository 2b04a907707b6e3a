"""Receiver of a stream over QUIC."""

import asyncio
import socket
import ssl
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.quic import events
from aioquic.quic.connection import QuicConnection
from aioquic.quic.packet import QuicErrorCode

from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.transport.address import Address
from splatwire.transport.protocol.events import Event
from splatwire.transport.protocol.messages import OTHER_TRANSPORT, Refuse
from splatwire.transport.protocol.receiver import NO_QUIC, Receiver
from splatwire.transport.protocol.receiver_options import ReceiverOptions
from splatwire.transport.protocol.wire import SMALL_MTU, decode
from splatwire.transport.quic.certificate import check_authority, check_fingerprint, fingerprint
from splatwire.transport.quic.common import (
    ALPN,
    INTERNAL,
    MALFORMED,
    REFUSED,
    SESSION_STREAM,
    MessageReader,
    configuration,
    is_stream_message,
    length_prefixed,
    limit_backoff,
    send_on_stream,
)
from splatwire.transport.udp import ADDRESS_TIMEOUT_S, Tap, connected_socket, new_nonce, resolve_before

MIN_PAUSE_S, MAX_PAUSE_S = 0.25, 2.0
"""Pauses before a new connection is tried, seconds: the first pause, and the maximum after repeated doubling."""
STABLE_S = 5.0
"""Lifetime of a connection, seconds, from which on the pause before the next connection is the shortest one again."""
CERTIFICATE_ALERTS = range(0x100 + 42, 0x100 + 49)
"""QUIC error codes of TLS alerts about certificates, bad_certificate to unknown_ca (RFC 9001, 4.8; RFC 8446, 6)."""


@dataclass(frozen=True)
class Trust:
    """Rules for accepting the TLS certificate of a server.

    Attributes:
        authority: PEM certificates of the accepted CAs, or the server's self-signed certificate; None for the CAs that
            the operating system trusts.
        fingerprint: SHA-256 of the only accepted certificate, hexadecimal; None for no such restriction.
        insecure: True to accept any certificate, with no protection against an attacker on the path.

    Raises:
        InvalidValueError: If a fingerprint or certificate is malformed, or more than one option is given.
    """

    authority: bytes | None = None
    fingerprint: str | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        if sum((self.authority is not None, self.fingerprint is not None, self.insecure)) > 1:
            raise InvalidValueError("trust an authority, a fingerprint, or everybody: more than one was given")
        if self.authority is not None:
            check_authority(self.authority)
        if self.fingerprint is not None:
            object.__setattr__(self, "fingerprint", check_fingerprint(self.fingerprint))


async def receive_quic(
    address: Address, options: ReceiverOptions, trust: Trust | None = None,
    on_event: Callable[[Event], Any] | None = None, tap: Tap | None = None, stop: asyncio.Future[None] | None = None,
) -> Receiver:  # fmt: skip
    """Receives a stream over QUIC.

    Args:
        address: Address of the server.
        options: Options of the receiver.
        trust: Accepted certificates of the server.
        on_event: Called with every event of the receiver, such as an arrived packet.
        tap: Called with the source, destination and payload of every UDP datagram sent or received.
        stop: Future whose completion ends the transfer; received data are kept.

    Returns:
        The finished receiver; `Receiver.finished` has the reason.

    Raises:
        UnknownHostError: If the host name cannot be resolved.
        OSError: If the first socket cannot be opened or connected, such as without a route to the server.
    """
    loop, trust = asyncio.get_running_loop(), trust or Trust()
    receiver = Receiver(new_nonce(), loop.time(), options, reliable=True)
    if stop is not None and stop.done():
        receiver.stop()
        return receiver
    with _ending(options.deadline_s, stop) as end:
        addresses = deque(await resolve_before(end, address))
        if not addresses:
            receiver.stop(end.result())
            return receiver
        num_untried = len(addresses)
        settings = configuration(is_client=True, alpn=[ALPN], idle_s=options.silence_s)
        settings.server_name = address.host
        settings.cadata = trust.authority
        settings.verify_mode = ssl.CERT_NONE if trust.insecure or trust.fingerprint else ssl.CERT_REQUIRED
        pause = MIN_PAUSE_S
        while receiver.finished is None:
            began, transfer_events = loop.time(), list[Event]()
            num_untried -= 1
            is_last = len(addresses) == 1
            try:
                connection = connected_socket(*addresses[0])
            except OSError as error:  # no route to the server, as during an outage
                if is_last and receiver.welcome is None and not receiver.may_resume(began):
                    raise
                if is_last and not receiver.may_resume(began) and not end.done():
                    transfer_events = receiver.stop(f"the server fell silent; {error.strerror or error}")[1]
                is_refused, is_reached = True, False
            else:
                quic = QuicConnection(configuration=settings)
                client = _Client(quic, receiver, trust, on_event, tap, addresses[0][1], is_last=is_last)
                end.add_done_callback(client.stopped)
                await client.run(connection)
                end.remove_done_callback(client.stopped)
                is_refused, is_reached = client.is_refused, client.is_reached
            if receiver.finished is None:
                num_untried = 0 if is_reached else num_untried
                if not is_last and is_refused and not receiver.may_resume(loop.time()):
                    addresses.popleft()
                else:
                    if not is_reached:
                        addresses.rotate(-1)
                    if num_untried <= 0:
                        pause = MIN_PAUSE_S if loop.time() - began > STABLE_S else min(2 * pause, MAX_PAUSE_S)
                        await asyncio.wait([end], timeout=pause)
                transfer_events = receiver.stop(end.result())[1] if end.done() else receiver.reconnect(loop.time())
            for event in transfer_events:
                if on_event:
                    on_event(event)
    return receiver


@contextmanager
def _ending(deadline_s: float | None, stop: asyncio.Future[None] | None) -> Iterator[asyncio.Future[str]]:
    """Context with a future for the end of a transfer, in connections and in the pauses between them.

    Args:
        deadline_s: Time after which the transfer ends, seconds; None for no limit.
        stop: Future of the caller that ends the transfer when it is done; None for no such future.

    Yields:
        Future whose result is the reason of the end.
    """
    loop = asyncio.get_running_loop()
    end: asyncio.Future[str] = loop.create_future()

    def finish(reason: str) -> None:
        if not end.done():
            end.set_result(reason)

    def on_stop(_: asyncio.Future[None]) -> None:
        finish("stopped")

    timer = None if deadline_s is None else loop.call_later(deadline_s, finish, "deadline")
    if stop is not None:
        stop.add_done_callback(on_stop)
    try:
        yield end
    finally:
        if timer is not None:
            timer.cancel()
        if stop is not None:
            stop.remove_done_callback(on_stop)


class _Client(QuicConnectionProtocol):
    """QUIC connection of a client (aioquic), which drives a `Receiver` of the transport protocol.

    Messages from the server and the current time are passed to the receiver. Messages that the receiver returns are
    sent to the server, in QUIC datagrams or on the stream of the session.

    Attributes:
        is_refused: True if nothing listens at the address of the server.
    """

    def __init__(
        self, quic: QuicConnection, receiver: Receiver, trust: Trust, on_event: Callable[[Event], Any] | None,
        tap: Tap | None, target: Any, *,
        is_last: bool = True,
    ) -> None:  # fmt: skip
        super().__init__(quic)
        self._receiver, self._trust, self._on_event, self._tap = receiver, trust, on_event, tap
        self._target, self._is_last = target, is_last
        self.is_refused = False
        self._reader = MessageReader()
        self._alarm: asyncio.TimerHandle | None = None
        self._finished = self._loop.create_future()
        self._established = self._is_interrupted = self._is_answered = False
        self._socket_closed = asyncio.Event()

    @property
    def is_reached(self) -> bool:
        """True if the handshake with a server has been completed."""
        return self._established

    async def run(self, connection: socket.socket) -> Receiver:
        await self._loop.create_datagram_endpoint(lambda: self, sock=connection)
        self.connect(self._target)
        address_timer = None if self._is_last else self._loop.call_later(ADDRESS_TIMEOUT_S, self._leave_silent_address)
        try:
            self._tick()
            await self._finished
        finally:
            if self._alarm:
                self._alarm.cancel()
            if address_timer:
                address_timer.cancel()
            try:
                self._send_and_report(*(([], []) if self._is_interrupted else self._receiver.stop()))
            finally:
                self.transmit()  # sends pending goodbyes, which closing would drop
                self.close(0, "")
                self._socket_transport.close()
                await self._socket_closed.wait()
        return self._receiver

    def _leave_silent_address(self) -> None:
        """Ends a connection to which nothing has answered, so that the next address of the server is tried."""
        if not self._is_answered:
            self._is_interrupted = True
            self._finish()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._socket_transport = transport
        self._local_address = transport.get_extra_info("sockname")[:2]
        super().connection_made(_ConnectedTransport(transport, self._tap_datagram))

    def connection_lost(self, exc: Exception | None) -> None:
        self._socket_closed.set()

    def datagram_received(self, data: bytes | str, addr: Any) -> None:
        assert isinstance(data, bytes)
        self._tap_datagram(False, data)
        self._is_answered = True
        try:
            if not self._established and self._is_refusal(data):
                self._send_and_report(*self._receiver.on_wrong_transport())
                self._finish()
                return
            if self._established:
                self._receiver.on_quic_packet(len(data))
            super().datagram_received(data, self._target)
        except Exception as error:  # raised by the caller's callback: re-raised in `receive_quic`
            self._fail(error)

    def transmit(self) -> None:
        """Sends the datagrams that are due, and sets the timer of QUIC."""
        limit_backoff(self._quic)
        super().transmit()

    def _is_refusal(self, data: bytes) -> bool:
        """True if a datagram is the refusal of a server that serves plain UDP at this port."""
        try:
            message = decode(data)
        except BitstreamError:
            return False
        own = int.from_bytes(self._quic.host_cid, "little")
        return isinstance(message, Refuse) and message == Refuse(own, OTHER_TRANSPORT)

    def error_received(self, exc: Exception) -> None:
        if not isinstance(exc, ConnectionRefusedError) or self._established or self._finished.done():
            return
        self.is_refused = True
        # The server may be restarting, or listen at another of its addresses.
        if not self._is_last or self._receiver.may_resume(self._loop.time()):
            self._is_interrupted = True
            self._finish()
        else:
            self.stop("nothing listens there")

    def quic_event_received(self, event: events.QuicEvent) -> None:
        if self._finished.done():  # the receiver may have a new connection
            return
        now = self._loop.time()
        match event:
            case events.HandshakeCompleted():
                self._check_certificate()
            case events.StreamDataReceived() if self._established:
                self._stream_data(event)
            case events.DatagramFrameReceived() if self._established:
                self._send_and_report(*self._receiver.receive(event.data, now))
            case events.StreamReset() | events.StopSendingReceived() if event.stream_id == SESSION_STREAM:
                self.stop("the server closed the stream of the session")
            case events.ConnectionTerminated():
                self._on_terminated(event)
        self._rearm()

    def _on_terminated(self, event: events.ConnectionTerminated) -> None:
        """Processes the end of the QUIC connection, which may also end the transfer."""
        by_application = event.frame_type is None
        final = event.error_code in ((MALFORMED, INTERNAL) if by_application else CERTIFICATE_ALERTS)
        now, idle = self._loop.time(), not by_application and _is_timeout(event)
        if self._is_interrupted:  # this client has closed it
            self._finish()
        elif not final and (self._receiver.may_resume(now) or (idle and self._receiver.may_connect(now))):
            self._is_interrupted = True
            self._finish()
        else:
            before = "" if self._receiver.welcome is None else "the server fell silent; "
            self.stop(before + _end_message(event, established=self._established))

    def _check_certificate(self) -> None:
        """Ends the transfer if the server's certificate does not have the accepted fingerprint."""
        shown = self._quic.tls._peer_certificate  # aioquic has no public accessor
        if self._trust.fingerprint is not None and (shown is None or fingerprint(shown) != self._trust.fingerprint):
            actual = "none" if shown is None else fingerprint(shown)
            self.stop(f"the server's certificate has another fingerprint: {actual}")
            self.close(REFUSED, "certificate")
            return
        self._established = True
        self._receiver.on_connected(self._loop.time())

    def _stream_data(self, event: events.StreamDataReceived) -> None:
        try:
            messages = self._reader.feed(event.data) if event.stream_id == SESSION_STREAM else []
        except BitstreamError as error:
            self.stop(str(error))
            return
        for message in messages:
            self._send_and_report(*self._receiver.receive(message, self._loop.time()))

    def stopped(self, end: asyncio.Future[str]) -> None:
        """Ends the transfer, because the future for its end has a result, the reason."""
        self.stop(end.result())

    def stop(self, reason: str) -> None:
        """Ends the transfer with a reason, and keeps all received data."""
        self._send_and_report(*self._receiver.stop(reason))
        self._finish()

    def _tick(self) -> None:
        """Polls the receiver, sends the messages that it returns, and sets a timer for the next poll."""
        self._alarm = None
        if self._finished.done():
            return
        try:
            self._send_and_report(*self._receiver.poll(self._loop.time()))
        except Exception as error:
            self._fail(error)
            return
        self.transmit()
        self._rearm()

    def _rearm(self) -> None:
        at = None if self._finished.done() else self._receiver.next_at()
        if at is None:
            self._finish()
        elif self._alarm is None:
            self._alarm = self._loop.call_at(at, self._tick)
        elif at < self._alarm.when():
            self._alarm.cancel()
            self._alarm = self._loop.call_at(at, self._tick)

    def _finish(self) -> None:
        if not self._finished.done():
            self._finished.set_result(None)

    def _fail(self, error: Exception) -> None:
        if not self._finished.done():
            self._finished.set_exception(error)

    def _send_and_report(self, messages: list[bytes], transfer_events: list[Event]) -> None:
        for data in messages:
            if is_stream_message(data):
                send_on_stream(self._quic, SESSION_STREAM, length_prefixed(data))  # if it is closed, its event follows
            elif self._established:
                self._quic.send_datagram_frame(data)
        if self._on_event:
            for event in transfer_events:
                self._on_event(event)

    def _tap_datagram(self, outgoing: bool, data: bytes) -> None:
        if self._tap is not None:
            ends = (self._local_address, self._target[:2])
            self._tap(*(ends if outgoing else ends[::-1]), data)


def _is_timeout(event: events.ConnectionTerminated) -> bool:
    """True if a connection ended because nothing arrived before the idle timeout."""
    return event.error_code == QuicErrorCode.INTERNAL_ERROR and "timeout" in event.reason_phrase.lower()


def _end_message(event: events.ConnectionTerminated, *, established: bool) -> str:
    """Returns a message with the reason why a connection ended, and advice for known causes.

    Args:
        event: Event of aioquic with the error code of the connection's end.
        established: True if the handshake of the connection was complete.
    """
    reason = event.reason_phrase or (hex(event.error_code) if event.error_code else "the server closed the connection")
    if not established and _is_timeout(event):
        return f"no answer: {NO_QUIC}, or {SMALL_MTU}"
    if event.error_code in CERTIFICATE_ALERTS:
        return (
            f"the server's certificate is not trusted: {reason}. Trust it with --fingerprint (which the server "
            "prints when it starts) or --authority (a file with its certificate, or with that of the authority that "
            "signed it), or accept any certificate with --insecure"
        )
    return f"the session ended: {reason}"


class _ConnectedTransport:
    """Transport for aioquic that sends datagrams over a connected UDP socket, and reports each datagram to a function.

    Args:
        transport: asyncio transport of the connected socket.
        tap: Function that is called for each sent datagram. Its arguments are True, which stands for a sent datagram,
            and the bytes of the datagram.
    """

    def __init__(self, transport: Any, tap: Callable[[bool, bytes], None]) -> None:
        self._transport, self._tap = transport, tap

    def sendto(self, data: bytes, addr: Any = None) -> None:
        self._tap(True, data)
        self._transport.sendto(data)

    def close(self) -> None:
        self._transport.close()
