"""A simulated network in memory with virtual time and seeded losses; both ends are the real code."""

import heapq
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from splatwire.bitstream import PRESETS, PacketId, PacketPlan, SceneStream, make_packet, make_stream
from splatwire.bitstream.tiers import TierCounts
from splatwire.transport import Event, Receiver, ReceiverOptions, Server, ServerLimits
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.served_stream import ServedStream, make_served_stream

SECRET = b"0123456789abcdef"


class FailingCallbackError(Exception):
    """Error in a receiver's callback."""


def fail_on_event(event: object) -> None:
    """Callback that fails on every event."""
    raise FailingCallbackError


def datagram_stream(
    num_anchors: int = 9000, seed: int = 0, side_bytes: int = 60_000, per_packet: int = 40
) -> SceneStream:
    """A stream of random bytes with realistic sizes."""
    rng = np.random.default_rng(seed)
    plan, packets = PacketPlan(PRESETS["datagram"], num_anchors), []
    for block in range(plan.num_blocks):
        for first in range(0, plan.block_elements(block), per_packet):
            count = min(per_packet, plan.block_elements(block) - first)
            packets.append(make_packet(PacketId(block, first), count, rng.bytes(int(rng.integers(1080, 1135)))))
    return make_stream(
        packetization=PRESETS["datagram"], num_elements=num_anchors, feature_dim=50, num_offsets=10,
        feature_groups=(10,) * 5, side_info=rng.bytes(side_bytes), packets=packets, symbols_digest="5" * 64,
        writer="test",
    )  # fmt: skip


@dataclass
class Link:
    """One direction of a path.

    Attributes:
        lost: Called for each datagram; True loses it.
        delay_s: One-way delay, seconds.
        jitter_s: Largest further delay.
        duplicate: Share of duplicated datagrams.
        rate: Bytes per second; None for no limit. Datagrams wait in a queue of `queue_s`, then are lost.
        queue_s: Longest wait.
    """

    lost: Callable[[], bool] = lambda: False
    delay_s: float = 0.02
    jitter_s: float = 0.0
    duplicate: float = 0.0
    rate: float | None = None
    queue_s: float = 0.1
    _free_at: float = 0.0

    def arrivals(self, now: float, size: int, rng: random.Random) -> list[float]:
        start = now
        if self.rate is not None:
            start = max(now, self._free_at)
            if start - now > self.queue_s:
                return []
            self._free_at = start = start + size / self.rate
        if self.lost():
            return []
        copies = 2 if rng.random() < self.duplicate else 1
        return [start + self.delay_s + self.jitter_s * rng.random() for _ in range(copies)]


@dataclass
class Result:
    """Result of a simulated transfer."""

    receiver: Receiver
    events: list[Event] = field(default_factory=list)
    ended_at: float = 0.0
    bytes_down: int = 0
    datagrams_down: int = 0


def bernoulli(rate: float, rng: random.Random) -> Callable[[], bool]:
    return lambda: rng.random() < rate


def bursts(rate: float, mean: float, rng: random.Random) -> Callable[[], bool]:
    """Gilbert's model with two states: all datagrams are lost in one of them."""
    leave, enter, state = 1 / mean, rate / (mean * (1 - rate)), [rng.random() < rate]

    def lost() -> bool:
        now = state[0]
        state[0] = rng.random() >= leave if now else rng.random() < enter
        return now

    return lost


def at_most(lost: Callable[[], bool], seconds: float) -> Callable[[], bool]:
    """The same losses on a real path, where time ends a burst as well, because senders slow down during losses."""
    since: list[float] = []

    def brief() -> bool:
        now = time.monotonic()
        while lost():
            since[:] = since or [now]
            if now - since[0] < seconds:
                return True
        since.clear()
        return False

    return brief


def transfer(
    stream: SceneStream | ServedStream,
    *,
    down: Link | None = None,
    up: Link | None = None,
    seed: int = 0,
    options: ReceiverOptions | None = None,
    protection: Protection | None = None,
    limits: ServerLimits | None = None,
    most_s: float = 60.0,
) -> Result:
    """Runs one transfer to its end in simulated time."""
    rng = random.Random(seed)
    down, up = down or Link(), up or Link()
    program = stream if isinstance(stream, ServedStream) else make_served_stream(stream, protection)
    server = Server({"scene": program}, secret=SECRET, random=rng.randbytes, limits=limits)
    receiver = Receiver(rng.getrandbits(64), 0.0, options)
    result, queue, count = Result(receiver), [], 0
    now = 0.0

    def send(link: Link, to_server: bool, data: bytes) -> None:
        nonlocal count
        if not to_server:
            result.bytes_down += len(data)
            result.datagrams_down += 1
        for at in link.arrivals(now, len(data), rng):
            count += 1
            heapq.heappush(queue, (at, count, to_server, data))

    while receiver.finished is None and now < most_s:
        times = [t for t in (receiver.next_at(), server.next_at(), queue[0][0] if queue else None) if t is not None]
        now = max(now, min(times))
        for _, data in server.poll(now):
            send(down, False, data)
        out, events = receiver.poll(now)
        result.events += events
        for data in out:
            send(up, True, data)
        while queue and queue[0][0] <= now and receiver.finished is None:
            _, _, to_server, data = heapq.heappop(queue)
            if to_server:
                answer = server.receive("client", data, now)
                if answer is not None:
                    send(down, False, answer)
                continue
            out, events = receiver.receive(data, now)
            result.events += events
            for reply in out:
                send(up, True, reply)
    result.ended_at = now
    return result


def tiered_stream(seed: int = 0, side_bytes: int = 30_000, per_packet: int = 40) -> SceneStream:
    """The stream with two tiers: 900 of 9000 anchors are important."""
    rng = np.random.default_rng(seed)
    tiers = (TierCounts(900, 1), TierCounts(8100, 1))
    plan, packets = PacketPlan(PRESETS["datagram"], 9000, tiers), []
    for block in range(plan.num_blocks):
        for first in range(0, plan.block_elements(block), per_packet):
            count = min(per_packet, plan.block_elements(block) - first)
            packets.append(make_packet(PacketId(block, first), count, rng.bytes(int(rng.integers(1080, 1135)))))
    return make_stream(
        packetization=PRESETS["datagram"], num_elements=9000, feature_dim=50, num_offsets=10,
        feature_groups=(10,) * 5, side_info=rng.bytes(side_bytes), packets=packets, symbols_digest="5" * 64,
        writer="test", tiers=tiers,
    )  # fmt: skip
