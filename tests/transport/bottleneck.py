"""Simulated flows that share a bottleneck with a drop-tail queue: a splatwire transfer and models of TCP."""

import dataclasses
import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from splatwire.transport.protocol.live_packager import LiveSnapshot
from splatwire.transport.protocol.messages import Feedback, ParityRange
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.receiver import FEEDBACK_INTERVAL_S
from splatwire.transport.protocol.served_stream import ServedStream, make_served_stream
from splatwire.transport.protocol.server_limits import ServerLimits
from splatwire.transport.protocol.transfer import ServerTransfer
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL, decode, message_kind
from transport.network import datagram_stream

IP_UDP_BYTES = 28
SHOWN_S = 0.1
"""Time step of the recorded throughput and queue, seconds."""


class Network:
    """A clock, and one link that all flows share.

    Args:
        rate: Bytes per second of the link; None for no limit.
        queue_bytes: Size of its queue; excess packets are lost.
        round_trip: Round-trip time with an empty queue, seconds.
        lost: Decides if a packet is lost at random after the queue.
    """

    def __init__(
        self,
        rate: float | None,
        queue_bytes: float,
        round_trip: float,
        lost: Callable[[], bool] = lambda: False,
    ) -> None:
        self.rate, self.queue_bytes, self.round_trip = rate, queue_bytes, round_trip
        self.now = 0.0
        self.dropped = 0
        self.queues: list[float] = []
        self._lost = lost
        self._free_at = 0.0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0

    @property
    def queue_s(self) -> float:
        """Queueing delay of a packet that arrives now."""
        return max(self._free_at - self.now, 0.0)

    def at(self, time: float, do: Callable[[], None]) -> None:
        """Schedules an action."""
        self._count += 1
        heapq.heappush(self._events, (max(time, self.now), self._count, do))

    def send(self, size: int, arrived: Callable[[], None]) -> None:
        """Sends a packet and calls `arrived`, if it is not lost, half a round trip after it left the queue."""
        if self.rate is not None:
            if self.queue_s * self.rate + size > self.queue_bytes + size / 2:
                self.dropped += 1
                return
            self._free_at = max(self._free_at, self.now) + size / self.rate
        if not self._lost():
            self.at(max(self._free_at, self.now) + self.round_trip / 2, arrived)

    def back(self, do: Callable[[], None]) -> None:
        """Delivers an answer to a sender, after half a round trip without queue."""
        self.at(self.now + self.round_trip / 2, do)

    def run(self, until: float) -> None:
        """Advances the time."""
        while self._events and self._events[0][0] <= until:
            at, _, do = heapq.heappop(self._events)
            while len(self.queues) * SHOWN_S <= at:
                self.queues.append(self.queue_s)
            self.now = at
            do()
        self.now = until


class Flow(Protocol):
    """A sender on the link.

    Attributes:
        arrived: Bytes that arrived, by steps of `SHOWN_S`.
    """

    arrived: list[int]


def count(arrived: list[int], now: float, size: int) -> None:
    """Records arrived bytes."""
    step = int(now / SHOWN_S)
    arrived.extend([0] * (step + 1 - len(arrived)))
    arrived[step] += size


def throughput(flow: Flow, start: float, stop: float) -> float:
    """Mean bytes per second between two times."""
    first, last = round(start / SHOWN_S), round(stop / SHOWN_S)
    return sum(flow.arrived[first:last]) / (stop - start)


class _Endless(tuple[tuple[int, int, int], ...]):
    """Sending order of one init segment symbol, followed by the same packet again and again."""

    def __len__(self) -> int:
        return 1 << 60

    def __getitem__(self, place):
        return (DATA, 0, 0) if place else (INIT_SYMBOL, 0, 0)


def endless(packet_bytes: int = 1100) -> ServedStream:
    """Prepared stream that never ends."""
    short = make_served_stream(datagram_stream(num_anchors=40, side_bytes=600), Protection(init_repair=0.0))
    return dataclasses.replace(
        short,
        packets=(bytes(packet_bytes),),
        schedule=_Endless([(INIT_SYMBOL, 0, 0)]),
        retransmit_share=0.0,
        parity=(),
        parity_ranges=(),
    )


@dataclass
class Splatwire:
    """The real sender of one transfer, and feedback of a receiver 50 times per second.

    Attributes:
        network: Network of the flow.
        begin: Start time, seconds.
        deaf: Interval without feedback, seconds.
        late: Extra delay until the receiver registers a datagram, seconds.
    """

    network: Network
    begin: float = 0.0
    limits: ServerLimits = field(default_factory=lambda: ServerLimits(max_sent_ratio=1e9))
    deaf: tuple[float, float] = (0.0, 0.0)
    late: Callable[[], float] = lambda: 0.0
    arrived: list[int] = field(default_factory=list)
    sent: list[int] = field(default_factory=list)
    rates: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._largest, self._received, self._largest_at = -1, 0, 0.0
        self._planned: float | None = None
        self.network.at(self.begin, self._start)

    def _program(self) -> ServedStream:
        """Size of a datagram as it leaves the sender."""
        return _PROGRAM

    def _left(self, data: bytes) -> None:
        """Passes a sent datagram to the receiver."""

    def _start(self) -> None:
        self.transfer = ServerTransfer(self._program(), 1, self.limits, self.network.now)
        self.transfer.may_welcome(self.network.now)
        self.network.at(self.network.now + self.network.round_trip, self._report)

    def _report(self) -> None:
        now = self.network.now
        received = min(self._received, self._largest + 1)
        message = Feedback(1, max(self._largest, 0), received, int(self._largest_at * 1e6) & 0xFFFFFFFF, 0, ())
        if not self.deaf[0] <= now < self.deaf[1]:
            self.network.back(lambda: self._on_feedback(message))
        self.network.at(now + FEEDBACK_INTERVAL_S, self._report)

    def _on_feedback(self, message: Feedback) -> None:
        self.transfer.on_feedback(message, self.network.now)
        self.rates.append((self.network.now, self.transfer.control.rate))
        self._plan()

    def _plan(self) -> None:
        at = self.transfer.next_at()
        if at is not None and (self._planned is None or at < self._planned - 1e-9):
            self._planned = max(at, self.network.now)
            self.network.at(self._planned, self._poll)

    def _poll(self) -> None:
        if self._planned is None or self.network.now < self._planned:
            return
        self._planned = None
        sequence = self.transfer._feedback_tracker.sequence
        data = self.transfer.poll(self.network.now)
        if data is not None:
            size = len(data) + IP_UDP_BYTES
            count(self.sent, self.network.now, size)
            self._left(data)
            self.network.send(size, lambda: self._arrives(sequence, size))
        self._plan()

    def _arrives(self, sequence: int, size: int) -> None:
        count(self.arrived, self.network.now, size)
        self._received += 1
        if sequence > self._largest:
            self._largest, self._largest_at = sequence, self.network.now + self.late()


@dataclass
class LiveSplatwire(Splatwire):
    """The sender of a live clip: a group of frames every half second, most important motion first.

    Attributes:
        bases: Packets of bases of a group.
        motion: Packets of its motion.
        left: Indices of packets that left.
        firsts: The first packet of each group.
    """

    bases: int = 10
    motion: int = 400
    left: set[int] = field(default_factory=set)
    firsts: list[int] = field(default_factory=list)

    def _program(self) -> ServedStream:
        first = (self.bases + self.motion) * len(self.firsts)
        indices = range(first, first + self.bases + self.motion)
        persistent = (b"\1" * self.bases + bytes(self.motion)) * (len(self.firsts) + 1)
        packets = tuple(_PROGRAM.packets[0] if lasts or n >= first else b"" for n, lasts in enumerate(persistent))
        self.firsts.append(first)
        self.network.at(self.network.now + GROUP_S, self._renew)
        fields = {f.name: getattr(_PROGRAM, f.name) for f in dataclasses.fields(ServedStream)}
        schedule = ((INIT_SYMBOL, 0, 0), *((DATA, 0, index) for index in indices))
        changes = {
            "packets": packets,
            "schedule": schedule,
            "parity_ranges": (ParityRange(0, 0, 0),),
            "retransmit_share": None,
            "is_live": True,
        }
        return LiveSnapshot(**{**fields, **changes}, persistent=persistent, newest_start=first)

    def _renew(self) -> None:
        self.transfer.set_stream(self._program())
        self._plan()

    def _left(self, data: bytes) -> None:
        if message_kind(data) == DATA:
            self.left.add(decode(data).packet_index)


GROUP_S = 0.5
_PROGRAM = endless()
