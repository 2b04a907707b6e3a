"""Many receivers of a scene with levels: behind a cache of nginx, behind a relay, and at one server.

    python benchmarks/audience.py cache|relay|load city.swz [--receivers 100] [--seconds 20]

`cache` needs nginx, `relay` moq-rs. Bytes at the origin: of one receiver and of all, each time with
nothing cached.
"""

import argparse
import asyncio
import contextlib
import heapq
import json
import os
import random
import selectors
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import numpy as np
from figures import publish as publish_figures

from splatwire.packets import SceneStream, read_stream, stream_to_bytes
from splatwire.packets.tiles import Tiles, read_tiles
from splatwire.packets.view import Look, cut_of
from splatwire.transport import Receiver, ReceiverOptions
from splatwire.transport.address import Address
from splatwire.transport.page import PageServer
from splatwire.transport.page_content import PageContent

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "transport"))
from moq_relay import moq_relay

OPENING, PIECE, SLICE = 1 << 18, 1 << 16, 1 << 18
AT_ONCE = 10
NGINX = """daemon off; user root; worker_processes 1; pid {folder}/pid; error_log {folder}/errors;
events {{ worker_connections 512; }}
http {{
  access_log off;
  proxy_temp_path {folder}/temp; client_body_temp_path {folder}/body; fastcgi_temp_path {folder}/f;
  uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;
  proxy_cache_path {folder}/cache keys_zone=scenes:4m max_size=4g inactive=1d use_temp_path=off;
  server {{
    listen 127.0.0.1:{port};
    location /streams/ {{
      slice {slice};
      proxy_pass http://127.0.0.1:{origin};
      proxy_http_version 1.1;
      proxy_set_header Host $http_host;
      proxy_set_header Range $slice_range;
      proxy_cache scenes;
      proxy_cache_key $uri$is_args$args$slice_range;
      proxy_cache_lock on;
      proxy_cache_revalidate on;
    }}
  }}
}}
"""


def looking(tiles: Tiles, seed: int) -> Look:
    """Into the scene from somewhere around it."""
    rng = np.random.default_rng(seed)
    low, high = np.percentile(tiles.low, 10, axis=0), np.percentile(tiles.high, 90, axis=0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.sign(np.linalg.det(turn))
    matrix[:3, 3] = matrix[:3, :3] @ -((low + high) / 2) + [0, 0, float(np.ptp([low, high])) * rng.uniform(0.2, 1)]
    return Look(matrix, 900.0, 1280, 720)


class CountedPage(PageServer):
    """Counts what leaves."""

    sent = 0

    async def _write(self, data: bytes, writer: asyncio.StreamWriter) -> None:
        CountedPage.sent += len(data)
        await super()._write(data, writer)


def fetch(url: str, begin: int, tiles: Tiles, seed: int) -> int:
    """What a page asks for that in the end has seen everything, in the order of one view; bytes that came."""
    offsets = begin + np.concatenate([[0], np.cumsum(tiles.sizes)])
    there = offsets[1:] <= OPENING
    wanted = cut_of(tiles, there, looking(tiles, seed)).wanted
    rest = [tile for tile in np.flatnonzero(~there).tolist() if tile not in set(wanted)]
    came = len(part(url, 0, OPENING))
    waiting, done = [*wanted, *rest], set[int]()
    for tile in waiting:
        end = tile
        while (
            end < tiles.num_tiles and not there[end] and end not in done and offsets[end + 1] - offsets[tile] <= PIECE
        ):
            end += 1
        end = max(end, tile + 1)
        if tile not in done:
            came += len(part(url, int(offsets[tile]), int(offsets[end])))
            done.update(range(tile, end))
    return came


def part(url: str, first: int, end: int) -> bytes:
    with urlopen(Request(url, headers={"Range": f"bytes={first}-{end - 1}"}), timeout=60) as answer:
        assert answer.status == 206, answer.status
        return answer.read()


@contextlib.contextmanager
def cache(origin: int, folder: Path) -> Iterator[int]:
    """nginx in front of an origin; its port."""
    port = random.Random(os.getpid()).randrange(20_000, 30_000)
    (folder / "nginx.conf").write_text(NGINX.format(folder=folder, port=port, origin=origin, slice=SLICE))
    process = subprocess.Popen(
        ["nginx", "-p", str(folder), "-c", str(folder / "nginx.conf"), "-e", str(folder / "errors")]
    )
    try:
        time.sleep(1)
        yield port
    finally:
        process.terminate()
        process.wait(10)


async def behind_cache(stream: SceneStream, receivers: int) -> dict[str, Any]:
    data, tiles = stream_to_bytes(stream), read_tiles(stream.manifest, stream.side_info)
    begin = len(data) - int(tiles.sizes.sum())
    content = PageContent({"city": data})
    address = content._address("city")
    found: dict[str, Any] = {"file_bytes": len(data)}
    async with CountedPage(content) as server:
        for name, count in (("one", 1), ("all", receivers)):
            with tempfile.TemporaryDirectory() as folder, cache(server.port, Path(folder)) as port:
                url, before, began = f"http://127.0.0.1:{port}{address}", CountedPage.sent, time.perf_counter()
                limit = asyncio.Semaphore(AT_ONCE)

                async def one(seed: int, url: str = url, limit: asyncio.Semaphore = limit) -> int:
                    async with limit:
                        return await asyncio.to_thread(fetch, url, begin, tiles, seed)

                came = await asyncio.gather(*map(one, range(count)))
                found[name] = {"origin_bytes": CountedPage.sent - before, "received_bytes": sum(came),
                               "seconds": round(time.perf_counter() - began, 1)}  # fmt: skip
    found["ratio"] = round(found["all"]["origin_bytes"] / found["one"]["origin_bytes"], 4)
    return found


async def behind_relay(stream: SceneStream, receivers: int) -> dict[str, Any]:
    """Receivers come some at a time, and stay until the last one has everything, as pages do."""
    from splatwire.transport.moq import RelayTrust, publish, session
    from splatwire.transport.moq_receiver import RelayReceiver

    trust, found = RelayTrust(insecure=True), dict[str, Any](file_bytes=stream.num_bytes)
    for name, count in (("one", 1), ("all", receivers)):
        async with moq_relay() as there:
            stop, ready, began = asyncio.Event(), asyncio.Event(), time.perf_counter()
            address = replace(there, name="city")
            task = asyncio.ensure_future(publish(address, stream, trust, stop, ready.set))
            await ready.wait()
            limit, come, everybody = asyncio.Semaphore(AT_ONCE), list[RelayReceiver](), asyncio.Event()

            async def one(
                address: Address = address, limit: asyncio.Semaphore = limit, come: list[RelayReceiver] = come,
                everybody: asyncio.Event = everybody, count: int = count,
            ) -> None:  # fmt: skip
                receiver = RelayReceiver(ReceiverOptions(silence_s=60.0), None)
                await limit.acquire()
                async with session(address, trust) as (client, scene):
                    broadcast = await client.announced_broadcast(scene).available()
                    assert await receiver.receive(broadcast) == "complete"
                    limit.release()
                    come.append(receiver)
                    if len(come) == count:
                        everybody.set()
                    await everybody.wait()

            await asyncio.gather(*(one() for _ in range(count)))
            await asyncio.sleep(1)  # until what was sent is counted
            stop.set()
            sent = await task
            found[name] = {"origin_bytes": sent.num_bytes, "received_bytes": sum(r.num_bytes for r in come),
                           "tracks": sent.tracks, "seconds": round(time.perf_counter() - began, 1)}  # fmt: skip
    found["ratio"] = round(found["all"]["origin_bytes"] / found["one"]["origin_bytes"], 4)
    return found


class Crowd:
    """Receivers in one thread, some of which look elsewhere ten times a second."""

    def __init__(self, port: int, tiles: Tiles, idle: int, active: int) -> None:
        self._poll = selectors.DefaultSelector()
        self._due: list[tuple[float, int]] = []
        self._all: list[tuple[Receiver, Any]] = []
        self._looks = [looking(tiles, seed) for seed in range(997)]
        self._active = active
        self.data = self.views = 0
        far = looking(tiles, 0)
        away = Look(
            far.viewmat + np.array([[0.0] * 4] * 2 + [[0, 0, 0, 1e6]] + [[0.0] * 4]), far.focal, far.width, far.height
        )
        import socket

        for n in range(active + idle):
            options = ReceiverOptions(look=self._looks[n % 997] if n < active else away, stays=True)
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
                    self._all[n][0].look(self._looks[(n + int(now * 10)) % 997])
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
    def ended(self) -> dict[str, int]:
        reasons = [receiver.finished.reason if receiver.finished else "goes on" for receiver, _ in self._all]
        return {reason: reasons.count(reason) for reason in set(reasons)}


def spent(pid: int) -> tuple[float, int]:
    """Processor seconds and bytes of memory of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE")


def under_load(path: Path, stream: SceneStream, seconds: float, crowds: list[tuple[int, int]]) -> dict[str, Any]:
    tiles, found = (
        read_tiles(stream.manifest, stream.side_info),
        dict[str, Any](tiles=int(stream.manifest.plan.num_blocks)),
    )
    for idle, active in crowds:
        words = [sys.executable, "-m", "splatwire", "serve", str(path), "--port", "0", "--json", "--rate", "0.25",
                 "--clients", "2000", "--clients-per-address", "2000"]  # fmt: skip
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            port = json.loads(server.stdout.readline())["port"]
            _, empty = spent(server.pid)
            crowd = Crowd(port, tiles, idle, active)
            crowd.run((idle + active) / 400 + 12)  # until all have begun, and the opening came
            (before, _), data, views, began = spent(server.pid), crowd.data, crowd.views, time.perf_counter()
            crowd.run(seconds)
            (after, memory), passed = spent(server.pid), time.perf_counter() - began
            server.terminate()
            found[f"{idle} idle, {active} active"] = {
                "processor_share": round((after - before) / passed, 3),
                "packets_s": round((crowd.data - data) / passed),
                "views_s": round((crowd.views - views) / passed), "memory_mb": round(memory / 1e6),
                "memory_of_server_alone_mb": round(empty / 1e6), "ended": crowd.ended,
            }  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["cache", "relay", "load"])
    parser.add_argument("stream", type=Path)
    parser.add_argument("--receivers", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    stream, _ = read_stream(args.stream)
    if args.what == "load":
        crowds = [(0, 200), (1000, 0), (1000, 200)]
        result = under_load(args.stream, stream, args.seconds, crowds)
    else:
        result = asyncio.run((behind_cache if args.what == "cache" else behind_relay)(stream, args.receivers))
    publish_figures(result, args.output)


if __name__ == "__main__":
    main()
