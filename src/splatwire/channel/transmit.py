"""Sending a stream through a channel that loses packets."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from splatwire.channel.loss_models import LossModel
from splatwire.channel.loss_text import parse_loss
from splatwire.errors import InvalidValueError, check_kind
from splatwire.packets import Packet, SceneStream, send_sequence

DATAGRAM_BYTES = 1200
"""Largest datagram that passes every path (RFC 9000, 14)."""
AGAIN = 1_000_003
"""Step of the seed from try to try for what is sent again."""
TRIES = 8
"""How often what lasts is sent in the time of a group, until it is there: half a second is eight trips of 62 ms."""


@dataclass(frozen=True)
class TransmitRecord:
    """What a transmission did; every figure drawn from its result should name the unit that was lost.

    Attributes:
        loss: The loss model, as `parse_loss` reads it.
        unit: What was lost as one: `pak`, or `datagram` where datagrams were, or packets are cut to fit one.
        seed: Seed of the mask.
        send_order: One of `splatwire.packets.SEND_ORDERS`.
        num_sent: Packets sent.
        num_lost: Packets lost.
        num_lost_elements: Elements that lost at least one packet.
        num_sent_elements: Elements of which at least one packet was sent.
        bytes_sent: Size of the packets sent, with headers.
        bytes_received: Size of the packets that arrived, with headers.
        bytes_protected: Size of manifest and side information, which are delivered reliably (paper 3.2.2).
        lost: File names of the lost packets, ascending by packet id.
    """

    loss: str
    unit: str
    seed: int
    send_order: str
    num_sent: int
    num_lost: int
    num_lost_elements: int
    num_sent_elements: int
    bytes_sent: int
    bytes_received: int
    bytes_protected: int
    lost: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings and lists only."""
        return {**asdict(self), "lost": list(self.lost)}


@dataclass(frozen=True, eq=False)
class LossMask:
    """The fate of every packet of a stream.

    Attributes:
        received: True where the packet arrived, in the order of `SceneStream.packets`, bool.
        num_datagrams: Datagrams sent.
        num_lost_datagrams: Datagrams lost by the channel; where whole packets are lost, the datagrams of those.
    """

    received: np.ndarray
    num_datagrams: int
    num_lost_datagrams: int

    @property
    def num_lost(self) -> int:
        """Packets lost."""
        return int((~self.received).sum())

    @property
    def digest(self) -> str:
        """Hexadecimal digest of which packets arrived."""
        packed = np.packbits(self.received).tobytes()
        return hashlib.sha256(len(self.received).to_bytes(8, "little") + packed).hexdigest()

    def apply(self, stream: SceneStream) -> SceneStream:
        """The stream with what arrived."""
        kept = [packet for packet, ok in zip(stream.packets, self.received.tolist(), strict=True) if ok]
        return stream.with_packets(kept)


def transmit(
    stream: SceneStream, loss: LossModel | str, *, seed: int, send_order: str = "interleaved"
) -> tuple[SceneStream, TransmitRecord]:
    """Sends every packet of a stream once; side information and manifest always arrive (paper 3.2.2).

    Of a clip, what lasts is sent again until it is there, `TRIES` times a group; what passes never is (`sent_again`).

    Args:
        stream: What is sent.
        loss: Which packets, or which datagrams of theirs, are lost; text is read by `parse_loss`.
        seed: Seed of the mask.
        send_order: As for `draw_mask`.

    Returns:
        The stream with the packets that arrived, and what happened.

    Raises:
        UnknownNameError: If there is no such send order.
        InvalidValueError: If the seed is negative, or `stream` is none.
    """
    check_kind(stream, SceneStream, "read_stream")
    loss = parse_loss(loss) if isinstance(loss, str) else loss
    if not isinstance(loss, LossModel):
        raise InvalidValueError(f"expected a loss such as 'bernoulli:0.2' (see `parse_loss`), not {loss!r:.60}")
    mask = draw_mask(stream, loss, seed=seed, send_order=send_order)
    if stream.manifest.schema.timed:
        mask = replace(mask, received=mask.received | sent_again(stream, mask, loss, seed=seed))
    received, parts = mask.apply(stream), stream.parts()
    lost = [packet for packet, ok in zip(stream.packets, mask.received.tolist(), strict=True) if not ok]
    record = TransmitRecord(
        loss=loss.name,
        unit=stream.manifest.packetization.unit if loss.unit == "pak" else loss.unit,
        seed=seed,
        send_order=send_order,
        num_sent=len(stream.packets),
        num_lost=len(lost),
        num_lost_elements=_num_elements(lost),
        num_sent_elements=_num_elements(stream.packets),
        bytes_sent=sum(packet.num_bytes for packet in stream.packets),
        bytes_received=sum(packet.num_bytes for packet in received.packets),
        bytes_protected=parts["manifest"] + parts["side_info"],
        lost=tuple(packet.id.filename for packet in lost),
    )
    return received, record


def sent_again(stream: SceneStream, mask: LossMask, loss: LossModel, *, seed: int) -> np.ndarray:
    """Which lost packets of a clip come after all: what lasts is sent again until it is there.

    Args:
        stream: The clip.
        mask: What came of it.
        loss: What is lost.
        seed: Seed of the mask.

    Returns:
        bool, in the order of `SceneStream.packets`.
    """
    return ~mask.received & (arrival_groups(stream, mask, loss, seed=seed) >= 0)


def arrival_groups(stream: SceneStream, mask: LossMask, loss: LossModel, *, seed: int) -> np.ndarray:
    """Group of frames in whose time each packet of a clip arrives, int64; -1 for never. See `sent_again`."""
    plan, own = stream.manifest.plan, _groups_of(stream)
    arrival = np.where(mask.received, own, -1)
    lasting = np.array([plan.lasting(packet.id.block) for packet in stream.packets], bool)
    num_datagrams = datagrams_of(np.array([packet.num_bytes for packet in stream.packets], np.int64))
    for turn in range(1, TRIES * len(plan.spans) // 2):
        group = turn // TRIES
        sent_before = (own < group) | ((own == group) & (turn % TRIES > 0))
        again = np.flatnonzero(lasting & (arrival < 0) & sent_before)
        came, _ = draw_in_order(num_datagrams[again], loss, seed + turn * AGAIN)
        arrival[again[came]] = group
    return arrival


def _groups_of(stream: SceneStream) -> np.ndarray:
    """Group of frames of each packet, int64."""
    plan = stream.manifest.plan
    return np.array([plan.tier_of(packet.id.block) // 2 for packet in stream.packets], np.int64)


def draw_mask(stream: SceneStream, loss: LossModel, *, seed: int, send_order: str = "interleaved") -> LossMask:
    """Draws which packets of a stream arrive.

    Where whole packets are lost, the fate of the i-th packet sent depends on the loss model, the seed and the number of
    packets alone, not on their content: streams with equally many packets meet the same mask, so methods are compared
    on equal losses. Where datagrams are lost, the same process runs over the datagrams that the packets fill, one after
    another, and a packet arrives if all of its datagrams do: its bytes are useless otherwise.

    Args:
        stream: What is sent.
        loss: What is lost.
        seed: Seed of the mask.
        send_order: One of `splatwire.packets.SEND_ORDERS`, which `splatwire.packets.send_sequence` explains.

    Raises:
        UnknownNameError: If there is no such send order.
        InvalidValueError: If the seed is negative.
        DatasetError: If a trace is too short.
    """
    if seed < 0:
        raise InvalidValueError(f"a seed must not be negative, {seed} is")
    position = {packet.id: index for index, packet in enumerate(stream.packets)}
    order = np.array([position[packet.id] for packet in send_sequence(stream, send_order)], np.int64)
    count = datagrams_of(np.array([packet.num_bytes for packet in stream.packets], np.int64))
    sent, lost = draw_in_order(count[order], loss, seed)
    received = np.empty(len(order), bool)
    received[order] = sent
    num_lost = lost if loss.unit == "datagram" else int(count[~received].sum())
    return LossMask(received, int(count.sum()), num_lost)


def draw_in_order(datagrams: np.ndarray, loss: LossModel, seed: int) -> tuple[np.ndarray, int]:
    """Draws the fate of packets in the order in which they are sent.

    Args:
        datagrams: Datagrams of each packet, int64.
        loss: The process, and what it loses.
        seed: Seed of the draw.

    Returns:
        True where the packet arrives, bool; and how many units were lost.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    if loss.unit == "pak" or not len(datagrams):
        received = loss.received(len(datagrams), rng)
        return received, int((~received).sum())
    arrived = loss.received(int(datagrams.sum()), rng)
    starts = np.cumsum(datagrams) - datagrams
    return np.logical_and.reduceat(arrived, starts), int((~arrived).sum())


def datagrams_of(num_bytes: np.ndarray) -> np.ndarray:
    """Datagrams that packets of so many bytes fill, int64."""
    return np.maximum(1, -(-num_bytes // DATAGRAM_BYTES))


def _num_elements(packets: Sequence[Packet]) -> int:
    """Distinct elements of packets: the parts of a separated packet hold the same ones."""
    return sum({(packet.id.block, packet.id.lane): packet.num_elements for packet in packets}.values())
