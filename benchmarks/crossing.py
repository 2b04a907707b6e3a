"""The bundled scene through real sockets and a relay that loses a fifth of all datagrams; prints one JSON object.

    python benchmarks/crossing.py

PSNR is that of pictures of what arrived against pictures of the whole scene.
"""

import asyncio
import json
import random
import sys
import time
from pathlib import Path

import splatwire
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal, create_concealer
from splatwire.data import load_cameras
from splatwire.metrics import psnr
from splatwire.packets import PRESETS, read_stream
from splatwire.render import render_scene
from splatwire.transport import ReceiverOptions, make_program
from splatwire.transport.udp import Address, UdpServer, receive_udp

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "transport"))
from network import bernoulli, bursts
from relay import Relay

ASSETS = Path(splatwire.__file__).parent / "assets"


async def cross(program, lost, options, moments):
    server = UdpServer({"scene": program}, "127.0.0.1", 0)
    relay = Relay(server.port, lost, delay_s=0.01)
    began = time.perf_counter()

    def note(event) -> None:
        moments.setdefault(type(event).__name__, round(time.perf_counter() - began, 3))

    try:
        return await receive_udp(Address("127.0.0.1", relay.port), options, note), server.bytes_sent
    finally:
        relay.close()
        server.close()


def main() -> None:
    bundled = decode_stream(read_stream(ASSETS / "snowmiku.swz")[0]).scene
    stream = encode_scene(bundled, PRESETS["datagram"])
    whole = decode_stream(stream).scene
    cameras = load_cameras(ASSETS / "snowmiku_cameras.json")
    cameras = cameras.select(list(range(0, cameras.num_views, max(1, cameras.num_views // 4)))[:4])
    reference = render_scene(whole, cameras)
    program, rows = make_program(stream), []
    for name, loss in (("random", lambda rng: bernoulli(0.2, rng)), ("bursts of 20", lambda rng: bursts(0.2, 20, rng))):
        for options in (ReceiverOptions(nack=False), ReceiverOptions(deadline_s=2.0)):
            moments: dict[str, float] = {}
            receiver, sent = asyncio.run(cross(program, loss(random.Random(3)), options, moments))
            partial, scores = decode_stream(receiver.stream()), {}
            for concealer in ("drop", "grow"):
                pictures = render_scene(conceal(partial, create_concealer(concealer)), cameras)
                scores[concealer] = round(float(psnr(pictures, reference).clamp(max=99).mean()), 2)
            rows.append(
                {
                    "loss": f"20 % {name}",
                    "asks_again": options.nack,
                    "finished": receiver.finished.reason,
                    "packets": f"{len(receiver.stream().packets)} of {len(stream.packets)}",
                    "bytes_sent": sent,
                    "seconds": moments,
                    "psnr": scores,
                }
            )
    print(json.dumps({"stream_bytes": stream.num_bytes, "crossings": rows}, indent=1))


if __name__ == "__main__":
    main()
