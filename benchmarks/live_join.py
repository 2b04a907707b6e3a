"""Time until the picture of a late receiver of a live clip is within 3 dB of the complete one. Time is a number.

    python benchmarks/live_join.py CAPTURE [--tracks 50000] [--delay 0.02] [--megabits 20] [--rate 19.2]
        [--quality small]

A bottleneck with a queue of 50 ms each way; the sender finds the rate by itself unless it is given. Every 20 ms the
received packets are decoded, concealed, rendered and compared with the frame of the complete clip.
"""

import argparse
import heapq
import itertools
import json
import random
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from bent_clip import bent_frames, capture

from splatwire.bitstream import Packet, SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.gaussians.quality import Quality, quality_of
from splatwire.metrics import psnr
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.sequence import SequenceEncoder, SequenceOptions
from splatwire.sequence.decoding import decode_frame
from splatwire.transport import PacketArrived, Receiver, ServerLimits, SideInfoArrived
from splatwire.transport.protocol.live_packager import LivePackager, LiveSnapshot
from splatwire.transport.protocol.sender import Server
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

STREAM_ID, GROUP, QUEUE_S, STEP_S = 7, 15, 0.05, 0.001


class Link:
    """One direction of a path: datagrams wait in the queue of a bottleneck, then travel."""

    def __init__(self, bytes_per_second: float, delay: float) -> None:
        self._rate, self._delay, self._free = bytes_per_second, delay, 0.0
        self._flying: list[tuple[float, int, bytes]] = []
        self._count = itertools.count()

    def put(self, data: bytes, now: float) -> None:
        """Sends a datagram; drops it if the queue is full."""
        begin = max(self._free, now)
        if begin - now > QUEUE_S:
            return
        self._free = begin + (len(data) + 28) / self._rate
        heapq.heappush(self._flying, (self._free + self._delay, next(self._count), data))

    def take(self, now: float) -> Iterator[bytes]:
        """Returns the packets that have arrived."""
        while self._flying and self._flying[0][0] <= now:
            yield heapq.heappop(self._flying)[2]


def live_state(frames: list[Splats], quality: Quality) -> tuple[LiveSnapshot, SceneStream]:
    """Stream that is served after some frames, prepared for sending and as it is."""
    encoder = SequenceEncoder(SequenceOptions(group_frames=GROUP, quality=quality))
    packager = LivePackager(importance=encoder.importance)
    for splats in frames:
        packets = encoder.push(splats)
        if packets:
            state = packager.add(*encoder.current_header(STREAM_ID), packets)
    return state, encoder.finish()


def arrivals(
    state: LiveSnapshot, rate: float, delay: float, until: float, fixed_rate: float | None
) -> tuple[float, list[tuple[float, Packet]]]:
    """Time at which a receiver knows the stream after its request, and arrival time of each packet."""
    rng = random.Random(1)
    server = Server({}, secret=bytes(16), random=rng.randbytes, limits=ServerLimits(fixed_rate=fixed_rate))
    server.set_stream("live", state)
    receiver, down, up = Receiver(5, 0.0), Link(rate, delay), Link(rate, delay)
    found, now, info = list[tuple[float, Packet]](), 0.0, until
    while now < until:
        now += STEP_S
        for data in up.take(now):
            answer = server.receive("client", data, now)
            if answer is not None:
                down.put(answer, now)
        for _, data in server.poll(now):
            down.put(data, now)
        events, out = list[object](), list[bytes]()
        for data in down.take(now):
            sent, new_events = receiver.receive(data, now)
            out += sent
            events += new_events
        sent, new_events = receiver.poll(now)
        for data in [*out, *sent]:
            up.put(data, now)
        for event in [*events, *new_events]:
            if isinstance(event, SideInfoArrived):
                info = now
            elif isinstance(event, PacketArrived):
                found.append((now, event.packet))
    return info, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--tracks", type=int, default=50_000)
    parser.add_argument("--delay", type=float, default=0.02, help="seconds, each way")
    parser.add_argument("--rate", type=float, help="fixed rate in Mbit/s; by default the server estimates it")
    parser.add_argument("--megabits", type=float, default=20.0)
    parser.add_argument("--quality", default="default", help="as of `splatwire encode`")
    args = parser.parse_args()
    frames = list(bent_frames(capture(args.capture, 3, args.tracks), 2 * GROUP))
    state, stream = live_state(frames, quality_of(args.quality))
    info, found = arrivals(state, args.megabits * 1e6 / 8, args.delay, 1.5, args.rate and args.rate * 1e6 / 8)
    truth, shown = frames[GROUP], GROUP
    cameras = surrounding_cameras(SplatScene(truth), 2, 320)
    views = np.stack(list(iterate_views(SplatScene(truth), cameras)))

    def quality(packets: Sequence[Packet]) -> float:
        clip = decode_stream(stream.with_packets(packets)).scene
        pictures = np.stack(list(iterate_views(decode_frame(clip, shown).scene, cameras)))
        return float(psnr(pictures, views).mean())

    complete, rows = quality(stream.packets), []
    for at in np.arange(0.1, 1.5, 0.02):
        ids = {packet.id for time, packet in found if time <= at}
        some = [packet for packet in stream.packets if packet.id in ids]
        if at < info or not some:
            continue
        rows.append({"seconds": round(float(at), 3), "packets": len(some), "psnr": quality(some)})
        if rows[-1]["psnr"] > complete - 0.05:
            break
    result = {
        "tracks": args.tracks, "quality": args.quality, "megabits": args.megabits, "delay_s": args.delay,
        "given_megabits": args.rate, "bytes": stream.num_bytes, "complete_psnr": complete,
        "within_3_db_s": next((row["seconds"] for row in rows if row["psnr"] > complete - 3), None), "rows": rows,
    }  # fmt: skip
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
