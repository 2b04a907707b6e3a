"""Time of honest clients beside a flood of hostile datagrams, connections or requests, and the server's memory.

python benchmarks/flood.py [--kinds initials handshakes] [--seconds 10] [--json] [-o results/flood.json]

Each kind has its own server process and its own flooding process, at addresses of 127.0.0.0/8. Honest clients come one
after another from 127.0.0.1. A flood from `--same-address` comes from there, too.
"""

import argparse
import asyncio
import contextlib
import itertools
import json
import os
import random
import selectors
import socket
import ssl
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.h3.connection import H3Connection
from aioquic.quic.connection import QuicConnection
from figures import publish as publish_figures
from server_load import process_usage

from splatwire.transport import ReceiverOptions
from splatwire.transport.address import Address
from splatwire.transport.protocol.messages import Hello
from splatwire.transport.protocol.wire import encode
from splatwire.transport.quic.client import Trust, receive_quic
from splatwire.transport.quic.common import ALPN, ALPN_HTTP, WEBTRANSPORT_PATH, configuration, length_prefixed
from splatwire.transport.udp import receive_udp

HERE, NUM_NETWORKS = "127.0.0.1", 200
BURST = 32
"""Number of datagrams between two looks at the clock."""


def initials(rng: random.Random) -> bytes:
    """A forged Initial packet with a valid header and random content."""
    head = b"\xc0\0\0\0\1\x08" + rng.randbytes(8) + b"\x08" + rng.randbytes(8)
    return head + b"\0" + (0x4000 | 1174).to_bytes(2, "big") + bytes(1174)


def late(rng: random.Random) -> bytes:
    """A packet of a connection that the server does not know, such as of one before its restart."""
    return b"\x40" + rng.randbytes(1199)


def hellos(rng: random.Random) -> bytes:
    """A request for an address token over plain UDP."""
    return encode(Hello(rng.getrandbits(64), ""))


DATAGRAMS: dict[str, Callable[[random.Random], bytes]] = {
    "initials": initials, "initials, networks": initials, "late packets": late, "hellos": hellos,
    "hellos, networks": hellos,
}  # fmt: skip


def flood_datagrams(kind: str, target: tuple[str, int], sources: list[str], end: float, rate: float) -> int:
    """Sends datagrams as fast as possible, or at a given number per second, and returns their number."""
    rng, sockets = random.Random(1), []
    for source in sources if "networks" in kind else sources[:1]:
        sockets.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sockets[-1].bind((source, 0))
        sockets[-1].connect(target)
    datagrams = itertools.cycle([DATAGRAMS[kind](rng) for _ in range(4000)])
    began, num = time.monotonic(), 0
    for connection in itertools.cycle(sockets):
        for _, data in zip(range(BURST), datagrams, strict=False):
            with contextlib.suppress(OSError):
                connection.send(data)
        num += BURST
        if (now := time.monotonic()) >= end:
            return num
        if rate and (ahead := num / rate - (now - began)) > 0.001:
            time.sleep(ahead)
    return num


class Hostile(QuicConnectionProtocol):
    """A QUIC client that completes its handshake."""

    def __init__(self, quic: QuicConnection) -> None:
        super().__init__(quic)
        self.quic = quic

    @property
    def is_closed(self) -> bool:
        return self._closed.is_set()

    def shut(self) -> None:
        """Ends the client without a word to the server."""
        if self._timer is not None:
            self._timer.cancel()
        if self._transport is not None:
            self._transport.close()


async def hostile(target: tuple[str, int], source: str, alpn: str) -> Hostile:
    """Connects a hostile client."""
    settings = configuration(is_client=True, alpn=[alpn], idle_s=10.0)
    settings.verify_mode, settings.server_name = ssl.CERT_NONE, "localhost"
    client = Hostile(QuicConnection(configuration=settings))
    await asyncio.get_running_loop().create_datagram_endpoint(lambda: client, local_addr=(source, 0))
    client.connect(target)
    try:
        await asyncio.wait_for(client.wait_connected(), 2.0)
    except BaseException:
        client.shut()
        raise
    return client


async def flood_handshakes(target: tuple[str, int], source: str, end: float) -> int:
    """Completes handshakes, and disappears after each of them."""
    num = 0
    while time.monotonic() < end:
        with contextlib.suppress(TimeoutError, OSError):
            (await hostile(target, source, ALPN)).shut()
            num += 1
    return num


async def flood_streams(target: tuple[str, int], source: str, end: float) -> int:
    """Opens WebTransport sessions with streams, and sends small pieces and datagrams on them without end."""
    num = 0
    while time.monotonic() < end:
        try:
            client = await hostile(target, source, ALPN_HTTP)
        except (TimeoutError, OSError):
            continue
        http, quic = H3Connection(client.quic, enable_webtransport=True), client.quic
        session = quic.get_next_available_stream_id()
        fields = {"method": "CONNECT", "scheme": "https", "authority": "localhost", "path": WEBTRANSPORT_PATH,
                  "protocol": "webtransport"}  # fmt: skip
        http.send_headers(session, [(f":{key}".encode(), value.encode()) for key, value in fields.items()])
        stream = http.create_webtransport_stream(session)
        while time.monotonic() < end and not client.is_closed:
            for _ in range(20):
                http.send_datagram(session, b"\x41noise")
            with contextlib.suppress(AssertionError, RuntimeError, ValueError):
                quic.send_stream_data(stream, length_prefixed(b"\x41"))
            client.transmit()
            num += 21
            await asyncio.sleep(0)
        client.shut()
    return num


def flood_http(target: tuple[str, int], source: str, end: float, *, slow: bool) -> int:
    """Opens HTTP connections: with requests that never end (`slow`), or with one whole request each."""
    poll, num = selectors.DefaultSelector(), 0
    while time.monotonic() < end:
        while len(poll.get_map()) < (600 if slow else 60):
            connection = socket.socket()
            connection.setblocking(False)
            connection.bind((source, 0))
            connection.connect_ex(target)
            poll.register(connection, selectors.EVENT_WRITE)
        for key, events in poll.select(0.05):
            connection = key.fileobj
            assert isinstance(connection, socket.socket)
            done = False
            try:
                if events & selectors.EVENT_WRITE:
                    connection.send(b"G" if slow else b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
                    num += 1
                    poll.modify(connection, selectors.EVENT_READ)
                else:
                    done = not connection.recv(1 << 16)
            except OSError:
                done = True
            if done:
                poll.unregister(connection)
                connection.close()
    return num


KINDS = ("none", "busy core", *DATAGRAMS, "handshakes", "streams", "slow requests", "requests")


def flood(kind: str, target: tuple[str, int], source: str, seconds: float, rate: float) -> int:
    """Floods a server, and returns the number of datagrams, messages or requests."""
    end = time.monotonic() + seconds
    sources = [source] if source == HERE else [f"127.1.{n}.1" for n in range(NUM_NETWORKS)]
    if kind in DATAGRAMS:
        return flood_datagrams(kind, target, sources, end, rate)
    if kind in ("handshakes", "streams"):
        work = flood_handshakes if kind == "handshakes" else flood_streams
        return asyncio.run(work(target, sources[0], end))
    if kind in ("none", "busy core"):  # a process that only computes shows the effect of its processor time
        while kind == "busy core" and time.monotonic() < end:
            pass
        return 0
    return flood_http(target, sources[0], end, slow=kind == "slow requests")


async def read_page(port: int) -> None:
    """Reads the page over HTTP; raises an error unless it is whole."""
    reader, writer = await asyncio.open_connection(HERE, port)
    try:
        writer.write(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        data = await reader.read(-1)
        head, _, body = data.partition(b"\r\n\r\n")
        length = next(int(line[15:]) for line in head.split(b"\r\n") if line.lower().startswith(b"content-length:"))
        if not head.startswith(b"HTTP/1.1 200") or len(body) != length:
            raise OSError("the page is incomplete")
    finally:
        writer.close()


async def honest(kind: str, ready: dict[str, Any], timeout_s: float) -> bool:
    """Runs one honest client, and returns True if it got everything."""
    try:
        async with asyncio.timeout(timeout_s):
            if "requests" in kind:
                await read_page(ready["page_port"])
                return True
            if "hellos" in kind:
                receiver = await receive_udp(Address(HERE, ready["port"]), ReceiverOptions())
            else:
                trust = Trust(fingerprint=ready["fingerprint"])
                receiver = await receive_quic(Address(HERE, ready["port"], scheme="quic"), ReceiverOptions(), trust)
            return receiver.finished is not None and receiver.finished.reason == "complete"
    except (OSError, TimeoutError):
        return False


async def measure(kind: str, args: argparse.Namespace) -> dict[str, Any]:
    """Measures honest clients beside one kind of flood."""
    words = [sys.executable, "-m", "splatwire", "serve", "--port", "0", "--json", "--log-level", "warning",
             "--clients-per-address", "2000", *([] if "hellos" in kind else ["--quic"])]  # fmt: skip
    words += ["--page", "0"] if "requests" in kind else []
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, start_new_session=True) as server:
        assert server.stdout is not None
        ready = json.loads(server.stdout.readline())
        if "requests" in kind:
            ready["page_port"] = int(ready["page"].rstrip("/").rpartition(":")[2])
        await honest(kind, ready, 60.0)  # the first client compiles
        used, memory = process_usage(server.pid)
        port = ready["page_port"] if "requests" in kind else ready["port"]
        source = HERE if args.same_address else "127.1.0.1"
        hostile_words = [sys.executable, __file__, "--flooder", kind, source, str(port), str(args.seconds + 1),
                         str(args.rate)]  # fmt: skip
        flooder = subprocess.Popen(hostile_words, stdout=subprocess.PIPE, text=True)
        assert flooder.stdout is not None
        await asyncio.to_thread(flooder.stdout.readline)
        began, times, failed, resident = time.monotonic(), [], 0, []
        while (passed := time.monotonic() - began) < args.seconds:
            if passed >= len(resident) * max(1.0, args.seconds / 30):
                resident.append(round(process_usage(server.pid)[1] / 1e6, 1))
            at = time.monotonic()
            if await honest(kind, ready, 40.0):
                times.append(time.monotonic() - at)
            else:
                failed += 1
            await asyncio.sleep(0.1)
        passed = time.monotonic() - began
        resident.append(round(process_usage(server.pid)[1] / 1e6, 1))
        share = (process_usage(server.pid)[0] - used) / passed
        num = int((await asyncio.to_thread(flooder.communicate))[0].split()[-1])
        server.terminate()
        await asyncio.to_thread(server.communicate)
    return {
        "hostile_per_second": round(num / (args.seconds + 1)), "clients": len(times), "failed": failed,
        "median_s": round(statistics.median(times), 2) if times else None,
        "longest_s": round(max(times), 2) if times else None, "processor_share": round(share, 2),
        "memory_before_mb": round(memory / 1e6, 1), "memory_mb": resident,
    }  # fmt: skip


def main() -> None:
    """Measures, and prints the figures."""
    if sys.argv[1:2] == ["--flooder"]:
        kind, source, port, seconds, rate = sys.argv[2:]
        print("begins", flush=True)
        print(flood(kind, (HERE, int(port)), source, float(seconds), float(rate)))
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of each flood")
    parser.add_argument("--rate", type=float, default=0.0, help="datagrams a second; 0 for as many as possible")
    parser.add_argument("--same-address", action="store_true", help="flood from the address of the honest clients")
    parser.add_argument("--json", action="store_true", help="print JSON only")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    result: dict[str, Any] = {
        "cores": os.cpu_count(), "load_average": round(os.getloadavg()[0], 1), "seconds": args.seconds,
        "same_address": args.same_address,
    }  # fmt: skip
    for kind in args.kinds:
        result[kind] = asyncio.run(measure(kind, args))
        if not args.json:
            print(kind, result[kind], file=sys.stderr, flush=True)
    publish_figures(result, args.output)


if __name__ == "__main__":
    main()
