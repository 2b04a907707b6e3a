"""Throughput of kernel TCP that shares a full link with a transfer; needs root and Linux network namespaces.

    python benchmarks/kernel_tcp.py [--seconds 40] [--rate 10] > benchmarks/results/kernel_tcp.json

`iperf3` with CUBIC or BBR and a real server and receiver over UDP, in two namespaces. Two TUN devices connect them to a
link in this process with a rate limit, half a round trip of delay each way, and a drop-tail queue of 1 or 4
bandwidth-delay products. Shares are relative to an equal split, over the last two thirds. Prints one JSON object.
"""

import argparse
import asyncio
import contextlib
import heapq
import json
import os
import select
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from tunnels import ends

sys.path[0] = str(Path(__file__).resolve().parent.parent / "tests")  # `transport` is the tests', not the benchmark

PORT, HERE, THERE = 4840, "10.77.0.1", "10.77.0.2"
TCP, UDP = 6, 17
JOINS_S = 1.0


def inside(space: str, *words: str) -> subprocess.Popen[bytes]:
    """Starts a process in a namespace."""
    return subprocess.Popen(["ip", "netns", "exec", space, *words], stdout=subprocess.DEVNULL)


def carry(files: list[int], rate: float, round_trip: float, queue_bytes: float, seconds: float) -> list[Counter]:
    """Forwards packets for a time; returns delivered bytes by protocol for each second."""
    arrived: list[Counter] = [Counter() for _ in range(int(seconds) + 1)]
    under_way: list[tuple[float, int, int, bytes]] = []
    begin, free_at, number = time.monotonic(), 0.0, 0
    while (now := time.monotonic()) < begin + seconds:
        wait = min(under_way[0][0] - now, 0.05) if under_way else 0.05
        for file in select.select(files, [], [], max(wait, 0.0))[0]:
            with contextlib.suppress(BlockingIOError):
                while packet := os.read(file, 2048):
                    now, number = time.monotonic(), number + 1
                    if file == files[0]:
                        if (max(free_at - now, 0.0)) * rate + len(packet) > queue_bytes:
                            continue
                        now = free_at = max(free_at, now) + len(packet) / rate
                        arrived[min(int(now - begin), int(seconds))][packet[9]] += len(packet)
                    heapq.heappush(under_way, (now + round_trip / 2, number, file, packet))
        while under_way and under_way[0][0] <= time.monotonic():
            _, _, file, packet = heapq.heappop(under_way)
            with contextlib.suppress(OSError):  # no listener yet
                os.write(files[1] if file == files[0] else files[0], packet)
    return arrived


def share(kind: str, rate: float, round_trip: float, products: float, seconds: float) -> dict[str, object]:
    """Shares of a TCP flow and of a transfer that joins it after `JOINS_S`, relative to half the link each."""
    with ends({"splat-a": HERE, "splat-b": THERE}) as files, contextlib.ExitStack() as stack:
        transfer = [sys.executable, __file__, "--seconds", str(seconds), "--rate", str(rate * 8e-6), "--role"]
        for space, words in (
            ("splat-b", ["iperf3", "-s", "-1"]), ("splat-a", [*transfer, "serve"]),
            ("splat-b", [*transfer, "receive"]),
            ("splat-a", ["sh", "-c", f"sleep 8; exec iperf3 -c {THERE} -C {kind} -t {seconds + 20:.0f}"]),
        ):  # fmt: skip
            process = inside(space, *words)
            stack.callback(process.wait)
            stack.callback(process.kill)
        carry(files, rate, round_trip, products * rate * round_trip, 8 + JOINS_S)
        arrived = carry(files, rate, round_trip, products * rate * round_trip, seconds)
    late = sum(arrived[int(seconds / 3) : int(seconds)], Counter())
    equal = rate * (int(seconds) - int(seconds / 3)) / 2
    return {
        "flows": f"splatwire beside {kind}", "mbit_s": rate * 8e-6, "round_trip_ms": 1e3 * round_trip,
        "queue_products": products, "shares": [round(late[UDP] / equal, 2), round(late[TCP] / equal, 2)],
    }  # fmt: skip


async def serve(rate: float, seconds: float) -> None:
    """Serves a stream that takes longer to send than the link is observed."""
    from splatwire.transport.protocol.served_stream import make_served_stream
    from splatwire.transport.udp import UdpServer
    from transport.network import datagram_stream

    packets = int(rate * (seconds + 20) / 1100)
    server = UdpServer({"it": make_served_stream(datagram_stream(40 * packets))}, HERE, PORT)
    await asyncio.sleep(seconds + 60)
    server.close()


async def receive() -> None:
    """Sends requests until an answer arrives, then receives."""
    from splatwire.transport import ReceiverOptions
    from splatwire.transport.address import parse_url
    from splatwire.transport.udp import receive_udp

    while True:
        await receive_udp(parse_url(f"udp://{HERE}:{PORT}"), ReceiverOptions())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--rate", type=float, default=10.0, help="Mbit/s")
    parser.add_argument("--role", choices=["serve", "receive"], help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    rate = arguments.rate * 1e6 / 8
    if arguments.role:
        asyncio.run(serve(rate, arguments.seconds) if arguments.role == "serve" else receive())
        return
    # a stalled link would lose packets that a real one would not; started processes have a lower priority
    os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(10))
    rows = [
        share(kind, rate, round_trip, products, arguments.seconds)
        for kind in ("cubic", "bbr")
        for round_trip in (0.02, 0.1)
        for products in (1, 4)
    ]
    print(json.dumps({"kernel": os.uname().release, "seconds": arguments.seconds, "shares": rows}, indent=1))


if __name__ == "__main__":
    main()
