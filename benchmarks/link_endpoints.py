"""The two ends of a transfer of `emulated_link.py`: a server, and a client that logs arrivals over time.

HTTP/1.1 is plain TCP without TLS, which spares it a round trip. HTTP/3 is aioquic with CUBIC and a certificate that is
not checked. Datagrams use `splatwire serve` and `splatwire receive` over UDP with retransmission.
"""

import asyncio
import contextlib
import json
import os
import socket
import ssl
import sys
import time
from pathlib import Path
from typing import Any

HOST, PORT = "10.78.0.1", 4850
PIECE = 1 << 16


class Log:
    """Bytes available over time since the click, in seconds; written to the job's log."""

    def __init__(self, path: str) -> None:
        self._path, self.began, self.rows = Path(path), time.perf_counter(), list[tuple[float, object]]()

    def add(self, event: object) -> None:
        self.rows.append((round(time.perf_counter() - self.began, 4), event))

    def write(self, complete: bool) -> None:
        self._path.write_text(json.dumps({"complete": complete, "rows": self.rows}))


async def serve_http1(content: bytes, congestion: str) -> None:
    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(content) + content)
        await writer.drain()

    listening = socket.create_server((HOST, PORT))
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, congestion.encode())
    await asyncio.start_server(answer, sock=listening)


async def receive_http1(log: Log) -> bool:
    reader, writer = await asyncio.open_connection(HOST, PORT)
    writer.write(b"GET /scene HTTP/1.1\r\nHost: scene\r\n\r\n")
    head = await reader.readuntil(b"\r\n\r\n")
    size, got = int(head.partition(b"Content-Length: ")[2].split()[0]), 0
    while got < size:
        piece = await reader.read(PIECE)
        if not piece:
            return False
        got += len(piece)
        log.add(got)
    return True


def http3_classes() -> tuple[Any, Any]:
    """Server's and client's protocol of aioquic; here because its import takes time."""
    from aioquic.asyncio import QuicConnectionProtocol
    from aioquic.h3.connection import H3Connection
    from aioquic.h3.events import DataReceived, HeadersReceived
    from aioquic.quic.events import QuicEvent

    class Protocol(QuicConnectionProtocol):
        content = b""

        def __init__(self, *arguments: object, **more: object) -> None:
            super().__init__(*arguments, **more)
            self._http: H3Connection | None = None
            self.got, self.done = 0, asyncio.Event()
            self.log: Any = None

        @property
        def http(self) -> H3Connection:
            self._http = self._http or H3Connection(self._quic)
            return self._http

        def quic_event_received(self, event: QuicEvent) -> None:
            for found in self.http.handle_event(event):
                self.http_event(found)

        def http_event(self, event: object) -> None:
            raise NotImplementedError

    class Server(Protocol):
        def http_event(self, event: object) -> None:
            if isinstance(event, HeadersReceived):
                self.http.send_headers(event.stream_id, [(b":status", b"200")])
                self.http.send_data(event.stream_id, type(self).content, end_stream=True)
                self.transmit()

    class Client(Protocol):
        def http_event(self, event: object) -> None:
            if isinstance(event, DataReceived):
                self.got += len(event.data)
                self.log.add(self.got)
                if event.stream_ended:
                    self.done.set()

    return Server, Client


def http3_configuration(client: bool):  # type: ignore[no-untyped-def]
    from aioquic.h3.connection import H3_ALPN
    from aioquic.quic.configuration import QuicConfiguration

    return QuicConfiguration(
        is_client=client, alpn_protocols=H3_ALPN, congestion_control_algorithm="cubic", idle_timeout=60.0,
        max_data=1 << 26, max_stream_data=1 << 26, verify_mode=ssl.CERT_NONE if client else None,
    )  # fmt: skip


async def serve_http3(content: bytes) -> None:
    from aioquic.asyncio import serve

    from splatwire.transport.quic.certificate import self_signed

    kind, identity = http3_classes()[0], self_signed()
    kind.content, configuration = content, http3_configuration(client=False)
    configuration.certificate, configuration.private_key = identity.certificate, identity.key
    await serve(HOST, PORT, configuration=configuration, create_protocol=kind)


async def receive_http3(log: Log) -> bool:
    from aioquic.asyncio import connect

    kind = http3_classes()[1]
    async with connect(HOST, PORT, configuration=http3_configuration(client=True), create_protocol=kind) as connection:
        connection.log = log
        stream = connection._quic.get_next_available_stream_id()
        names = {":method": "GET", ":scheme": "https", ":authority": "scene", ":path": "/scene"}
        headers = [(name.encode(), value.encode()) for name, value in names.items()]
        connection.http.send_headers(stream, headers, end_stream=True)
        connection.transmit()
        await connection.done.wait()
    return True


async def serve_datagrams(path: Path, parity: float) -> object:
    from splatwire.bitstream import read_stream
    from splatwire.transport import Protection, make_served_stream
    from splatwire.transport.udp import UdpServer

    protection = Protection(tier_repair=(parity,) if parity else ())
    return UdpServer({"scene": make_served_stream(read_stream(path)[0], protection)}, HOST, PORT)


async def receive_datagrams(log: Log) -> bool:
    from splatwire.transport import PacketArrived, ReceiverOptions, SideInfoArrived
    from splatwire.transport.address import parse_url
    from splatwire.transport.udp import receive_udp

    def log_event(event: object) -> None:
        if isinstance(event, SideInfoArrived):
            log.add("head")
        elif isinstance(event, PacketArrived):
            log.add(repr(event.packet.id))

    receiver = await receive_udp(parse_url(f"udp://{HOST}:{PORT}"), ReceiverOptions(silence_s=20), log_event)
    return receiver.finished is not None and receiver.finished.reason == "complete"


def raise_priority() -> None:
    """Raises the priority of the process, so that the network determines the measured time."""
    os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(5))


async def serve(job: dict) -> None:
    path = Path(job["file"])
    if job["scheme"] == "datagrams":
        kept = await serve_datagrams(path, job["parity"])
    elif job["scheme"] == "http1":
        kept = await serve_http1(path.read_bytes(), job["congestion"])
    else:
        kept = await serve_http3(path.read_bytes())
    raise_priority()
    print("ready", flush=True)
    await asyncio.Event().wait()
    del kept


async def receive(job: dict) -> None:
    how = {"http1": receive_http1, "http3": receive_http3, "datagrams": receive_datagrams}[job["scheme"]]
    if job["scheme"] == "http3":
        http3_classes()
    if job["scheme"] == "datagrams":
        import splatwire.transport.udp  # noqa: F401
    raise_priority()
    print("ready", flush=True)
    sys.stdin.readline()
    log, complete = Log(job["log"]), False
    with contextlib.suppress(TimeoutError, OSError, ConnectionError):
        complete = await asyncio.wait_for(how(log), job["limit"])
    log.write(complete)


if __name__ == "__main__":
    asyncio.run({"serve": serve, "receive": receive}[sys.argv[1]](json.loads(sys.argv[2])))
