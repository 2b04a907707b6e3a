"""Through a relay of Media over QUIC: the server of moq-rs with an origin."""

import asyncio
import contextlib
import os
import random
from collections.abc import AsyncIterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.codec import encode_scene
from splatwire.errors import BitstreamError
from splatwire.levels import Look, encode_levels
from splatwire.model import SplatScene
from splatwire.packets import Packetization, SceneStream
from splatwire.packets.container import file_record
from splatwire.transport import ReceiverLimits, ReceiverOptions
from splatwire.transport.address import Address

pytest.importorskip("moq", reason="the package moq-rs is not installed")
from splatwire.transport.layout import head_object
from splatwire.transport.moq import HEAD, RelayTrust, parts_of, publish, tiles_of
from splatwire.transport.moq_receiver import RelayReceiver, receive_relayed
from transport.moq_relay import moq_relay

CASES = int(os.environ.get("SPLATWIRE_FUZZ_CASES", "600"))
TRUST = RelayTrust(insecure=True)
LEVELS = encode_levels(SplatScene(some_splats(3000)), Packetization(block_size=60, lanes=2))


@contextlib.asynccontextmanager
async def published(stream: SceneStream, address: Address) -> AsyncIterator[None]:
    stop, ready = asyncio.Event(), asyncio.Event()
    task = asyncio.ensure_future(publish(address, stream, TRUST, stop, ready.set))
    try:
        await asyncio.wait((task, asyncio.ensure_future(ready.wait())), return_when=asyncio.FIRST_COMPLETED)
        yield
    finally:
        stop.set()
        await task


def run(work: Any) -> None:
    asyncio.run(asyncio.wait_for(work(), 120))


def far() -> Look:
    matrix = np.eye(4)
    matrix[2, 3] = 60.0
    return Look(matrix, 200.0, 320, 240)


def test_streams_come_through_a_relay_as_they_were():
    async def work() -> None:
        async with moq_relay() as there:
            for name, stream in (("levels", LEVELS), ("some/plain", encode_scene(SplatScene(some_splats(900))))):
                async with published(stream, replace(there, name=name)):
                    many = (receive_relayed(replace(there, name=name), ReceiverOptions(), TRUST) for _ in range(3))
                    for receiver in await asyncio.gather(*many):
                        assert receiver.finished.reason == "complete"
                        assert receiver.stream() == stream

    run(work)


def test_what_is_looked_at_is_all_that_is_asked_for():
    async def work() -> None:
        async with moq_relay() as there, published(LEVELS, replace(there, name="levels")):
            receiver = await receive_relayed(replace(there, name="levels"), ReceiverOptions(look=far()), TRUST)
            assert receiver.finished.reason == "seen"
            assert 0 < len(receiver.stream().packets) < len(LEVELS.packets) / 2

    run(work)


def test_nobody_publishes_what_nobody_published():
    async def work() -> None:
        async with moq_relay() as there:
            receiver = await receive_relayed(replace(there, name="nothing"), ReceiverOptions(deadline_s=1.0), TRUST)
            assert receiver.finished.reason == "deadline"
            assert receiver.stream() is None

    run(work)


@dataclass
class Liar:
    """A relay that sends anything at all: stands for broadcast, track, group and frame."""

    tracks: dict[str, list[bytes]]
    frames: list[bytes] = field(default_factory=list)
    payload: bytes = b""

    async def subscribe_track(self, name: str, wanted: Any) -> "Liar":
        return Liar(self.tracks, list(self.tracks.get(name, [])))

    async def recv_group(self) -> "Liar | None":
        return self if self.frames is not None else None

    async def read_frame(self) -> "Liar | None":
        return Liar(self.tracks, payload=self.frames.pop(0)) if self.frames else None


def truth(stream: SceneStream) -> dict[str, list[bytes]]:
    head = head_object(stream.manifest, stream.side_info)
    packets = [packet.data for packet in stream.packets]
    parts = parts_of(stream.manifest, tiles_of(stream.manifest, stream.side_info))
    return {
        HEAD: [head],
        **{f"part/{n}": [file_record(packets[at]) for at in places] for n, places in enumerate(parts)},
    }


def test_what_relays_say_is_not_believed():
    limits = ReceiverLimits(head_bytes=1 << 16, stream_bytes=1 << 18)
    tracks, rng = truth(LEVELS), random.Random(4)
    honest = RelayReceiver(ReceiverOptions(limits=limits), None)
    assert asyncio.run(honest.receive(Liar(tracks))) == "complete"
    for _ in range(CASES // 6):
        told = {name: [mutated(frame, rng) for frame in frames] for name, frames in tracks.items()}
        if rng.random() < 0.7:
            told[HEAD] = [*tracks[HEAD]]
        if rng.random() < 0.3:
            told[rng.choice(list(told))] *= rng.choice([0, 2, 5000])
        receiver = RelayReceiver(ReceiverOptions(limits=limits, look=far() if rng.random() < 0.5 else None), None)
        with contextlib.suppress(BitstreamError):
            asyncio.run(receiver.receive(Liar(told)))
        assert receiver.num_bytes <= limits.stream_bytes + (1 << 16)
        stream = receiver.stream()
        assert stream is None or set(stream.packets) <= set(LEVELS.packets)


def mutated(data: bytes, rng: random.Random) -> bytes:
    """The same, or somewhat else."""
    if not data or rng.random() < 0.8:
        return data
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed[: rng.randrange(len(changed)) if rng.random() < 0.3 else None])
