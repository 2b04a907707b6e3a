"""Load of one server with many receivers of a scene with levels: processor time, packets and memory.

python benchmarks/server_load.py city.swz [--seconds 20]
"""

import argparse
import contextlib
import heapq
import json
import os
import random
import selectors
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from figures import publish as publish_figures

from splatwire.bitstream import SceneStream, read_stream
from splatwire.bitstream.tile_selection import Viewpoint
from splatwire.bitstream.tiles import Tiles, read_tiles
from splatwire.transport import Receiver, ReceiverOptions


def random_viewpoint(tiles: Tiles, seed: int) -> Viewpoint:
    """Viewpoint that looks into the scene from a random place around it."""
    rng = np.random.default_rng(seed)
    low, high = np.percentile(tiles.low, 10, axis=0), np.percentile(tiles.high, 90, axis=0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.sign(np.linalg.det(turn))
    matrix[:3, 3] = matrix[:3, :3] @ -((low + high) / 2) + [0, 0, float(np.ptp([low, high])) * rng.uniform(0.2, 1)]
    return Viewpoint(matrix, 900.0, 1280, 720)


class SimulatedReceivers:
    """Receivers in one thread; some change their view ten times a second."""

    def __init__(self, port: int, tiles: Tiles, idle: int, active: int) -> None:
        self._poll = selectors.DefaultSelector()
        self._due: list[tuple[float, int]] = []
        self._all: list[tuple[Receiver, Any]] = []
        self._viewpoints = [random_viewpoint(tiles, seed) for seed in range(997)]
        self._active = active
        self.data = self.views = 0
        far = random_viewpoint(tiles, 0)
        away = Viewpoint(
            far.viewmat + np.array([[0.0] * 4] * 2 + [[0, 0, 0, 1e6]] + [[0.0] * 4]), far.focal, far.width, far.height
        )
        for n in range(active + idle):
            options = ReceiverOptions(viewpoint=self._viewpoints[n % 997] if n < active else away, keep_open=True)
            receiver = Receiver(random.getrandbits(64), time.perf_counter(), options)
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.setblocking(False)
            sock.connect(("127.0.0.1", port))
            self._poll.register(sock, selectors.EVENT_READ, n)
            self._all.append((receiver, sock))
            heapq.heappush(self._due, (time.perf_counter() + n / 400, n))

    def run(self, seconds: float) -> None:
        until, turn = time.perf_counter() + seconds, 0.0
        while (now := time.perf_counter()) < until:
            if now >= turn:
                turn = now + 0.1
                for n in range(self._active):
                    self._all[n][0].set_viewpoint(self._viewpoints[(n + int(now * 10)) % 997])
                    self.views += 1
            while self._due and self._due[0][0] <= now:
                _, n = heapq.heappop(self._due)
                receiver, sock = self._all[n]
                self._send(sock, receiver.poll(now)[0])
                at = receiver.next_at()
                if at is not None:
                    heapq.heappush(self._due, (max(at, now + 0.005), n))
            for key, _ in self._poll.select(0.005):
                receiver, sock = self._all[key.data]
                for _ in range(16):
                    try:
                        data = sock.recv(2048)
                    except OSError:
                        break
                    self.data += data[0] & 15 == 6
                    self._send(sock, receiver.receive(data, now)[0])

    def _send(self, sock: Any, datagrams: list[bytes]) -> None:
        for data in datagrams:
            with contextlib.suppress(OSError):
                sock.send(data)

    @property
    def end_reasons(self) -> dict[str, int]:
        reasons = [receiver.finished.reason if receiver.finished else "goes on" for receiver, _ in self._all]
        return {reason: reasons.count(reason) for reason in set(reasons)}


def process_usage(pid: int) -> tuple[float, int]:
    """Processor seconds and bytes of memory of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE")


def under_load(path: Path, stream: SceneStream, seconds: float, populations: list[tuple[int, int]]) -> dict[str, Any]:
    tiles, found = (
        read_tiles(stream.manifest, stream.side_info),
        dict[str, Any](tiles=int(stream.manifest.plan.num_blocks)),
    )
    for idle, active in populations:
        words = [sys.executable, "-m", "splatwire", "serve", str(path), "--port", "0", "--json", "--rate", "0.25",
                 "--clients", "2000", "--clients-per-address", "2000"]  # fmt: skip
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            port = json.loads(server.stdout.readline())["port"]
            _, empty = process_usage(server.pid)
            receivers = SimulatedReceivers(port, tiles, idle, active)
            receivers.run((idle + active) / 400 + 12)  # until all receivers have started and have the opening
            data, views, began = receivers.data, receivers.views, time.perf_counter()
            before, _ = process_usage(server.pid)
            receivers.run(seconds)
            (after, memory), passed = process_usage(server.pid), time.perf_counter() - began
            server.terminate()
            found[f"{idle} idle, {active} active"] = {
                "processor_share": round((after - before) / passed, 3),
                "packets_s": round((receivers.data - data) / passed),
                "views_s": round((receivers.views - views) / passed), "memory_mb": round(memory / 1e6),
                "memory_of_server_alone_mb": round(empty / 1e6), "ended": receivers.end_reasons,
            }  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    stream, _ = read_stream(args.stream)
    result = under_load(args.stream, stream, args.seconds, [(0, 200), (1000, 0), (1000, 200)])
    publish_figures(result, args.output)


if __name__ == "__main__":
    main()
