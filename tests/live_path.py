"""A simulated live transfer: frames from an encoder through server and receiver over a lossy path."""

import itertools
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from splatwire.bitstream import PacketId, SceneStream
from splatwire.sequence import SequenceFrame, SequenceOptions
from splatwire.sequence.live_decoder import LiveDecoder
from splatwire.sequence.live_encoder import PERIOD_GROUPS, LiveEncoder
from splatwire.transport import (
    Finished,
    PacketArrived,
    Protection,
    Receiver,
    ReceiverOptions,
    ServerLimits,
    SideInfoArrived,
    StreamReplaced,
)
from splatwire.transport.protocol.live_packager import PROTECTION
from splatwire.transport.protocol.sender import Server
from splatwire.transport.protocol.wire import DATA, decode, message_kind
from splatwire.types.splats import Splats

STEP_S, STREAM_ID, FRAME_RATE = 0.004, 4711, 30


@dataclass
class Watched:
    """Frames that a receiver has shown, with their times, and the packets sent to it."""

    frames: list[SequenceFrame] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    sent: list[tuple[int, int]] = field(default_factory=list)
    """Index of each sent packet, and the newest group at that time."""
    reason: str = ""
    repaired: int = 0
    """Packets that parity restored."""
    missed: int = 0
    """Lost packets, of those that were sent after the receiver had joined."""
    arrived: set[PacketId] = field(default_factory=set)
    left: list[SceneStream] = field(default_factory=list)
    """Periods that ended."""


class LivePath:
    """One encoder, one server, one receiver.

    Args:
        frames: Encoded frames, 30 per second.
        group: Frames of a group.
        loss: Share of the datagrams that is lost, both ways.
        joins: Time at which the receiver connects, seconds.
        rate: Bytes per second, fixed; None adapts.
        protection: Forward error correction.
        asks: True if the receiver requests missing packets.
        period_groups: Groups per period.
    """

    def __init__(
        self, frames: list[Splats], group: int, loss: float = 0.0, joins: float = 0.0, rate: float | None = None,
        protection: Protection = PROTECTION, asks: bool = True, period_groups: int = PERIOD_GROUPS,
    ) -> None:  # fmt: skip
        self._random = random.Random(7)
        self._frames, self._group, self._loss, self._joins = frames, group, loss, joins
        self._asks = asks
        ids = itertools.count(STREAM_ID)
        self._clip = LiveEncoder(SequenceOptions(group_frames=group), lambda: next(ids), protection, period_groups)
        limits = ServerLimits(fixed_rate=rate)
        self._server = Server({}, secret=bytes(16), random=self._random.randbytes, limits=limits)
        self._receiver: Receiver | None = None
        self._decoder, self._now, self._groups = LiveDecoder(), 0.0, 0
        self.first_packets: list[int] = []
        self.persistent: list[bool] = []
        self.watched = Watched()
        self.each_group: Callable[[], None] = lambda: None

    def run(self, *, keep: bool = True) -> tuple[Watched, SceneStream]:
        """Runs until the receiver has finished; returns the shown frames, if kept, and the last period."""
        pushed, self._keep = 0, keep
        while not self.watched.reason:
            self._now += STEP_S
            assert self._now < 60 + len(self._frames) / FRAME_RATE
            while pushed < len(self._frames) and pushed / FRAME_RATE <= self._now:
                self._push(self._frames[pushed], pushed + 1)
                pushed += 1
            if self._receiver is None and self._now >= self._joins:
                self._receiver = Receiver(5, self._now, ReceiverOptions(nack=self._asks))
            for _, data in self._server.poll(self._now):
                if keep and message_kind(data) == DATA:
                    self.watched.sent.append((decode(data).packet_index, self._groups - 1))
                self._arrive(data)
            if self._receiver:
                self._answer(*self._receiver.poll(self._now))
        return self.watched, self._clip.encoder.finish()

    def _push(self, splats: Splats, count: int) -> None:
        last = count == len(self._frames)
        edition = self._clip.push(splats)
        for program in ([] if edition is None else [edition]) + (self._clip.end() if last else []):
            if program.newest_start < len(program.packets) and program.is_live:
                self.first_packets.append(program.newest_start)
                self._groups += 1
            self.persistent = [bool(lasts) for lasts in program.persistent]
            self._server.set_stream("live", program)
            self.each_group()

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
                self._show(self._decoder.update_header(event.manifest, event.side_info))
            elif isinstance(event, PacketArrived):
                self.watched.repaired += event.repaired
                if self._keep:
                    self.watched.arrived.add(event.packet.id)
                self._show(self._decoder.add([event.packet]))
            elif isinstance(event, StreamReplaced):
                self.watched.left += [event.stream] if self._keep else []
            elif isinstance(event, Finished):
                self._show(self._decoder.finish())
                self.watched.reason = event.reason
                assert self._receiver
                self.watched.missed = self._receiver.num_missed

    def _show(self, frames) -> None:
        for frame in frames:
            if self._keep:
                self.watched.frames.append(frame)
                self.watched.times.append(self._now)
