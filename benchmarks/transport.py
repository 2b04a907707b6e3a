"""Figures of the transport against its goals.

    python benchmarks/transport.py [--stream SCENE.swz] [--quick]

Prints one JSON object: fixed cost of datagram packets, what it takes for side information to arrive, blocks lost whole,
throughput of both ends in one process and in two (UDP and QUIC), 50 receivers at once from one server process.
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

import numpy as np

import splatwire
from splatwire.byte_io import ByteWriter
from splatwire.channel import Bernoulli, parse_loss
from splatwire.packets import (
    PRESETS,
    PacketId,
    Packetization,
    PacketPlan,
    SceneStream,
    make_packet,
    make_stream,
    read_stream,
    write_stream,
)
from splatwire.packets.limits import FORMAT_1_SECTIONS
from splatwire.transport import Protection, Receiver, ReceiverOptions, Server, ServerLimits, make_program
from splatwire.transport.address import Address
from splatwire.transport.fec import recover
from splatwire.transport.layout import Segments
from splatwire.transport.program import Program
from splatwire.transport.udp import UdpServer, receive_udp
from splatwire.transport.wire import DATA, SIDE, SIDE_OVERHEAD

BUNDLED = Path(splatwire.__file__).parent / "assets" / "snowmiku.swz"
LOSSES = {"random 20 %": Bernoulli(0.2), "bursts of 20, 20 %": parse_loss("gilbert:0.2,20")}
UDP_IP_BYTES = 28
FINE_SYMBOL_BYTES = 128
SPARE = 1
"""Symbols beyond K that a simulated decoder needs; the real one rarely needs any."""


def fixed_cost(stream: SceneStream) -> tuple[SceneStream, dict]:
    from splatwire.codec import decode_stream, encode_scene

    scene = decode_stream(stream).scene
    datagrams = encode_scene(scene, PRESETS["datagram"])
    long = encode_scene(scene, Packetization(lanes=1, grouping="contiguous")).parts()["packet_payloads"]
    ours = datagrams.parts()["packet_headers"] + datagrams.parts()["packet_payloads"]
    sizes = [packet.num_bytes for packet in datagrams.packets]
    return datagrams, {
        "attribute_bytes_one_stream_per_block": long,
        "attribute_bytes_datagram": ours,
        "fixed_cost_percent": round(100 * (ours / long - 1), 3),
        "packets": len(sizes),
        "largest": max(sizes),
        "mean": round(float(np.mean(sizes)), 1),
        "anchors_per_packet": round(datagrams.manifest.num_elements / len(sizes), 1),
    }


def stand_in(num_anchors: int, side_bytes: int, per_packet: int) -> SceneStream:
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


def arrivals(program: Program, loss, trials: int, seed: int) -> tuple[int, int]:
    """Transfers in which the head object arrived, and blocks of which nothing did, over all of them."""
    segments = Segments(program.head_bytes, program.symbol_bytes)
    need = np.array([segments.size(s) for s in range(segments.num_segments)])
    side = np.array([kind == SIDE for kind, _, _ in program.schedule])
    group = np.array([g for _, g, _ in program.schedule])
    block = np.array([block_of(program.packets[s]) if kind == DATA else -1 for kind, _, s in program.schedule])
    good = wiped = 0
    for trial in range(trials):
        there = loss.received(len(side), np.random.Generator(np.random.PCG64(seed + trial)))
        have = np.bincount(group[side & there], minlength=len(need))
        good += bool((have >= np.minimum(need + SPARE, np.bincount(group[side], minlength=len(need)))).all())
        wiped += int(len(np.unique(block[~side])) - len(np.unique(block[~side & there])))
    return good, wiped


def block_of(packet: bytes) -> int:
    return int.from_bytes(packet[7:10], "little")


def side_protection(stream: SceneStream, trials: int, symbol_bytes: int | None = None) -> dict:
    """The least redundancy with which 999 of 1000 transfers get the side information, and what that costs.

    With and without the 28 bytes of UDP and IP (version 4) of every datagram.
    """
    out: dict[str, dict[str, object] | None] = {}
    for name, loss in LOSSES.items():
        low, high = 0.2, 1.2
        found = None
        for _ in range(8):
            middle = (low + high) / 2
            program = make_program(
                stream, Protection(side_repair=middle, side_lead=1.0, side_symbol_bytes=symbol_bytes)
            )
            good, wiped = arrivals(program, loss, trials, 1000)
            if good >= 0.999 * trials:
                high, found = middle, (middle, program, good, wiped)
            else:
                low = middle
        if found is None:
            out[name] = None
            continue
        repair, program, good, wiped = found
        sizes = program.sizes()
        total, datagrams = sum(sizes.values()), len(program.schedule)
        repairs = sizes["side_protection"] // (program.symbol_bytes + SIDE_OVERHEAD)
        with_headers = total + UDP_IP_BYTES * datagrams
        out[name] = {
            "symbol_bytes": program.symbol_bytes,
            "side_repair": round(repair, 3),
            "arrived": f"{good} of {trials}",
            "percent_of_all_bytes": round(100 * sizes["side_protection"] / total, 2),
            "percent_with_udp_and_ip": round(
                100 * (sizes["side_protection"] + UDP_IP_BYTES * repairs) / with_headers, 2
            ),
            "bytes_of_a_pass_with_udp_and_ip": with_headers,
            "datagrams": datagrams,
            "percent_side_information": round(100 * sizes["side"] / total, 2),
            "blocks_lost_whole": wiped,
            "real_raptorq_needed_more_than_k": validate(program, loss, 20),
        }
    return out


def validate(program: Program, loss, trials: int) -> str:
    """Real decoding of what arrived, where at least K symbols did."""
    segments, failed, tried = Segments(program.head_bytes, program.symbol_bytes), 0, 0
    for trial in range(trials):
        there = loss.received(len(program.schedule), np.random.Generator(np.random.PCG64(trial)))
        arrived: list[dict] = [{} for _ in program.head]
        for ok, (kind, segment, symbol) in zip(there, program.schedule, strict=True):
            if ok and kind == SIDE:
                arrived[segment][symbol] = program.head[segment][symbol]
        for segment, symbols in enumerate(arrived):
            size = segments.size(segment)
            if len(symbols) >= size:
                tried += 1
                failed += recover(dict(list(symbols.items())[:size]), size, program.symbol_bytes) is None
    return f"{failed} of {tried}"


def core_throughput(program: Program) -> dict:
    """Processor time of the state machines alone, no sockets."""
    limits = ServerLimits(fixed_rate=1e12)
    server = Server({"s": program}, secret=bytes(16), random=random.Random(0).randbytes, limits=limits)
    receiver = Receiver(1, 0.0)
    pending = receiver.poll(0.0)[0]
    while pending:
        answers = [server.receive("c", data, 0.0) for data in pending]
        pending = [reply for answer in answers if answer for reply in receiver.receive(answer, 0.0)[0]]
    began = time.process_time()
    sent = [data for _ in range(1 + len(program.schedule) // 64) for _, data in server.poll(1.0)]
    sending = time.process_time() - began
    began = time.process_time()
    for data in sent:
        receiver.receive(data, 1.0)
    receiving, num_bytes = time.process_time() - began, sum(map(len, sent))
    return {
        "sender_mbit_s": round(num_bytes * 8e-6 / sending),
        "receiver_mbit_s": round(num_bytes * 8e-6 / receiving),
    }


async def loopback(program: Program, clients: int, rate: float | None) -> dict:
    server = UdpServer(
        {"s": program}, "127.0.0.1", 0, limits=ServerLimits(per_network=clients, fixed_rate=rate, start_rate=2e7)
    )
    began = time.perf_counter()
    try:
        address, options = Address("127.0.0.1", server.port), ReceiverOptions(nack=False)
        receivers = await asyncio.gather(*(receive_udp(address, options) for _ in range(clients)))
    finally:
        server.close()
    seconds = time.perf_counter() - began
    lost = [len(program.packets) - r.collector.num_packets for r in receivers if r.collector]
    return {
        "clients": clients,
        "finished_ok": sum(bool(r.finished and r.finished.ok) for r in receivers),
        "packets_lost": sum(lost),
        "seconds": round(seconds, 2),
        "mbit_s_both_ends_in_one_process": round(sum(r.num_bytes for r in receivers) * 8e-6 / seconds),
    }


@contextlib.contextmanager
def serving(stream: SceneStream, *words: str):
    """A server process; gives its address, what it says of itself, and a function that tells its processor time."""
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
    """One server process, one receiver process, the whole stream at whatever rate the rate control finds."""
    with serving(stream, *words) as (facts, spent):
        before = spent()
        asked = ["--receive", str(facts["port"]), facts.get("fingerprint", "")]
        done = subprocess.run([sys.executable, __file__, *asked], capture_output=True, text=True, check=True)
        told, sending = json.loads(done.stdout), spent() - before
    megabits = told["bytes"] * 8e-6
    return {
        "megabits": round(megabits),
        "finished": told["finished"],
        "mbit_s_wall": round(megabits / told["seconds"]),
        "sender_mbit_per_processor_second": round(megabits / sending),
        "receiver_mbit_per_processor_second": round(megabits / told["processor_seconds"]),
    }


async def receive_once(port: int, fingerprint: str) -> dict:
    """The receiver process of `two_processes`."""
    address, began, spent = Address("127.0.0.1", port), time.perf_counter(), time.process_time()
    if fingerprint:
        from splatwire.transport.quic_client import Trust, receive_quic

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
    """One server process, some receivers at once in another, nothing asked for again."""

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
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    if arguments.receive:
        print(json.dumps(asyncio.run(receive_once(int(arguments.receive[0]), arguments.receive[1]))))
        return
    trials = 200 if arguments.quick else arguments.trials
    stream, cost = fixed_cost(read_stream(arguments.stream)[0])
    large = stand_in(370_000, 1_000_000, 52)  # 8 MB, 11 % of it side information: a scene of the paper
    huge = stand_in(1_500_000, 2_000_000, 52)
    big = make_program(large)
    one = replace(ServerLimits(), fixed_rate=None)
    result = {
        "fixed_cost": cost,
        "side_information": side_protection(stream, trials),
        "side_information_in_fine_symbols": side_protection(stream, trials, FINE_SYMBOL_BYTES),
        "side_information_of_a_scene_of_8_MB": side_protection(large, trials),
        "core": core_throughput(big),
        "loopback_1": asyncio.run(loopback(big, 1, one.fixed_rate)),
        "two_processes_udp": two_processes(huge, "--side-repair", "0.05"),
        "two_processes_quic": two_processes(large, "--side-repair", "0.05", "--quic"),
        "receivers_50": many_receivers(stream, 50, 2.0),
        "load_average": os.getloadavg(),
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
