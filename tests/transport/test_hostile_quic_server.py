"""Hostile QUIC servers end a transfer with a reason, and never with an exception of the QUIC library."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from splatwire.transport import ReceiverOptions
from splatwire.transport.protocol.messages import NOT_YET, Refuse, Request
from splatwire.transport.protocol.wire import decode, encode

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.asyncio.server import serve
from aioquic.quic import events

from splatwire.transport.quic.common import ALPN, SESSION_STREAM, MessageReader, configuration, length_prefixed
from transport.test_quic import IDENTITY, fetch, run

pytestmark = pytest.mark.slow

Malice = Callable[[Any, bytes], Any]


async def reason(malice: Malice) -> str:
    """Returns why a transfer ends if a server answers each request with an attack."""

    class Hostile(QuicConnectionProtocol):
        def quic_event_received(self, event: events.QuicEvent) -> None:
            if isinstance(event, events.StreamDataReceived) and event.data:
                (message,) = MessageReader().feed(event.data)
                request = decode(message)
                assert isinstance(request, Request)
                malice(self._quic, length_prefixed(encode(Refuse(request.nonce, NOT_YET))))
                self.transmit()

    settings = configuration(is_client=False, alpn=[ALPN], idle_s=10.0)
    settings.certificate, _, settings.private_key = IDENTITY
    server = await serve("127.0.0.1", 0, configuration=settings, create_protocol=Hostile)
    try:
        port = server._transport.get_extra_info("sockname")[1]
        receiver = await asyncio.wait_for(fetch(port, ReceiverOptions(silence_s=20.0, deadline_s=20.0)), 240)
    finally:
        server.close()
    assert receiver.finished is not None
    return receiver.finished.reason


@pytest.mark.parametrize(
    "malice",
    [
        lambda quic, again: (quic.send_stream_data(SESSION_STREAM, again), quic.stop_stream(SESSION_STREAM, 9)),
        lambda quic, again: (
            quic.send_stream_data(SESSION_STREAM, again, end_stream=True),
            quic.stop_stream(SESSION_STREAM, 9),
        ),
        lambda quic, again: quic.reset_stream(SESSION_STREAM, 9),
    ],
    ids=["stops", "ends and stops", "resets"],
)
def test_a_server_that_closes_the_stream_ends_the_transfer(malice: Malice) -> None:
    assert run(reason(malice)) == "the server closed the stream of the session"
