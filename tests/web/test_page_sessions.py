"""After a broken session the next one, or HTTP, delivers exactly the missing packets."""

import asyncio
from contextlib import AsyncExitStack
from typing import Any

import pytest

from explicit import encode_splats
from splatwire.codec.gaussians.quality import Quality
from splatwire.errors import InvalidValueError
from splatwire.transport import make_served_stream
from splatwire.transport.http.content import served_stream_file
from splatwire.transport.protocol.messages import Data, Have
from splatwire.transport.protocol.wire import DATA, END, HAVE, decode, message_kind
from transport.chromium import executable, isolated_page
from web.host import hosting
from web.pictures import ELEMENT
from web.test_page import SMALL, STATUS, ball, run

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport.quic.certificate import self_signed
from splatwire.transport.quic.common import WEBTRANSPORT_PATH
from splatwire.transport.quic.server import QuicServer

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
LOST = "window.events.filter(([kind]) => kind === 'lost').map(([, {reason}]) => reason)"


class HalfServer(QuicServer):
    """Sends half of the packets, then only repetitions of them, so that the page receives no more but no silence."""

    def __init__(self, *given: Any, half: int, **more: Any) -> None:
        super().__init__(*given, **more)
        plain, places, last = self.core.poll, set[int](), {}

        def poll(now: float, most: int = 64) -> list[Any]:
            sent = []
            for session, data in plain(now, most):
                place = decode(data).packet_index if message_kind(data) == DATA else None
                if place is not None and (place in places or len(places) < half):
                    places.add(place)
                    last[session] = data
                elif place is not None or message_kind(data) == END:
                    data = last.get(session)
                if data is not None:
                    sent.append((session, data))
            return sent

        self.core.poll = poll


class RestServer(QuicServer):
    """Loses packets until the page has named those that it has, and records both kinds.

    If a busy machine breaks a session, another one follows, and the page names more packets there.
    """

    def __init__(self, *given: Any, **more: Any) -> None:
        super().__init__(*given, **more)
        plain_receive, plain_poll = self.core.receive, self.core.poll
        self.held, self.places, self.repeated = set[int](), set[int](), set[int]()

        def receive(address: Any, data: bytes, *given: Any, **more: Any) -> bytes | None:
            answer = plain_receive(address, data, *given, **more)
            if message_kind(data) == HAVE:
                message = decode(data)
                assert isinstance(message, Have)
                self.held |= {
                    message.first + n for n in range(8 * len(message.held)) if message.held[n // 8] >> n % 8 & 1
                }
            return answer

        def poll(now: float, most: int = 64) -> list[Any]:
            sent = []
            for session, data in plain_poll(now, most):
                message = decode(data)
                if isinstance(message, Data):
                    if not self.held:
                        continue
                    self.places.add(message.packet_index)
                    if message.packet_index in self.held:
                        self.repeated.add(message.packet_index)
                sent.append((session, data))
            return sent

        self.core.receive, self.core.poll = receive, poll


@pytest.mark.parametrize("back", [True, False], ids=["session", "http"])
def test_broken_session_is_resumed_by_a_new_one(back: bool) -> None:
    stream = encode_splats(ball(6000), SMALL, quality=Quality(10.0))
    program, identity = make_served_stream(stream), self_signed()
    file, half = served_stream_file(program), len(stream.packets) // 2

    async def work() -> None:
        async with AsyncExitStack() as stack:

            async def serving(kind: type[QuicServer], port: int, **more: Any) -> QuicServer:
                server = kind({"ball": program}, "127.0.0.1", port, identity=identity, **more)
                stack.callback(server.close)
                await server.start()
                return server

            async def again(port: int) -> QuicServer:
                while True:
                    try:
                        return await serving(RestServer, port)
                    except InvalidValueError:  # the earlier socket closes in one of the next turns of the loop
                        await asyncio.sleep(0.01)

            first = await serving(HalfServer, 0, half=half)
            tag = (
                f'<script type="module" src="splatwire.js"></script><splat-wire src="ball.swz" panel="open" '
                f'session="https://127.0.0.1:{first.port}{WEBTRANSPORT_PATH}" fingerprint="{identity.fingerprint}" '
                'style="width: 400px; height: 300px"></splat-wire>'
            )
            # without a file, the page waits for a session that a busy machine opens late
            host = await stack.enter_async_context(hosting({"page": tag}, {} if back else {"ball.swz": file}))
            with isolated_page() as page:

                async def seen(expression: str) -> Any:
                    return await asyncio.to_thread(page.wait_for, expression)

                await asyncio.to_thread(page.open, f"{host.url}page")
                await seen(f"{STATUS}?.packets === {half}")
                first.close()
                second = await again(first.port) if back else None
                await seen(f"{STATUS}.verified")
                packets, transport = await asyncio.to_thread(page.evaluate, f"[{STATUS}.packets, {STATUS}.transport]")
                assert packets == len(stream.packets)
                assert ("datagrams" in transport) is back
                assert await seen(f"{LOST}.length > 0")
                text = await seen(f"{ELEMENT}.shadowRoot.querySelector('.laboratory').innerText")
                assert "dropped " in " ".join(str(text).split())
                if isinstance(second, RestServer):
                    assert len(second.held) >= half
                    assert second.held | second.places == set(range(len(stream.packets)))
                    assert second.repeated == set(), "packets that the page has were sent again"
                else:
                    assert all("range" in request.headers for request in host.asked)
                    assert host.sent < 0.6 * len(file)

    run(work())
