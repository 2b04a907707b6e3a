"""Figures of the transport against its goals.

    python benchmarks/transport.py [--stream SCENE.swz]

Prints one JSON object: throughput of both ends in one process and in two (UDP and QUIC), and 50 simultaneous receivers
of one server process.
"""

import argparse
import asyncio
import contextlib
import json
import os
import random
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import splatwire
from splatwire.bitstream import (
    PRESETS,
    PacketId,
    PacketPlan,
    SceneStream,
    make_packet,
    make_stream,
    read_stream,
    write_stream,
)
from splatwire.bitstream.limits import FORMAT_1_SECTIONS
from splatwire.codec import decode_stream, encode_scene
from splatwire.files.byte_io import ByteWriter
from splatwire.transport import Receiver, ReceiverOptions, Server, ServerLimits, make_served_stream
from splatwire.transport.address import Address
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.udp import UdpServer, receive_udp

BUNDLED = Path(splatwire.__file__).parent / "assets" / "snowmiku.swz"


def synthetic_stream(num_anchors: int, side_bytes: int, per_packet: int) -> SceneStream:
    """A stream of zeros with the sizes of a larger scene."""
    plan, packets = PacketPlan(PRESETS["datagram"], num_anchors), []
    for block in range(plan.num_blocks):
        for first in range(0, plan.block_elements(block), per_packet):
            count = min(per_packet, plan.block_elements(block) - first)
            packets.append(make_packet(PacketId(block, first), count, bytes(1124)))
    sections = ByteWriter()
    for size in (side_bytes, *(0,) * (len(FORMAT_1_SECTIONS) - 1)):
        sections.blob(bytes(size))
    return make_stream(
        packetization=PRESETS["datagram"], num_elements=num_anchors, feature_dim=50, num_offsets=10,
        feature_groups=(10,) * 5, side_info=sections.bytes(), packets=packets, symbols_digest="5" * 64, writer="sizes",
    )  # fmt: skip


def core_throughput(stream: ServedStream) -> dict:
    """Processor time of the protocol's state machines alone, without sockets."""
    limits = ServerLimits(fixed_rate=1e12)
    server = Server({"s": stream}, secret=bytes(16), random=random.Random(0).randbytes, limits=limits)
    receiver = Receiver(1, 0.0)
    pending = receiver.poll(0.0)[0]
    while pending:
        answers = [server.receive("c", data, 0.0) for data in pending]
        pending = [reply for answer in answers if answer for reply in receiver.receive(answer, 0.0)[0]]
    began = time.process_time()
    sent = [data for _ in range(1 + len(stream.schedule) // 64) for _, data in server.poll(1.0)]
    sending = time.process_time() - began
    began = time.process_time()
    for data in sent:
        receiver.receive(data, 1.0)
    receiving, num_bytes = time.process_time() - began, sum(map(len, sent))
    return {
        "sender_mbit_s": round(num_bytes * 8e-6 / sending),
        "receiver_mbit_s": round(num_bytes * 8e-6 / receiving),
    }


async def loopback(stream: ServedStream, clients: int, rate: float | None) -> dict:
    server = UdpServer(
        {"s": stream}, "127.0.0.1", 0, limits=ServerLimits(per_network=clients, fixed_rate=rate, start_rate=2e7)
    )
    began = time.perf_counter()
    try:
        address, options = Address("127.0.0.1", server.port), ReceiverOptions(nack=False)
        receivers = await asyncio.gather(*(receive_udp(address, options) for _ in range(clients)))
    finally:
        server.close()
    seconds = time.perf_counter() - began
    lost = [len(stream.packets) - r.collector.num_packets for r in receivers if r.collector]
    return {
        "clients": clients,
        "finished_ok": sum(bool(r.finished and r.finished.ok) for r in receivers),
        "packets_lost": sum(lost),
        "seconds": round(seconds, 2),
        "mbit_s_both_ends_in_one_process": round(sum(r.num_bytes for r in receivers) * 8e-6 / seconds),
    }


@contextlib.contextmanager
def serving(stream: SceneStream, *words: str):
    """A server process; yields its address, its printed description, and a function for its processor time."""
    with tempfile.TemporaryDirectory() as folder:
        write_stream(stream, Path(folder) / "scene.swz")
        command = [sys.executable, "-m", "splatwire", "serve", str(Path(folder) / "scene.swz"), "--port", "0", "--json"]
        server = subprocess.Popen([*command, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            facts = json.loads(server.stdout.readline())
            stat = Path(f"/proc/{server.pid}/stat")
            ticks = os.sysconf("SC_CLK_TCK")
            spent = lambda: sum(map(int, stat.read_text().rsplit(")", 1)[1].split()[11:13])) / ticks  # noqa: E731
            yield facts, spent
        finally:
            server.terminate()
            server.wait(20)
            server.stdout.close()


def two_processes(stream: SceneStream, *words: str) -> dict:
    """One server and one receiver process transfer the whole stream at the rate of the rate control."""
    with serving(stream, *words) as (facts, spent):
        before = spent()
        asked = ["--receive", str(facts["port"]), facts.get("fingerprint", "")]
        done = subprocess.run([sys.executable, __file__, *asked], capture_output=True, text=True, check=True)
        report, sending = json.loads(done.stdout), spent() - before
    megabits = report["bytes"] * 8e-6
    return {
        "megabits": round(megabits),
        "finished": report["finished"],
        "mbit_s_wall": round(megabits / report["seconds"]),
        "sender_mbit_per_processor_second": round(megabits / sending),
        "receiver_mbit_per_processor_second": round(megabits / report["processor_seconds"]),
    }


async def receive_once(port: int, fingerprint: str) -> dict:
    """The receiver process of `two_processes`."""
    address, began, spent = Address("127.0.0.1", port), time.perf_counter(), time.process_time()
    if fingerprint:
        from splatwire.transport.quic.client import Trust, receive_quic

        receiver = await receive_quic(address, ReceiverOptions(), Trust(fingerprint=fingerprint))
    else:
        receiver = await receive_udp(address, ReceiverOptions())
    return {
        "bytes": receiver.num_bytes,
        "finished": receiver.finished.reason,
        "seconds": time.perf_counter() - began,
        "processor_seconds": time.process_time() - spent,
    }


def many_receivers(stream: SceneStream, clients: int, megabits: float) -> dict:
    """One server process and several simultaneous receivers in another, without retransmission."""

    async def work(port: int) -> list[Receiver]:
        address, options = Address("127.0.0.1", port), ReceiverOptions(nack=False, silence_s=20.0)
        return await asyncio.gather(*(receive_udp(address, options) for _ in range(clients)))

    limits = ("--rate", str(megabits), "--idle", "20", "--clients-per-address", str(clients))
    with serving(stream, *limits) as (facts, spent):
        before, began = spent(), time.perf_counter()
        receivers = asyncio.run(work(facts["port"]))
        seconds, sending = time.perf_counter() - began, spent() - before
    return {
        "clients": clients,
        "megabits_per_second_each": megabits,
        "finished_ok": sum(bool(r.finished and r.finished.ok) for r in receivers),
        "packets_lost": sum(stream.manifest.num_packets - r.collector.num_packets for r in receivers if r.collector),
        "seconds": round(seconds, 2),
        "server_processor_seconds": round(sending, 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--receive", nargs=2, metavar=("PORT", "FINGERPRINT"), help=argparse.SUPPRESS)
    parser.add_argument("--stream", type=Path, default=BUNDLED)
    arguments = parser.parse_args()
    if arguments.receive:
        print(json.dumps(asyncio.run(receive_once(int(arguments.receive[0]), arguments.receive[1]))))
        return
    stream = encode_scene(decode_stream(read_stream(arguments.stream)[0]).scene, PRESETS["datagram"])
    large = synthetic_stream(370_000, 1_000_000, 52)  # 8 MB, 11 % of it side information: a scene of the paper
    huge = synthetic_stream(1_500_000, 2_000_000, 52)
    big = make_served_stream(large)
    one = replace(ServerLimits(), fixed_rate=None)
    result = {
        "core": core_throughput(big),
        "loopback_1": asyncio.run(loopback(big, 1, one.fixed_rate)),
        "two_processes_udp": two_processes(huge, "--init-repair", "0.05"),
        "two_processes_quic": two_processes(large, "--init-repair", "0.05", "--quic"),
        "receivers_50": many_receivers(stream, 50, 2.0),
        "load_average": os.getloadavg(),
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
