"""Hostile clients of the page server: their limits, and service for other clients."""

import asyncio
import contextlib
import gc
import logging
import os
import random
import socket
import struct
import tracemalloc
import weakref
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import replace
from typing import Any

import pytest

from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.transport.http import server as server_module
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.messages import read_request
from splatwire.transport.http.server import CHUNK_BYTES, PageLimits, PageServer

BODY = random.Random(0).randbytes(8 << 20)
CONTENT = PageContent({"big": BODY}, WebTransportEndpoint(4840, "/splatwire", "ab" * 32))
HERE, ELSEWHERE = "127.0.0.1", "127.0.0.2"
GET = b"GET %b HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
PATIENT = PageLimits(request_s=60.0, chunk_s=60.0)
"""Limits for tests independent of time: a slow machine drops no client."""
PAGE, BIG = GET % b"/", GET % b"/streams/big.swz"


def run(work: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(work, 60))


async def until(true: Callable[[], Any], seconds: float = 240.0) -> None:
    async with asyncio.timeout(seconds):
        while not true():
            await asyncio.sleep(0.01)


async def asked(port: int, request: bytes = PAGE, host: str = ELSEWHERE) -> bytes:
    """Answer to a client that sends a request and reads to the end."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=(host, 0))
    writer.write(request)
    try:
        return await asyncio.wait_for(reader.read(), 120)
    except ConnectionResetError:
        return b""
    finally:
        writer.close()


@contextlib.asynccontextmanager
async def clients(port: int, count: int, said: bytes, host: str = HERE) -> AsyncIterator[list[socket.socket]]:
    """Connections that send data and do not read."""
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(socket.socket()) for _ in range(count)]
        loop = asyncio.get_running_loop()
        for client in opened:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
            client.bind((host, 0))
            client.setblocking(False)
            await loop.sock_connect(client, ("127.0.0.1", port))
            await loop.sock_sendall(client, said)
        yield opened


def ended(client: socket.socket) -> bool:
    """Returns True if the server has ended a connection; reads earlier data."""
    try:
        return client.recv(1 << 20) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


@pytest.mark.parametrize("said", [b"", b"G", b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"])
def test_half_open_requests_of_one_address_block_no_other_client(said: bytes):
    async def work() -> None:
        async with PageServer(CONTENT, limits=PATIENT) as server, clients(server.port, 300, said) as others:
            for _ in range(34):
                for host in (ELSEWHERE, HERE):
                    assert (await asked(server.port, host=host)).startswith(b"HTTP/1.1 200")
            assert sum(map(ended, others)) < 150, "only what the others took the place of"

    run(work())


def test_incomplete_requests_are_limited_at_the_expense_of_the_largest_network():
    limits = replace(PATIENT, waiting=8)

    async def work() -> None:
        async with PageServer(CONTENT, limits=limits) as server:
            async with clients(server.port, 3, b"GET", ELSEWHERE) as few, clients(server.port, 20, b"GET") as many:
                await until(lambda: sum(map(ended, many)) == 15)
                assert not any(map(ended, few))
                assert [ended(client) for client in many] == [True] * 15 + [False] * 5, "the oldest go"
                assert len(server._waiting) == 8
            await until(lambda: not server._waiting)

    run(work())


def test_slowly_sent_request_has_the_common_deadline():
    async def work() -> None:
        async with (
            PageServer(CONTENT, limits=PageLimits(request_s=0.3)) as server,
            clients(server.port, 1, b"GET / HTTP/1.1\r\nX: ") as (client,),
        ):

            def dribbled() -> bool:
                with contextlib.suppress(OSError):
                    client.send(b"x")
                return ended(client)

            await until(dribbled)

    run(work())


class Watched(PageServer):
    """A page server that keeps weak references to its connections."""

    references: tuple[weakref.ref[Any], ...] = ()

    def _begin(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.references += tuple(map(weakref.ref, (reader, writer, writer.transport)))
        super()._begin(reader, writer)


@pytest.mark.parametrize(
    ("said", "end"),
    [
        (b"GET / HTTP/1.1\r\n", "timeout"), (b"GET / HTTP/1.1\r\n", "eviction"), (b"GET / HTTP/1.1\r\n", "close"),
        (b"GET / HTTP/1.1\r\n", "reset"), (BIG, "reset"), (BIG, "too slow"), (PAGE, "close"), (b"x" * 9000, "close"),
    ],
)  # fmt: skip
def test_ended_connections_free_their_memory_without_the_garbage_collector(
    said: bytes, end: str, monkeypatch: pytest.MonkeyPatch
):
    sizes, original = list[int](), asyncio.StreamReader.feed_data

    def feed_data(reader: asyncio.StreamReader, data: bytes) -> None:
        sizes.append(len(data))
        original(reader, data)

    monkeypatch.setattr(asyncio.StreamReader, "feed_data", feed_data)
    limits = {
        "timeout": replace(PATIENT, request_s=0.2), "eviction": replace(PATIENT, waiting=1),
        "too slow": replace(PATIENT, chunk_s=0.2),
    }.get(end, PATIENT)  # fmt: skip

    async def work() -> None:
        server = Watched(CONTENT, limits=limits)
        async with server:
            async with clients(server.port, 5, said) as opened:
                await until(lambda: len(server.references) == 15)
                if end not in ("timeout", "eviction"):
                    await until(lambda: sum(sizes) == 5 * len(said))
                if end == "reset":
                    for client in opened:
                        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                        client.close()
                elif end == "eviction":
                    await until(lambda: len(server._clients) == 1)
                elif end != "close":
                    await until(lambda: not server._clients)
            await until(lambda: not server._clients)
            await until(lambda: not any(reference() for reference in server.references))

    gc.collect()
    gc.disable()
    try:
        run(work())
    finally:
        gc.enable()


def received(client: socket.socket) -> bytes:
    """Returns what a client has received and not read."""
    try:
        return client.recv(1 << 16, socket.MSG_PEEK)
    except BlockingIOError:
        return b""


class Stalled:
    """Stream file that grows no further after its first bytes."""

    async def pieces(self) -> AsyncIterator[bytes]:
        yield b"first bytes"
        await asyncio.Event().wait()


@pytest.mark.parametrize("resets", [False, True])
def test_readers_that_leave_a_file_that_grows_no_further_free_their_slots(
    resets: bool, monkeypatch: pytest.MonkeyPatch
):
    """Such as a page that is loaded again and again while a live server is away."""
    monkeypatch.setattr(server_module, "CLOSING_S", 600.0 if resets else 0.01)

    async def work() -> None:
        content = PageContent({"live": Stalled()})
        async with PageServer(content, limits=replace(PATIENT, per_network=3)) as server:
            async with clients(server.port, 3, GET % b"/streams/live.swz") as opened:
                await until(lambda: server.num_active == 3)
                for client in opened:
                    await until(lambda client=client: b"first bytes" in received(client))
                    if resets:
                        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                    client.close()
                await until(lambda: not server.num_active)
            assert (await asked(server.port, host=HERE)).startswith(b"HTTP/1.1 200")

    run(work())


def test_a_client_that_ends_its_sending_side_gets_a_file_while_it_grows(monkeypatch: pytest.MonkeyPatch):
    async def discard(reader: asyncio.StreamReader) -> None:
        await discard_all(reader)
        has_ended.set()

    class Growing:
        """Stream file whose last piece is available once the server has read the client's end."""

        async def pieces(self) -> AsyncIterator[bytes]:
            yield b"first bytes"
            await has_ended.wait()
            await asyncio.sleep(0.05)  # the server has time to end the connection, which it must not
            yield b" and the last ones"

    async def work() -> None:
        async with PageServer(PageContent({"live": Growing()}), limits=PATIENT) as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(GET % b"/streams/live.swz")
            await reader.readuntil(b"first bytes")
            writer.write_eof()
            assert b"and the last ones" in await reader.read()
            writer.close()

    discard_all, has_ended = server_module._discard, asyncio.Event()
    monkeypatch.setattr(server_module, "_discard", discard)
    monkeypatch.setattr(server_module, "CLOSING_S", 600.0)
    run(work())


def test_a_slow_client_that_ended_its_sending_side_is_not_taken_for_one_that_left(monkeypatch: pytest.MonkeyPatch):
    class Growing:
        """Stream file whose second piece is sent slowly."""

        async def pieces(self) -> AsyncIterator[bytes]:
            yield b"first bytes"
            yield b" and the last ones"

    async def write(server: PageServer, data: bytes, *others: Any) -> None:
        if data == b" and the last ones":  # as if the client read slowly, or the rate limit were used up
            await asyncio.sleep(0.1)
        await written(server, data, *others)

    async def work() -> None:
        async with PageServer(PageContent({"live": Growing()}), limits=PATIENT) as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(GET % b"/streams/live.swz")
            writer.write_eof()
            assert b"and the last ones" in await reader.read()
            writer.close()

    written = PageServer._write
    monkeypatch.setattr(PageServer, "_write", write)
    monkeypatch.setattr(server_module, "CLOSING_S", 0.01)
    run(work())


@pytest.mark.parametrize("wanted", [b"", b"Range: bytes=1-\r\n"], ids=["whole", "range"])
def test_slow_readers_share_one_body_in_memory(wanted: bytes):
    readers, said = 64, b"%b%b\r\n" % (BIG[:-2], wanted)

    async def work() -> None:
        async with PageServer(CONTENT, limits=replace(PATIENT, per_network=readers)) as server:
            assert await asked(server.port, BIG)
            tracemalloc.start()
            async with clients(server.port, readers, said):
                await until(lambda: len(server._slots) == readers)
                assert (await asked(server.port, said)).endswith(BODY[-1000:])
                # The honest client, which runs in this process, has the stream twice for a moment.
                assert tracemalloc.get_traced_memory()[1] < readers * (CHUNK_BYTES + (1 << 16)) + 4 * len(BODY)
            tracemalloc.stop()
            await until(lambda: len(server._slots) == 0)

    try:
        run(work())
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("limits", "reads"),
    [(PageLimits(chunk_s=0.2), 0), (PageLimits(grace_s=0.2, slowest_bytes_s=1e8), 1000)],
    ids=["nothing is read", "a little is read again and again"],
)
def test_too_slow_readers_are_disconnected(limits: PageLimits, reads: int):
    async def work() -> None:
        async with PageServer(CONTENT, limits=limits) as server, clients(server.port, 20, BIG) as slow:
            await until(lambda: all(map(peeked, slow)))  # each was begun with

            def dropped() -> bool:
                for client in slow if reads else ():
                    with contextlib.suppress(OSError):
                        client.recv(reads)
                return len(server._slots) == 0

            await until(dropped)
            await until(lambda: not server._clients)  # no connections wait for them any more

    run(work())


def test_one_network_holds_at_most_its_share_of_connections():
    async def work() -> None:
        limits = replace(PATIENT, slots=6, per_network=4)
        async with PageServer(CONTENT, limits=limits) as server, clients(server.port, 9, BIG) as slow:
            await until(lambda: sum(b" 503 " in peeked(client) for client in slow) == 5)
            assert (await asked(server.port, host=HERE)).startswith(b"HTTP/1.1 503")
            assert (await asked(server.port, BIG)).endswith(BODY[-1000:])
            async with clients(server.port, 2, BIG, "127.0.0.3"):
                await until(lambda: len(server._slots) == 6)
                assert (await asked(server.port, host=HERE)).startswith(b"HTTP/1.1 503")
                assert (await asked(server.port, host="127.0.0.3")).startswith(b"HTTP/1.1 200"), "three of each"
            await until(lambda: len(server._slots) == 3)
            assert (await asked(server.port, host=HERE)).startswith(b"HTTP/1.1 200")

    run(work())


def test_networks_holding_all_connections_yield_to_others():
    """Slow readers of nine networks occupy all connections; honest readers of a tenth are answered at once."""
    limits = replace(PATIENT, slots=36, per_network=4)

    async def work() -> None:
        async with contextlib.AsyncExitStack() as stack:
            server = await stack.enter_async_context(PageServer(CONTENT, limits=limits))
            for network in range(9):
                await stack.enter_async_context(clients(server.port, 4, BIG, f"127.0.1.{network + 1}"))
            await until(lambda: len(server._slots) == 36)
            for _ in range(34):
                assert (await asked(server.port)).startswith(b"HTTP/1.1 200")
            assert len(server._slots) >= 35, "one place was taken, and used by all of them"

    run(work())


def test_many_networks_of_one_provider_yield_to_others():
    """Each slow reader has its own address in one /24, so that no network has more than the honest one."""

    async def work() -> None:
        async with contextlib.AsyncExitStack() as stack:
            server = await stack.enter_async_context(PageServer(CONTENT, limits=replace(PATIENT, slots=36)))
            for network in range(40):
                await stack.enter_async_context(clients(server.port, 1, BIG, f"127.0.1.{network + 1}"))
            await until(lambda: len(server._slots) == 36)
            for _ in range(34):
                assert (await asked(server.port)).startswith(b"HTTP/1.1 200")

    run(work())


def peeked(client: socket.socket) -> bytes:
    try:
        return client.recv(100, socket.MSG_PEEK)
    except (BlockingIOError, ConnectionResetError):
        return b""


@pytest.mark.skipif(not socket.has_dualstack_ipv6(), reason="this machine has no sockets for IPv4 and IPv6")
def test_a_server_on_all_ipv6_addresses_answers_over_ipv4_too() -> None:
    """As the UDP server at this address does."""
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")

    async def work() -> None:
        async with PageServer(replace(CONTENT, host="::")) as server:
            for host in ("127.0.0.1", "::1"):
                reader, writer = await asyncio.open_connection(host, server.port)
                writer.write(PAGE)
                assert (await reader.read()).startswith(b"HTTP/1.1 200 OK"), host
                writer.close()
            with pytest.raises(InvalidValueError, match="in use"):
                await PageServer(replace(CONTENT, host="::"), server.port).__aenter__()

    run(work())


def test_shutdown_prints_nothing_during_transfers(caplog: pytest.LogCaptureFixture):
    async def work() -> None:
        async with (
            asyncio.timeout(60),
            PageServer(CONTENT, limits=replace(PATIENT, per_network=100)) as server,
            clients(server.port, 50, BIG),
            clients(server.port, 50, b"GET"),
        ):
            await until(lambda: len(server._slots) == 50 and len(server._clients) == 100)

    with caplog.at_level(logging.DEBUG, "asyncio"):
        asyncio.run(work(), debug=False)
    assert [record.message for record in caplog.records if record.levelno > logging.DEBUG] == []


@pytest.mark.parametrize(
    "host",
    [
        "[::1%\nX-Injected: 1\n]", "[::1%x; script-src *]", "[::1%25x]", "[::1", "[::1]x", "[1.2.3.4]", "::1", "",
        "127.0.0.1%x", "localhost:80:80", "localhost:x", "local host", "localhost; script-src *", "a\x00b", "a\x7f",
        "\xfcber.example", "127.0.0.1/", "user@localhost", "localhost\r\nHost: localhost", 'x"y', "localhost\t:80",
    ],
)  # fmt: skip
def test_host_header_must_be_an_address_or_a_name(host: str):
    head, _ = CONTENT.respond_now(f"GET / HTTP/1.1\r\nHost: {host}\r\n\r\n".encode("latin-1"))
    assert head.startswith(b"HTTP/1.1 400 ")
    assert b"Injected" not in head
    assert b"script-src *" not in head


def test_host_headers_are_parsed():
    for text, host in (
        ("127.0.0.1:8080", "127.0.0.1"), ("[::1]:80", "[::1]"), ("[2001:DB8::1]", "[2001:DB8::1]"),
        ("localhost", "localhost"), ("my_host.local:", "my_host.local"), (" \tlocalhost ", "localhost"),
    ):  # fmt: skip
        assert read_request(f"GET / HTTP/1.0\r\nHost:{text}".encode()).host == host


@pytest.mark.parametrize(
    "head",
    [
        b"", b"GET", b"GET / HTTP/1.1", b"GET  / HTTP/1.1\r\nHost: a", b"GET x HTTP/1.1\r\nHost: a",
        b"GET / HTTP/1.1\r\nHost: a\r\n folded", b"GET / HTTP/1.1\r\nHost : a", b"GET / HTTP/1.1\nHost: a",
        b"GET / HTTP/1.1\r\nHost: a\r\nX: b\rc", b"GET / HTTP/1.1\r\nHost: a\r\n: b", b"GET /\xff HTTP/1.1\r\nHost: a",
        b"GET / HTTP/1.1\r\nHost: a\r\nhost: a", b"G\x01T / HTTP/1.1\r\nHost: a", b"GET / HTTP/1.12\r\nHost: a",
    ],
)  # fmt: skip
def test_malformed_requests_are_refused(head: bytes):
    with pytest.raises(BitstreamError):
        read_request(head)


@pytest.mark.parametrize(
    ("request_head", "status"),
    [
        (b"GET /%b HTTP/1.1\r\nHost: localhost\r\n\r\n" % (b"x" * 9000), b"414 URI Too Long"),
        (b"GET /%b HTTP/1.1\r\nHost: localhost\r\n\r\n" % (b"x" * 2_000_000), b"414 URI Too Long"),
        (PAGE[:-2] + b"X: %b\r\n\r\n" % (b"x" * 9000), b"431 Request Header Fields Too Large"),
        (PAGE[:-2] + b"X: y\r\n" * 200_000 + b"\r\n", b"431 Request Header Fields Too Large"),
        (b"POST" + PAGE[3:-2] + b"Content-Length: 2000000\r\n\r\n" + bytes(2_000_000), b"405 Method Not Allowed"),
    ],
)  # fmt: skip
def test_refused_requests_get_their_answer_however_long_they_are(request_head: bytes, status: bytes):
    """Unread bytes would reset the connection before the client has read the answer."""

    async def work() -> None:
        async with PageServer(CONTENT, limits=PATIENT) as server:
            for _ in range(5):
                answer = await asked(server.port, request_head)
                assert answer.startswith(b"HTTP/1.1 " + status)
                assert b"Connection: close\r\n" in answer
            await until(lambda: not server._clients)
            assert not len(server._waiting) + server.num_active

    run(work())


def test_mutated_requests_get_answers_with_fixed_headers():
    """No byte of a request appears in an answer's header: names and values are from a fixed set."""
    rng = random.Random(6)
    good = [
        b"GET / HTTP/1.1\r\nHost: [::1]:80\r\nOrigin: https://a.org\r\nAccept-Encoding: gzip\r\n\r\n",
        b"GET /streams/big.swz?stream=x HTTP/1.1\r\nHost: localhost\r\n\r\n", PAGE, GET % b"/streams.json",
    ]  # fmt: skip
    names, codes = set(), set()
    for _ in range(10_000):
        head = bytearray(rng.choice(good))
        for _ in range(rng.randrange(1, 5)):
            at = rng.randrange(len(head))
            match rng.randrange(4):
                case 0:
                    head[at] = rng.randrange(256)
                case 1:
                    head[at:at] = rng.choice((b"%", b"\n", b"\r\nX-Injected: 1", b";", b"\0", b"]", b"[", b'"', b"\t"))
                case 2:
                    del head[at : at + rng.randrange(9)]
                case 3:
                    head[at:at] = rng.choice(good)[: rng.randrange(60)]
        answer, _ = CONTENT.respond_now(bytes(head))
        status, *lines = answer.decode().removesuffix("\r\n\r\n").split("\r\n")
        codes.add(status)
        names |= {line.partition(":")[0] for line in lines}
        assert not any(ord(byte) < 32 for line in lines for byte in line)
        policy = next((line for line in lines if line.startswith("Content-Security-Policy")), "")
        assert policy.count(";") in (0, 8)
    assert names == {
        "Content-Type", "Content-Length", "X-Content-Type-Options", "Referrer-Policy", "Cache-Control", "Connection",
        "Content-Security-Policy", "Allow", "Accept-Ranges", "ETag", "Vary",
    }  # fmt: skip
    assert codes == {
        f"HTTP/1.1 {words}"
        for words in ("200 OK", "400 Bad Request", "403 Forbidden", "404 Not Found", "405 Method Not Allowed")
    }


def test_hostile_ranges_get_their_bytes_or_nothing():
    rng, body = random.Random(8), bytes(range(256)) * 4
    content = PageContent({"city": body})
    tag = content.respond_now(GET % b"/streams/city.swz").head.decode().split('ETag: "')[1].split('"')[0]
    numbers = ["0", "1", "7", "1023", "1024", "99999999999999999999", "-1", "", "x", "0x10", "1.5", "٣"]
    for _ in range(int(os.environ.get("SPLATWIRE_FUZZ_CASES", "600"))):
        some = "-".join(rng.choice(numbers) for _ in range(rng.choice([1, 2, 2, 2, 3])))
        words = [f"Range: {rng.choice(['bytes=', 'bytes', 'lines=', 'bytes = '])}{some}{rng.choice(['', ',0-1'])}"]
        words += [f"If-Range: {rng.choice([tag, chr(34) + tag + chr(34), 'W/x', ''])}"] * rng.randrange(2)
        words += [f"If-None-Match: {rng.choice(['*', chr(34) + tag + chr(34), chr(34)])}"] * rng.randrange(2)
        request = f"GET /streams/city.swz?{rng.choice([tag, '', 'x'])} HTTP/1.1\r\nHost: localhost\r\n"
        answer = content.respond_now((request + "\r\n".join(words) + "\r\n\r\n").encode("utf-8"))
        head, status = answer.head.decode("latin-1"), int(answer.head[9:12])
        assert status in (200, 206, 304, 400, 416)
        if status == 206:
            first, end = (int(n) for n in head.split("Content-Range: bytes ")[1].split("/")[0].split("-"))
            assert bytes(answer.body) == body[first : end + 1] != b""
