"""A transfer as a list of arrivals: what a link of some rate and loss would have delivered by when."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from splatwire.channel import LossModel
from splatwire.errors import InvalidValueError
from splatwire.packets import Packet, SceneStream, send_sequence


@dataclass(frozen=True)
class PlayedPacket:
    """A packet that was sent.

    Attributes:
        packet: The packet.
        lost: Whether it never arrives.
        bytes_sent: What had been sent by the time it was through, manifest and side information included.
        seconds: When that is, from the beginning.
    """

    packet: Packet
    lost: bool
    bytes_sent: int
    seconds: float


@dataclass(frozen=True)
class Playback:
    """One pass over a stream.

    Attributes:
        head_bytes: Manifest and side information, which go first and arrive.
        head_seconds: When they have arrived.
        arrivals: All packets in sending order.
    """

    head_bytes: int
    head_seconds: float
    arrivals: tuple[PlayedPacket, ...]

    @property
    def num_bytes(self) -> int:
        """Bytes of the whole pass."""
        return self.arrivals[-1].bytes_sent if self.arrivals else self.head_bytes

    @property
    def seconds(self) -> float:
        """Length of the whole pass."""
        return self.arrivals[-1].seconds if self.arrivals else self.head_seconds

    @cached_property
    def _sent(self) -> tuple[int, ...]:
        return tuple(arrival.bytes_sent for arrival in self.arrivals)

    def upto(self, share: float | int) -> tuple[Packet, ...]:
        """Packets that have arrived when some share of the packets' bytes has been sent.

        Args:
            share: From 0 (side information only) to 1 (everything was sent).
        """
        here = self.head_bytes + share * (self.num_bytes - self.head_bytes)
        count = bisect.bisect_right(self._sent, here + 1e-6)
        return tuple(arrival.packet for arrival in self.arrivals[:count] if not arrival.lost)

    def moment(self, share: float | int) -> tuple[int, float]:
        """Bytes that have been sent and seconds that have passed at that share."""
        sent = self.head_bytes + share * (self.num_bytes - self.head_bytes)
        passed = self.head_seconds + share * (self.seconds - self.head_seconds)
        return round(sent), passed


def plan_transfer(
    stream: SceneStream,
    loss: LossModel,
    *,
    seed: int,
    bytes_per_second: float | int = 1_250_000,
    order: Sequence[Packet] | None = None,
) -> Playback:
    """Sends every packet once, after manifest and side information; under one seed always the same packets are lost.

    Args:
        stream: What is sent.
        loss: Which packets are lost.
        seed: Seed of the losses.
        bytes_per_second: Rate of the link; 1,250,000 is 10 Mbit/s.
        order: Packets in sending order; None for the interleaved one, in which important tiers go first.

    Raises:
        InvalidValueError: If the seed is negative or the rate not positive.
    """
    if seed < 0:
        raise InvalidValueError(f"a seed must not be negative, {seed} is")
    if not bytes_per_second > 0:
        raise InvalidValueError(f"the rate of a link must be above 0, {bytes_per_second:g} bytes/s is not")
    packets = list(order) if order is not None else send_sequence(stream, "tiers")
    received = loss.received(len(packets), np.random.Generator(np.random.PCG64(seed)))
    parts = stream.parts()
    head = sent = parts["manifest"] + parts["side_info"]
    arrivals = []
    for packet, ok in zip(packets, received.tolist(), strict=True):
        sent += packet.num_bytes
        arrivals.append(PlayedPacket(packet, not ok, sent, sent / bytes_per_second))
    return Playback(head, head / bytes_per_second, tuple(arrivals))
