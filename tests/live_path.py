"""A clip that is pushed frame by frame through server and receiver, over a path that loses; time is a number."""

import random
from dataclasses import dataclass, field

from splatwire.clips import ClipEncoder, ClipFrame, ClipOptions
from splatwire.clips.live import LiveDecoder
from splatwire.packets import PacketId, SceneStream
from splatwire.scene.splats import Splats
from splatwire.transport import (
    Finished,
    PacketArrived,
    Protection,
    Receiver,
    ReceiverOptions,
    ServerLimits,
    SideInfoArrived,
)
from splatwire.transport.broadcast import PROTECTION, Broadcast
from splatwire.transport.sender import Server
from splatwire.transport.wire import DATA, decode, kind_of

STEP_S, STREAM_ID, FRAME_RATE = 0.004, 4711, 30


@dataclass
class Watched:
    """What a receiver showed, and when; and what it was sent."""

    frames: list[ClipFrame] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    sent: list[tuple[int, int]] = field(default_factory=list)
    """Place of each packet that left, and the newest group then."""
    reason: str = ""
    repaired: int = 0
    """Packets that parity brought back."""
    arrived: set[PacketId] = field(default_factory=set)


class LivePath:
    """One encoder, one server, one receiver.

    Args:
        frames: What is pushed, 30 a second.
        group: Frames of a group.
        loss: Share of the datagrams that is lost, both ways.
        joins: When the receiver comes, seconds.
        rate: Bytes per second, fixed; None adapts.
        protection: What is sent ahead.
        asks: Whether the receiver asks for what it lacks.
    """

    def __init__(
        self, frames: list[Splats], group: int, loss: float = 0.0, joins: float = 0.0, rate: float | None = None,
        protection: Protection = PROTECTION, asks: bool = True,
    ) -> None:  # fmt: skip
        self._random = random.Random(7)
        self._frames, self._group, self._loss, self._joins = frames, group, loss, joins
        self._asks = asks
        self._encoder = ClipEncoder(ClipOptions(group_frames=group))
        self._broadcast = Broadcast(protection, self._encoder.worth)
        limits = ServerLimits(fixed_rate=rate)
        self._server = Server({}, secret=bytes(16), random=self._random.randbytes, limits=limits)
        self._receiver: Receiver | None = None
        self._decoder, self._now, self._groups = LiveDecoder(), 0.0, 0
        self.first_packets: list[int] = []
        self.lasting: list[bool] = []
        self.watched = Watched()

    def run(self) -> tuple[Watched, SceneStream]:
        """Runs until the receiver has finished; what it showed, and the whole clip."""
        pushed = 0
        while not self.watched.reason:
            self._now += STEP_S
            assert self._now < 60
            while pushed < len(self._frames) and pushed / FRAME_RATE <= self._now:
                self._push(self._frames[pushed], pushed + 1)
                pushed += 1
            if self._receiver is None and self._now >= self._joins:
                self._receiver = Receiver(5, self._now, ReceiverOptions(nack=self._asks))
            for _, data in self._server.poll(self._now):
                if kind_of(data) == DATA:
                    self.watched.sent.append((decode(data).place, self._groups - 1))
                self._arrive(data)
            if self._receiver:
                self._answer(*self._receiver.poll(self._now))
        return self.watched, self._encoder.finish()

    def _push(self, splats: Splats, count: int) -> None:
        packets = self._encoder.push(splats)
        last = count == len(self._frames)
        if count % self._group == 0 or last:
            packets = packets or self._encoder.flush()
            program = self._broadcast.add(*self._encoder.so_far(STREAM_ID), packets)
            self.first_packets.append(program.newest)
            self.lasting = [bool(lasts) for lasts in program.lasting]
            self._groups += 1
            self._server.renew("live", program)
        if last:
            self._server.renew("live", self._broadcast.end(*self._encoder.so_far(STREAM_ID)))

    def _lost(self) -> bool:
        return self._random.random() < self._loss

    def _arrive(self, data: bytes) -> None:
        if self._receiver and not self._lost():
            self._answer(*self._receiver.receive(data, self._now))

    def _answer(self, datagrams: list[bytes], events: list) -> None:
        for data in datagrams:
            answer = None if self._lost() else self._server.receive("client", data, self._now)
            if answer is not None:
                self._arrive(answer)
        for event in events:
            if isinstance(event, SideInfoArrived):
                self._show(self._decoder.grow(event.manifest, event.side_info))
            elif isinstance(event, PacketArrived):
                self.watched.repaired += event.repaired
                self.watched.arrived.add(event.packet.id)
                self._show(self._decoder.add([event.packet]))
            elif isinstance(event, Finished):
                self._show(self._decoder.finish())
                self.watched.reason = event.reason

    def _show(self, frames) -> None:
        for frame in frames:
            self.watched.frames.append(frame)
            self.watched.times.append(self._now)
