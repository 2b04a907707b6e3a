"""The bundled scene through real sockets and a relay that loses a fifth of all datagrams; prints one JSON object.

    python benchmarks/crossing.py [--loss 0.2] [--burst 20]

Over UDP and over QUIC, with random loss and bursts, 10 ms each way and up to half as much again (many datagrams
overtake each other), 2 % of them twice. PSNR is that of pictures of what arrived against pictures of the whole scene.
The first frame is drawn from what was there when side information arrived, concealed with `drop`.
"""

import argparse
import asyncio
import json
import os
import random
import sys
import time
from pathlib import Path

import numpy as np

import splatwire
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal, create_concealer
from splatwire.data import load_cameras
from splatwire.metrics import psnr
from splatwire.packets import PRESETS, read_stream
from splatwire.render import render_scene
from splatwire.transport import PacketArrived, Receiver, ReceiverOptions, make_program
from splatwire.transport.address import Address
from splatwire.transport.certificate import self_signed
from splatwire.transport.quic_client import Trust, receive_quic
from splatwire.transport.quic_server import QuicServer
from splatwire.transport.udp import UdpServer, receive_udp

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "transport"))
from network import bernoulli, bursts
from relay import Relay

ASSETS = Path(splatwire.__file__).parent / "assets"
IDENTITY = self_signed()
EARLY_S = 0.005


class Moments:
    """When what happened first, and what was there when side information came."""

    def __init__(self) -> None:
        self.began = time.perf_counter()
        self.seconds: dict[str, float] = {}
        self.packets: list = []

    def note(self, event) -> None:
        now = time.perf_counter() - self.began
        self.seconds.setdefault(type(event).__name__, round(now, 3))
        if isinstance(event, PacketArrived):
            self.packets.append((now, event.packet))

    def early(self) -> list:
        """Packets that were there when side information came; they are told at once after it."""
        return [packet for at, packet in self.packets if at <= self.seconds["SideInfoArrived"] + EARLY_S]


async def cross(program, lost, options, moments: Moments, scheme: str) -> tuple[Receiver, int]:
    if scheme == "udp":
        server = UdpServer({"scene": program}, "127.0.0.1", 0)
    else:
        server = await QuicServer({"scene": program}, "127.0.0.1", 0, identity=IDENTITY).start()
    relay = Relay(server.port, lost, delay_s=0.01, jitter=0.5, duplicate=0.02)
    address = Address("127.0.0.1", relay.port, scheme=scheme)
    try:
        if scheme == "udp":
            return await receive_udp(address, options, moments.note), server.bytes_sent
        pinned = Trust(fingerprint=IDENTITY.fingerprint)
        return await receive_quic(address, options, pinned, moments.note), server.bytes_sent
    finally:
        relay.close()
        server.close()


def first_frame(receiver: Receiver, moments: Moments, camera) -> dict:
    """Time from the first datagram to a picture of what was there when side information arrived."""
    early = receiver.stream().with_packets(tuple(sorted(moments.early(), key=lambda packet: packet.id)))
    wall, spent = time.perf_counter(), time.process_time()
    partial = decode_stream(early)
    decoded = time.perf_counter() - wall
    render_scene(conceal(partial, create_concealer("drop")), camera)
    drawn, spent = time.perf_counter() - wall, time.process_time() - spent
    return {
        "packets_then": len(early.packets),
        "until_side_information": moments.seconds["SideInfoArrived"],
        "decoding": round(decoded, 3),
        "decoding_and_drawing": round(drawn, 3),
        "of_it_processor_time": round(spent, 3),
        "in_all": round(moments.seconds["SideInfoArrived"] + drawn, 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--loss", type=float, default=0.2)
    parser.add_argument("--burst", type=float, default=20.0)
    arguments = parser.parse_args()
    bundled = decode_stream(read_stream(ASSETS / "snowmiku.swz")[0]).scene
    stream = encode_scene(bundled, PRESETS["datagram"])
    whole = decode_stream(stream).scene
    cameras = load_cameras(ASSETS / "snowmiku_cameras.json")
    cameras = cameras.select(list(range(0, cameras.num_views, max(1, cameras.num_views // 4)))[:4])
    reference = render_scene(whole, cameras)
    program, rows = make_program(stream), []
    losses = {
        "random": lambda rng: bernoulli(arguments.loss, rng),
        f"bursts of {arguments.burst:g}": lambda rng: bursts(arguments.loss, arguments.burst, rng),
    }
    for scheme, name, nack in [(s, n, a) for s in ("udp", "quic") for n in losses for a in (False, True)]:
        moments = Moments()
        options = ReceiverOptions(nack=nack)
        receiver, sent = asyncio.run(cross(program, losses[name](random.Random(3)), options, moments, scheme))
        partial, scores = decode_stream(receiver.stream()), {}
        complete = receiver.finished.reason == "complete"
        for concealer in () if complete else ("drop", "grow"):
            pictures = render_scene(conceal(partial, create_concealer(concealer)), cameras)
            scores[concealer] = round(float(np.minimum(psnr(pictures, reference), 99).mean()), 2)
        rows.append(
            {
                "scheme": scheme,
                "loss": f"{100 * arguments.loss:g} % {name}",
                "asks_again": nack,
                "finished": receiver.finished.reason,
                "packets": f"{len(receiver.stream().packets)} of {len(stream.packets)}",
                "bytes_sent": sent,
                "seconds": moments.seconds,
                "psnr": scores,
                "first_frame": first_frame(receiver, moments, cameras.select([0])),
            }
        )
        print(f"{scheme}, {name}, {'asks again' if nack else 'once'}: {receiver.finished.reason}", file=sys.stderr)
    size = f"{cameras.width} x {cameras.height}"
    print(json.dumps({"stream_bytes": stream.num_bytes, "picture": size, "load_average": os.getloadavg(),
                      "crossings": rows}, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
