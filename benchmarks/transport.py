"""Figures of the transport against its goals.

    python benchmarks/transport.py [--stream SCENE.swz] [--quick]

Prints one JSON object: fixed cost of datagram packets, what it takes for side information to arrive, blocks lost whole,
throughput of both ends, 50 receivers at once.
"""

import argparse
import asyncio
import json
import random
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import splatwire
from splatwire.channel import Bernoulli, parse_loss
from splatwire.packets import (
    PRESETS,
    Packet,
    PacketId,
    Packetization,
    PacketPlan,
    SceneStream,
    make_stream,
    read_stream,
)
from splatwire.transport import Protection, Receiver, ReceiverOptions, Server, ServerLimits, make_program
from splatwire.transport.fec import recover
from splatwire.transport.layout import Segments
from splatwire.transport.program import Program
from splatwire.transport.udp import Address, UdpServer, receive_udp
from splatwire.transport.wire import DATA, SIDE

BUNDLED = Path(splatwire.__file__).parent / "assets" / "snowmiku.swz"
LOSSES = {"random 20 %": Bernoulli(0.2), "bursts of 20, 20 %": parse_loss("gilbert:0.2,20")}
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
        "anchors_per_packet": round(datagrams.manifest.num_anchors / len(sizes), 1),
    }


def stand_in(num_anchors: int, side_bytes: int, per_packet: int) -> SceneStream:
    """A stream of zeros with the sizes of a larger scene."""
    plan, packets = PacketPlan(PRESETS["datagram"], num_anchors), []
    for block in range(plan.num_blocks):
        for first in range(0, plan.block_anchors(block), per_packet):
            count = min(per_packet, plan.block_anchors(block) - first)
            packets.append(Packet(PacketId(block, first), count, bytes(1124)))
    return make_stream(
        packetization=PRESETS["datagram"], num_anchors=num_anchors, feature_dim=50, num_offsets=10,
        feature_groups=(10,) * 5, side_info=bytes(side_bytes), packets=packets, symbols_digest="5" * 64, writer="sizes",
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


def side_protection(stream: SceneStream, trials: int) -> dict:
    """The least redundancy with which 999 of 1000 transfers get the side information, and what that costs."""
    out = {}
    for name, loss in LOSSES.items():
        low, high = 0.2, 2.0
        found = None
        for _ in range(7):
            middle = (low + high) / 2
            program = make_program(stream, Protection(side_repair=middle, side_lead=1.0))
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
        out[name] = {
            "side_repair": round(repair, 3),
            "arrived": f"{good} of {trials}",
            "percent_of_all_bytes": round(100 * sizes["side_protection"] / sum(sizes.values()), 2),
            "percent_side_information": round(100 * sizes["side"] / sum(sizes.values()), 2),
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
    server = UdpServer({"s": program}, "127.0.0.1", 0, limits=ServerLimits(fixed_rate=rate, start_rate=2e7))
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


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--stream", type=Path, default=BUNDLED)
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--quick", action="store_true")
    arguments = parser.parse_args()
    trials = 200 if arguments.quick else arguments.trials
    stream, cost = fixed_cost(read_stream(arguments.stream)[0])
    large = stand_in(370_000, 1_000_000, 52)  # 8 MB, 11 % of it side information: a scene of the paper
    program = make_program(stream)
    big = make_program(large)
    one = replace(ServerLimits(), fixed_rate=None)
    result = {
        "fixed_cost": cost,
        "side_information": side_protection(stream, trials),
        "side_information_of_a_scene_of_8_MB": side_protection(large, trials),
        "core": core_throughput(big),
        "loopback_1": asyncio.run(loopback(big, 1, one.fixed_rate)),
        "loopback_50": asyncio.run(loopback(program, 50, 2.5e5)),
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
