"""A limit of the bytes to all clients together, over datagrams and over HTTP."""

import asyncio
import random
import time
from collections import Counter

import pytest

pytest.importorskip("raptorq", reason="the package raptorq is not installed")

from splatwire.transport import Server, ServerLimits, make_served_stream
from splatwire.transport.congestion.pacing import Pacer
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.server import PageLimits, PageServer
from splatwire.transport.protocol.messages import Request
from splatwire.transport.protocol.wire import encode
from transport.network import SECRET, datagram_stream

TOTAL = 100_000.0
"""Bytes per second."""


def sent_to(num_clients, limits, seconds):
    """Bytes that each client is sent in simulated time."""
    program = make_served_stream(datagram_stream(num_anchors=8000, side_bytes=3000))
    server = Server({"scene": program}, secret=SECRET, random=random.Random(0).randbytes, limits=limits)
    for client in range(num_clients):
        server.receive((f"10.0.0.{client}", 1), encode(Request(client + 1, bytes(24), "scene")), 0.0, reliable=True)
    sent, now = Counter(), 0.0
    while (at := server.next_at()) is not None and at <= seconds:
        now = max(now, at)
        for client_address, data in server.poll(now):
            sent[client_address[0]] += len(data)
    return sent


def test_all_clients_together_stay_below_the_limit_and_share_it():
    sent = sent_to(4, ServerLimits(fixed_rate=TOTAL, total_rate=TOTAL), 1.0)
    assert 0.9 * TOTAL < sum(sent.values()) < 1.05 * TOTAL
    assert min(sent.values()) > 0.8 * TOTAL / 4


def test_a_limit_that_is_not_reached_changes_nothing():
    limits = ServerLimits(fixed_rate=TOTAL / 10)
    assert sent_to(3, limits, 1.0) == sent_to(3, ServerLimits(fixed_rate=TOTAL / 10, total_rate=TOTAL), 1.0)


def test_datagrams_that_wait_for_the_limit_claim_the_next_turn():
    program = make_served_stream(datagram_stream(num_anchors=8000, side_bytes=3000))
    limits = ServerLimits(fixed_rate=TOTAL, total_rate=TOTAL)
    server = Server({"scene": program}, secret=SECRET, random=random.Random(0).randbytes, limits=limits)
    server.receive(("10.0.0.1", 1), encode(Request(1, bytes(24), "scene")), 0.0, reliable=True)
    pacer = server.total_pacer
    server.poll(0.0)
    pacer.sent(50_000, 0.0)  # as a response over HTTP
    assert server.poll(0.2) == []
    assert pacer.datagrams_wait
    sent, now = [], 0.2
    while not sent:
        now = server.next_at()
        sent = server.poll(now)
    assert now == pytest.approx(0.5, abs=0.05)


@pytest.mark.slow
def test_http_responses_share_the_limit():
    rate, size = 400_000.0, 300_000
    content = PageContent({"big": bytes(size)})

    async def take(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /streams/big.swz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        body = (await reader.read()).partition(b"\r\n\r\n")[2]
        writer.close()
        return len(body)

    async def work():
        async with PageServer(content, pacer=Pacer(rate)) as server:
            started = time.monotonic()
            assert await asyncio.gather(*(take(server.port) for _ in range(3))) == [size] * 3
            return time.monotonic() - started

    assert asyncio.run(asyncio.wait_for(work(), 120)) > 0.8 * 3 * size / rate


@pytest.mark.slow
def test_waiting_for_the_limit_of_all_clients_does_not_count_as_a_slow_client():
    rate, size = 100_000.0, 500_000
    content = PageContent({"big": bytes(size)})
    limits = PageLimits(slowest_bytes_s=1e9, grace_s=3.0)  # less than the waiting, which takes more than 4 s

    async def work():
        async with PageServer(content, limits=limits, pacer=Pacer(rate)) as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(b"GET /streams/big.swz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            body = (await reader.read()).partition(b"\r\n\r\n")[2]
            writer.close()
            return len(body)

    assert asyncio.run(asyncio.wait_for(work(), 120)) == size


@pytest.mark.slow
def test_many_http_responses_leave_turns_to_datagrams():
    rate, num_responses, num_bytes = 200_000.0, 30, 200_000
    content, pacer = PageContent({"big": bytes(400_000)}), Pacer(rate)

    async def datagrams(server):
        loop, num_sent = asyncio.get_running_loop(), 0
        while 1200 * num_sent + server.bytes_sent < num_bytes:
            await asyncio.sleep(max(pacer.next_at() - loop.time(), 0))
            if pacer.next_at() <= loop.time():
                pacer.sent(1200, loop.time())
                num_sent += 1
            pacer.datagrams_wait = True
        return 1200 * num_sent

    async def work():
        async with PageServer(content, pacer=pacer) as server:
            writers = []
            for _ in range(num_responses):
                _, writer = await asyncio.open_connection("127.0.0.1", server.port)
                writer.write(b"GET /streams/big.swz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
                writers.append(writer)
            while not server.bytes_sent:
                await asyncio.sleep(0.01)
            num_in_datagrams = await datagrams(server)
            for writer in writers:
                writer.close()
            return num_in_datagrams, server.bytes_sent

    shares = [count / num_bytes for count in asyncio.run(asyncio.wait_for(work(), 120))]
    assert min(shares) > 0.15
