"""One transfer over an emulated link, as root: two namespaces, two TUN devices, and the link in this process.

    python benchmarks/emulated_link.py '{"scheme": "http1", "file": "guitar.sog", ...}'

The kernel's TCP or aioquic or our own sender and receiver run in the namespaces, each end a process. The link has
seeded losses, half a round trip of delay and a rate limit in each direction. Its drop-tail queue has a capacity of one
bandwidth-delay product, at least 32 packets. The client writes its log to a file. For `why_not_http.py`.
"""

import contextlib
import heapq
import json
import os
import random
import select
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests" / "transport"))
from network import at_most, bernoulli, bursts  # noqa: E402
from tunnels import ends  # noqa: E402

SERVER = "10.78.0.1", "10.78.0.2"
MIN_QUEUE = 32 * 1500
BURST, BURST_S = 20.0, 0.3
"""Packets of a burst on average, and seconds after which it ends: a sender that waits does not make it longer."""


class Link:
    """Both directions of a link between two TUN devices."""

    def __init__(self, files: list[int], job: dict) -> None:
        self._files, self._delay = files, job["round_trip"] / 2
        self._rate = job["mbit"] * 1e6 / 8
        self._queue = max(self._rate * job["round_trip"], MIN_QUEUE)
        self._free = [0.0, 0.0]
        rngs = [random.Random(f"{job['seed']} {side}") for side in range(2)]
        rate = job["loss"]
        self._lost = [
            at_most(bursts(rate, BURST, rng), BURST_S) if job["bursts"] and rate else bernoulli(rate, rng)
            for rng in rngs
        ]
        self._under_way: list[tuple[float, int, int, bytes]] = []
        self.counts = {"offered": 0, "lost": 0, "queue_full": 0, "bytes_to_client": 0}

    def step(self) -> None:
        """Accepts sent packets and delivers due ones."""
        wait = self._under_way[0][0] - time.monotonic() if self._under_way else 0.02
        for file in select.select(self._files, [], [], min(max(wait, 0.0), 0.02))[0]:
            with contextlib.suppress(BlockingIOError):
                for _ in range(64):
                    self._take(self._files.index(file), os.read(file, 2048))
        while self._under_way and self._under_way[0][0] <= time.monotonic():
            _, _, side, packet = heapq.heappop(self._under_way)
            with contextlib.suppress(OSError):  # no listener yet
                os.write(self._files[1 - side], packet)

    def _take(self, side: int, packet: bytes) -> None:
        now = time.monotonic()
        if max(self._free[side] - now, 0.0) * self._rate + len(packet) > self._queue:
            self.counts["queue_full"] += 1
            return
        self._free[side] = max(self._free[side], now) + len(packet) / self._rate
        self.counts["offered"] += 1
        if side == 0:
            self.counts["bytes_to_client"] += len(packet)
        if self._lost[side]():
            self.counts["lost"] += 1
            return
        heapq.heappush(self._under_way, (self._free[side] + self._delay, self.counts["offered"], side, packet))


def inside(space: str, job: dict, role: str) -> subprocess.Popen[str]:
    """Starts an end in a namespace."""
    command = ["ip", "netns", "exec", space, sys.executable, str(HERE / "link_endpoints.py"), role, json.dumps(job)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def transfer(job: dict) -> dict:
    """Runs both ends over the link until the client is done."""
    spaces = {f"click{os.getpid()}{letter}": address for letter, address in zip("ab", SERVER, strict=True)}
    with ends(spaces) as files, contextlib.ExitStack() as stack:
        processes = []
        for space, role in zip(spaces, ("serve", "receive"), strict=True):
            processes.append(inside(space, job, role))
            stack.callback(processes[-1].wait)
            stack.callback(processes[-1].kill)
        for process in processes:  # both are loaded and the server listens
            assert process.stdout is not None
            if process.stdout.readline() != "ready\n":
                raise RuntimeError(f"{job}: an end did not start")
        client, link = processes[1], Link(files, job)
        assert client.stdin is not None
        assert client.stdout is not None
        client.stdin.write("click\n")
        client.stdin.flush()
        while client.poll() is None:
            link.step()
        return {"link": link.counts, "status": client.returncode}


def main() -> None:
    # a stalled link would lose packets that a real one would not; started processes have a lower priority
    os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(10))
    print(json.dumps(transfer(json.loads(sys.argv[1]))))


if __name__ == "__main__":
    main()
