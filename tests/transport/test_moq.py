"""Transfers through a relay of Media over QUIC: the server of moq-rs with an origin."""

import asyncio
import contextlib
import os
import random
import socket
from collections.abc import AsyncIterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from splatwire.bitstream import Packetization, SceneStream
from splatwire.bitstream.container import file_record
from splatwire.bitstream.sections import with_section
from splatwire.codec import encode_scene
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.lod import Viewpoint, encode_levels
from splatwire.transport import ReceiverLimits, ReceiverOptions
from splatwire.transport.address import Address, parse_url
from splatwire.types import SplatScene

pytest.importorskip("moq", reason="the package moq-rs is not installed")
import splatwire.transport.moq.publisher as moq_publisher
import splatwire.transport.moq.receiver as moq_receiver
from splatwire.transport.moq.publisher import INIT_TRACK, RelayTrust, need_moq, packets_of_tracks, publish, tiles_of
from splatwire.transport.moq.receiver import RelayReceiver, receive_relayed
from splatwire.transport.protocol.events import Interrupted, Resumed
from splatwire.transport.protocol.layout import init_segment
from transport.moq_relay import moq_relay
from transport.network import FailingCallbackError

pytestmark = pytest.mark.slow

CASES = int(os.environ.get("SPLATWIRE_FUZZ_CASES", "600"))
TRUST = RelayTrust(insecure=True)
LEVELS = encode_levels(SplatScene(some_splats(3000)), Packetization(block_size=60, lanes=2))


@contextlib.asynccontextmanager
async def published(stream: SceneStream, address: Address) -> AsyncIterator[None]:
    stop, ready, warnings = asyncio.Event(), asyncio.Event(), list[str]()
    task = asyncio.ensure_future(publish(address, stream, TRUST, stop, ready.set, warnings.append))
    try:
        await asyncio.wait((task, asyncio.ensure_future(ready.wait())), return_when=asyncio.FIRST_COMPLETED)
        yield
    finally:
        stop.set()
        await task
        assert warnings == []


def run(work: Any) -> None:
    asyncio.run(asyncio.wait_for(work(), 120))


def far() -> Viewpoint:
    matrix = np.eye(4)
    matrix[2, 3] = 60.0
    return Viewpoint(matrix, 200.0, 320, 240)


def test_streams_pass_a_relay_unchanged():
    async def work() -> None:
        async with moq_relay() as there:
            plain = encode_scene(SplatScene(some_splats(900)))
            for path, stream in (("levels", LEVELS), ("some%3F/plain", plain), ("a%2Fb%3Fc", plain)):
                address = parse_url(f"moq://{there.authority}/{path}")
                async with published(stream, address):
                    many = (receive_relayed(address, ReceiverOptions(), TRUST) for _ in range(3))
                    for receiver in await asyncio.gather(*many):
                        assert receiver.finished.reason == "complete"
                        assert receiver.stream() == stream

    run(work)


def test_the_url_of_a_session_is_encoded(monkeypatch):
    """A `?` in a namespace would begin a query, and a slash in a name another part."""
    urls = []

    def client(url: str, **_: Any) -> None:
        urls.append(url)
        raise FailingCallbackError

    monkeypatch.setattr(need_moq(), "Client", client)
    for path in ("a%3Fb/scene", "a%2Fb", "x/y%23/a%2Fb"):
        with pytest.raises(FailingCallbackError):
            run(moq_publisher.session(parse_url(f"moq://relay/{path}"), TRUST).__aenter__)
    assert urls == ["https://relay:443/a%3Fb", "https://relay:443/", "https://relay:443/x/y%23"]


def test_receiver_requests_only_visible_tiles_from_a_relay():
    async def work() -> None:
        async with moq_relay() as there, published(LEVELS, replace(there, name="levels")):
            receiver = await receive_relayed(replace(there, name="levels"), ReceiverOptions(viewpoint=far()), TRUST)
            assert receiver.finished.reason == "seen"
            assert 0 < len(receiver.stream().packets) < len(LEVELS.packets) / 2

    run(work)


def test_a_view_is_taken_relative_to_the_origin_of_the_stream():
    origin = (442_000.0, 5_443_000.0, 120.0)
    stream = with_section(LEVELS, "origin", np.array(origin, "<f8").tobytes())
    world = replace(far(), origin=origin).relative_to((0.0, 0.0, 0.0))

    async def work() -> None:
        counts = []
        async with moq_relay() as there, published(stream, replace(there, name="levels")):
            for viewpoint in (replace(far(), origin=origin), world):
                receiver = await receive_relayed(
                    replace(there, name="levels"), ReceiverOptions(viewpoint=viewpoint), TRUST
                )
                counts.append({packet.id for packet in receiver.stream().packets})
        async with moq_relay() as there, published(LEVELS, replace(there, name="levels")):
            receiver = await receive_relayed(replace(there, name="levels"), ReceiverOptions(viewpoint=far()), TRUST)
            counts.append({packet.id for packet in receiver.stream().packets})
        assert counts[0] == counts[1] == counts[2]

    run(work)


def test_unknown_stream_on_a_relay_ends_at_the_deadline():
    async def work() -> None:
        async with moq_relay() as there:
            receiver = await receive_relayed(replace(there, name="nothing"), ReceiverOptions(deadline_s=1.0), TRUST)
            assert receiver.finished.reason == "deadline"
            assert receiver.stream() is None

    run(work)


@dataclass
class HostileRelay:
    """A hostile relay that acts as broadcast, track, group and frame."""

    tracks: dict[str, list[bytes]]
    frames: list[bytes] = field(default_factory=list)
    payload: bytes = b""

    async def subscribe_track(self, name: str, wanted: Any) -> "HostileRelay":
        return HostileRelay(self.tracks, list(self.tracks.get(name, [])))

    async def recv_group(self) -> "HostileRelay | None":
        return self if self.frames is not None else None

    async def read_frame(self) -> "HostileRelay | None":
        return HostileRelay(self.tracks, payload=self.frames.pop(0)) if self.frames else None


def truth(stream: SceneStream) -> dict[str, list[bytes]]:
    head = init_segment(stream.manifest, stream.side_info)
    packets = [packet.data for packet in stream.packets]
    parts = packets_of_tracks(stream.manifest, tiles_of(stream.manifest, stream.side_info))
    return {
        INIT_TRACK: [head],
        **{f"part/{n}": [file_record(packets[at]) for at in places] for n, places in enumerate(parts)},
    }


def test_hostile_relay_answers_are_validated():
    limits = ReceiverLimits(init_segment_bytes=1 << 16, stream_bytes=1 << 18)
    tracks, rng = truth(LEVELS), random.Random(4)
    honest = RelayReceiver(ReceiverOptions(limits=limits), None)
    assert asyncio.run(honest.receive(HostileRelay(tracks))) == "complete"
    for _ in range(CASES // 6):
        altered = {name: [mutated(frame, rng) for frame in frames] for name, frames in tracks.items()}
        if rng.random() < 0.7:
            altered[INIT_TRACK] = [*tracks[INIT_TRACK]]
        if rng.random() < 0.3:
            altered[rng.choice(list(altered))] *= rng.choice([0, 2, 5000])
        receiver = RelayReceiver(ReceiverOptions(limits=limits, viewpoint=far() if rng.random() < 0.5 else None), None)
        with contextlib.suppress(BitstreamError):
            asyncio.run(receiver.receive(HostileRelay(altered)))
        assert receiver.num_bytes <= limits.stream_bytes + (1 << 16)
        stream = receiver.stream()
        assert stream is None or set(stream.packets) <= set(LEVELS.packets)


def test_a_damaged_visible_tile_is_missing_from_the_view():
    tracks, options = truth(LEVELS), ReceiverOptions(viewpoint=far())
    whole, damaged = RelayReceiver(options, None), RelayReceiver(options, None)
    assert asyncio.run(whole.receive(HostileRelay(tracks))) == "seen"
    number = max(whole._complete_tracks)
    frame = bytearray(tracks[f"part/{number}"][0])
    frame[-1] ^= 1
    altered = tracks | {f"part/{number}": [bytes(frame)]}
    assert asyncio.run(damaged.receive(HostileRelay(altered))) == "sent"
    assert damaged.num_rejected == 1


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Returns the frame, possibly mutated."""
    if not data or rng.random() < 0.8:
        return data
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        changed[rng.randrange(len(changed))] = rng.randrange(256)
    return bytes(changed[: rng.randrange(len(changed)) if rng.random() < 0.3 else None])


@dataclass
class FailingRelay(HostileRelay):
    """A relay that falls silent when it has sent a number of tracks."""

    left: list[int] = field(default_factory=lambda: [0])
    asked: list[str] = field(default_factory=list)

    async def subscribe_track(self, name: str, wanted: Any) -> HostileRelay:
        if not self.left[0]:
            await asyncio.sleep(1000)
        self.left[0] -= 1
        self.asked.append(name)
        return await super().subscribe_track(name, wanted)


def relayed(monkeypatch, sessions: list[Any], options: ReceiverOptions) -> tuple[RelayReceiver, list[Any]]:
    """Receives over several sessions in turn; where an entry is not a relay, opening the session fails."""
    events, left = list[Any](), list(sessions)

    @contextlib.asynccontextmanager
    async def session(address: Address, trust: RelayTrust) -> AsyncIterator[Any]:
        relay = left.pop(0) if left else None
        if relay is None:
            raise InvalidValueError("no session with the relay")

        class Client:
            def announced_broadcast(self, name: str) -> "Client":
                return self

            async def available(self) -> Any:
                return relay

        yield Client(), "levels"

    monkeypatch.setattr(moq_receiver, "session", session)
    monkeypatch.setattr(moq_receiver, "RECONNECT_INTERVAL_S", 0.01)
    work = receive_relayed(Address("127.0.0.1", 1, "levels", "moq"), options, TRUST, events.append)
    return asyncio.run(asyncio.wait_for(work, 60)), events


QUICK = ReceiverOptions(silence_s=0.2)


def test_transfer_resumes_after_an_outage_of_the_relay(monkeypatch):
    tracks = truth(LEVELS)
    sessions = [FailingRelay(tracks, left=[4]), None, FailingRelay(tracks, left=[3]), FailingRelay(tracks, left=[999])]
    receiver, events = relayed(monkeypatch, sessions, QUICK)
    assert receiver.finished.reason == "complete"
    assert set(receiver.stream().packets) == set(LEVELS.packets)
    parts = [name for relay in sessions if relay for name in relay.asked if name != INIT_TRACK]
    assert sorted(parts) == sorted(set(parts))  # nothing is taken twice
    kinds = [type(event).__name__ for event in events if isinstance(event, (Interrupted, Resumed))]
    assert kinds == ["Interrupted", "Resumed", "Interrupted", "Resumed"]
    assert all(event.kept for event in events if isinstance(event, Resumed))


def test_transfer_restarts_with_another_stream_of_the_relay(monkeypatch):
    other = encode_levels(SplatScene(some_splats(2000)), Packetization(block_size=60, lanes=2))
    sessions = [FailingRelay(truth(LEVELS), left=[4]), FailingRelay(truth(other), left=[999])]
    receiver, events = relayed(monkeypatch, sessions, QUICK)
    assert receiver.finished.reason == "complete"
    assert set(receiver.stream().packets) == set(other.packets)
    assert [event.kept for event in events if isinstance(event, Resumed)] == [False]


def test_unreturning_relay_ends_the_transfer_with_the_received_packets(monkeypatch):
    options = ReceiverOptions(silence_s=0.2, reconnect_s=1.0)
    receiver, _ = relayed(monkeypatch, [FailingRelay(truth(LEVELS), left=[4])], options)
    assert receiver.finished.reason == "no session with the relay"
    assert 0 < len(receiver.stream().packets) < len(LEVELS.packets)
    none = ReceiverOptions(silence_s=0.2, reconnect_s=0.0)
    receiver, events = relayed(monkeypatch, [FailingRelay(truth(LEVELS), left=[4])], none)
    assert "fell silent" in receiver.finished.reason
    assert not any(isinstance(event, Interrupted) for event in events)


def test_unreachable_relay_is_an_error_at_once(monkeypatch):
    with pytest.raises(InvalidValueError, match="no session"):
        relayed(monkeypatch, [None], QUICK)


def publish_over(monkeypatch, sessions: list[str | None]) -> list[str]:
    """Publishes over several sessions in turn; returns what is reported.

    Args:
        monkeypatch: The fixture.
        sessions: Reason of the end of each session; empty for an orderly end, None if the session cannot be opened.
            Publishing ends when the list is exhausted.
    """
    reported, left, stop = list[str](), list(sessions), asyncio.Event()

    class Session:
        def __init__(self, reason: str) -> None:
            self.session, self._reason = self, reason

        async def closed(self) -> None:
            if self._reason:
                raise need_moq().Error(self._reason)

    @contextlib.asynccontextmanager
    async def session(address: Address, trust: RelayTrust, *, origin: Any) -> AsyncIterator[Any]:
        if not left:
            stop.set()
            await asyncio.sleep(1000)
        reason = left.pop(0)
        if reason is None:
            raise InvalidValueError("no session with the relay")
        reported.append("opened")
        yield Session(reason), "levels"

    monkeypatch.setattr(moq_publisher, "session", session)
    monkeypatch.setattr(moq_publisher, "MIN_PAUSE_S", 0.0)
    address = Address("127.0.0.1", 1, "levels", "moq")
    work = publish(address, LEVELS, TRUST, stop, lambda: reported.append("ready"), reported.append)
    assert asyncio.run(asyncio.wait_for(work, 60)) == (0, 0)
    return reported


def test_publisher_opens_a_new_session_until_the_relay_is_back(monkeypatch):
    reported = publish_over(monkeypatch, ["timed out", None, None, None, "", "reset"])
    ended = "the session with the relay ended ({}); connecting again".format
    failed = "no session with the relay; connecting again"
    closed = ended("it was closed")
    assert reported == [
        "opened", "ready", ended("timed out"), failed, "opened", closed, "opened", ended("reset"),
    ]  # fmt: skip


def test_warnings_of_one_interruption_are_few(monkeypatch):
    reported = publish_over(monkeypatch, [f"reason {number}" for number in range(20)])
    assert sum("connecting again" in text for text in reported) == moq_publisher.MAX_REASONS


def test_each_interruption_of_a_lasting_session_gives_a_warning(monkeypatch):
    monkeypatch.setattr(moq_publisher, "STABLE_S", 0.0)
    reported = publish_over(monkeypatch, ["timed out", None, ""])
    assert [text.partition("(")[2] for text in reported if "(" in text] == [
        "timed out); connecting again",
        "it was closed); connecting again",
    ]


def test_publisher_fails_if_its_first_session_cannot_be_opened(monkeypatch):
    with pytest.raises(InvalidValueError, match="no session"):
        publish_over(monkeypatch, [None])


@pytest.mark.parametrize(("code", "reason"), [(0, "it was closed"), (2, "unauthorized")])
def test_reason_of_a_relay_that_ends_a_session_is_in_the_warning(code: int, reason: str) -> None:
    moq, stop, ready, texts = need_moq(), asyncio.Event(), asyncio.Event(), list[str]()

    def warn(text: str) -> None:
        texts.append(text)
        stop.set()

    async def work() -> None:
        async with moq.Server("127.0.0.1:0", tls_generate=["localhost"]) as server:
            address = Address("127.0.0.1", int(server.local_addr.rpartition(":")[2]), "levels", "moq")
            publishing = asyncio.ensure_future(publish(address, LEVELS, TRUST, stop, ready.set, warn))
            async for request in server:
                accepted = await request.accept()
                await ready.wait()
                accepted.cancel(code)
                break
            await publishing

    run(work)
    assert texts == [f"the session with the relay ended ({reason}); connecting again"]


def test_silent_relay_is_named_as_the_reason(monkeypatch):
    monkeypatch.setattr(moq_publisher, "CONNECT_TIMEOUT_S", 0.1)

    async def work() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
            silent.bind(("127.0.0.1", 0))
            address = Address("127.0.0.1", silent.getsockname()[1], "levels", "moq")
            with pytest.raises(InvalidValueError, match=r": no answer$"):
                await publish(address, LEVELS, TRUST, asyncio.Event(), lambda: None, lambda text: None)

    run(work)
