"""Latency of live clips: from a group's last encoded frame to its first and last decoded frame.

    python benchmarks/live_loopback.py CAPTURE [--tracks 30000] [--group 8] [--fps 30] [--groups 12] [--threads 2]

Wall time over loopback. Sender and receiver are separate processes on this machine. Frames are encoded from memory at
their rate and decoded to memory. The first two groups, which load kernels and send keyframe Gaussians, are excluded.
The capture is bent as `bent_clip.py` does.
"""

import argparse
import asyncio
import gc
import json
import os
import queue
import statistics
import sys
import threading
import time
from fractions import Fraction
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from bent_clip import bent_frames, capture

from splatwire.ops.threads import use_single_thread
from splatwire.sequence import SequenceOptions
from splatwire.sequence.live_decoder import LiveDecoder, frames_of_events
from splatwire.sequence.live_encoder import LiveEncoder
from splatwire.transport import ReceiverOptions, ServerLimits
from splatwire.transport.address import parse_url
from splatwire.transport.udp import UdpServer, receive_udp
from splatwire.types.splats import Splats

LEFT_OUT = 2


def shown(port: int, out: Connection) -> None:
    """Receives a live clip; returns the time at which each frame is decoded."""
    waiting, found = queue.SimpleQueue(), dict[int, float]()

    def work() -> None:
        for frame in frames_of_events(LiveDecoder(), waiting):
            found[frame.number] = time.monotonic()
            if frame.number == 0:
                out.send("first")

    thread = threading.Thread(target=work)
    thread.start()
    address = parse_url(f"udp://127.0.0.1:{port}/live")
    asyncio.run(receive_udp(address, ReceiverOptions(name="live"), waiting.put))
    waiting.put(None)
    thread.join()
    out.send(found)


def pushed(frames: list[Splats], args: argparse.Namespace, renew, ready: Connection) -> list[float]:
    """Pushes frames at their rate as `splatwire live` does; returns the time of each push."""
    options = SequenceOptions(rate=Fraction(args.fps), group_frames=args.group, threads=args.threads)
    clip, times = LiveEncoder(options, lambda: int.from_bytes(os.urandom(4), "little")), list[float]()
    due = time.monotonic()
    for number in range(args.group * args.groups):
        frame = frames[number % len(frames) if number // len(frames) % 2 == 0 else -1 - number % len(frames)]
        times.append(time.monotonic())
        edition = clip.push(frame)
        if edition is not None:
            renew(edition)
        if number == args.group - 1:  # later groups are timed: the first one includes the loading of kernels
            gc.freeze()
            ready.recv()
            due = time.monotonic()
        due += 1 / args.fps
        time.sleep(max(due - time.monotonic(), 0.0))
    for edition in clip.end():
        renew(edition)
    return times


async def served(frames: list[Splats], args: argparse.Namespace) -> dict:
    """Serves encoded frames until the receiver has all."""
    loop, context = asyncio.get_running_loop(), get_context("spawn")
    server = UdpServer({}, "127.0.0.1", 0, limits=ServerLimits())
    here, there = context.Pipe()
    client = context.Process(target=shown, args=(server.port, there))
    client.start()
    try:
        renew = lambda edition: loop.call_soon_threadsafe(server.set_stream, "live", edition)  # noqa: E731
        times = await asyncio.to_thread(pushed, frames, args, renew, here)
        found = await asyncio.to_thread(here.recv)
    finally:
        client.terminate()
        client.join()
        server.close()
    rows = [
        [found[first] - times[first + args.group - 1], found[first + args.group - 1] - times[first + args.group - 1]]
        for first in range(LEFT_OUT * args.group, len(times), args.group)
    ]
    result = {
        name: {"median": statistics.median(column), "worst": max(column)}
        for name, column in zip(("first_frame_s", "last_frame_s"), zip(*rows, strict=True), strict=True)
    }
    return {"tracks": args.tracks, "group": args.group, "fps": args.fps, "groups": len(rows), **result}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--tracks", type=int, default=30_000)
    parser.add_argument("--group", type=int, default=8)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--groups", type=int, default=12)
    parser.add_argument("--threads", type=int, default=2, help="of the sender's")
    args = parser.parse_args()
    frames = list(bent_frames(capture(args.capture, 3, args.tracks), 6 * args.group))
    use_single_thread()
    result = asyncio.run(served(frames, args))
    print(json.dumps({**result, "load": os.getloadavg()[0]}, indent=1))
    sys.stdout.flush()


if __name__ == "__main__":
    main()
