"""Simulated transmission of a stream over a lossy channel."""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from splatwire.arguments import CheckedFields, checked, checked_except
from splatwire.bitstream import Packet, SceneStream, send_sequence
from splatwire.bitstream.packetization import DATAGRAM_BYTES
from splatwire.channel.loss_models import LossModel, draw_checked
from splatwire.channel.loss_text import parse_loss
from splatwire.errors import InvalidValueError, check_kind, shown, whole_number
from splatwire.reprs import summary_repr

SEED_STEP = 1_000_003
"""Increment of the random seed from one round of retransmissions to the next, so that rounds differ in their losses."""
ATTEMPTS_PER_GROUP = 8
"""Number of transmissions, per group of pictures, of a lost packet that later groups also need (keyframe Gaussians).
A group of half a second has time for eight round trips of 62 ms.
"""


@dataclass(frozen=True)
class TransmitRecord(CheckedFields):
    """Statistics of a simulated transmission of a stream.

    Attributes:
        loss: Loss model as text, in the syntax of `parse_loss`.
        unit: Unit of loss: `datagram`, or `pak` for whole packets that may be larger than a datagram.
        seed: Random seed of the loss mask.
        send_order: Sending order of the packets, one of `splatwire.bitstream.SEND_ORDERS`.
        num_sent: Number of packets sent.
        num_lost: Number of packets lost.
        num_lost_elements: Number of elements (Gaussians or anchors) in the packets lost.
        num_sent_elements: Number of elements (Gaussians or anchors) in the packets sent.
        bytes_sent: Total size of the packets sent in bytes, with headers.
        bytes_received: Total size of the packets received in bytes, with headers.
        bytes_protected: Size of manifest and side information in bytes, which always arrive.
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
        """Returns the statistics as numbers, strings and lists, for JSON."""
        return {**asdict(self), "lost": list(self.lost)}


@dataclass(frozen=True, eq=False)
class PacketLossMask(CheckedFields):
    """Result of a simulated transmission: which packets of a stream were received.

    Attributes:
        received: True for each received packet, in the order of `SceneStream.packets`, bool.
        num_datagrams: Number of datagrams sent.
        num_lost_datagrams: Number of datagrams lost.
    """

    received: np.ndarray
    num_datagrams: int
    num_lost_datagrams: int

    __repr__ = summary_repr

    @property
    def num_lost(self) -> int:
        """Number of packets lost."""
        return int((~self.received).sum())

    @property
    def digest(self) -> str:
        """SHA-256 of the mask in hexadecimal, equal for equal losses."""
        packed = np.packbits(self.received).tobytes()
        return hashlib.sha256(len(self.received).to_bytes(8, "little") + packed).hexdigest()

    def apply(self, stream: SceneStream) -> SceneStream:
        """Returns a copy of the stream that has only the received packets."""
        kept = [packet for packet, ok in zip(stream.packets, self.received.tolist(), strict=True) if ok]
        return stream.with_packets(kept)


@checked_except("loss", "stream", "seed")
def transmit(
    stream: SceneStream, loss: LossModel | str, *, seed: int = 0, send_order: str = "interleaved"
) -> tuple[SceneStream, TransmitRecord]:
    """Simulates sending a stream over a lossy channel; side information and manifest always arrive.

    This follows Section 3.2.2 of the paper that this project implements (docs/paper-map.md). In a sequence (dynamic
    scene), lost packets that later groups of pictures also need are retransmitted.

    Args:
        stream: Stream to send.
        loss: Loss model, or its text such as `bernoulli:0.2`.
        seed: Random seed, at least 0.
        send_order: Sending order of the packets, one of `splatwire.bitstream.SEND_ORDERS`.

    Returns:
        Stream with the received packets only, and statistics of the transmission.

    Raises:
        UnknownNameError: If the send order is unknown.
        InvalidValueError: If the seed is not an integer of at least 0, or `stream` is not a stream.
    """
    check_kind(stream, SceneStream, "read_stream")
    seed = whole_number(seed, "seed")
    loss = parse_loss(loss) if isinstance(loss, str) else loss
    if not isinstance(loss, LossModel):
        raise InvalidValueError(f"expected a loss such as 'bernoulli:0.2' (see `parse_loss`), not {shown(loss)}")
    mask = draw_mask(stream, loss, seed=seed, send_order=send_order)
    if stream.manifest.schema.timed:
        mask = replace(mask, received=mask.received | retransmitted(stream, mask, loss, seed=seed))
    received, parts = mask.apply(stream), stream.part_sizes()
    lost = [packet for packet, ok in zip(stream.packets, mask.received.tolist(), strict=True) if not ok]
    record = TransmitRecord(
        loss=loss.name,
        unit=stream.manifest.packetization.loss_unit if loss.unit == "pak" else loss.unit,
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


def retransmitted(stream: SceneStream, mask: PacketLossMask, loss: LossModel, *, seed: int) -> np.ndarray:
    """Simulates which lost packets of a sequence arrive later by retransmission.

    Args:
        stream: Stream of a sequence (dynamic scene).
        mask: Loss mask of the first transmission of all packets.
        loss: Loss model.
        seed: Random seed of the first transmission.

    Returns:
        True for each packet that was lost at first and arrives later, in the order of `SceneStream.packets`, bool.
    """
    return ~mask.received & (arrival_groups(stream, mask, loss, seed=seed) >= 0)


def arrival_groups(stream: SceneStream, mask: PacketLossMask, loss: LossModel, *, seed: int) -> np.ndarray:
    """Simulates retransmission in a sequence; returns the group of pictures during which each packet arrives.

    Args:
        stream: Stream of a sequence (dynamic scene).
        mask: Loss mask of the first transmission of all packets.
        loss: Loss model.
        seed: Random seed of the first transmission; the seeds of retransmissions are derived from it.

    Returns:
        Index of the group of pictures during which each packet arrives, int64 (packets); -1 for a packet that never
        arrives. Packets are in the order of `SceneStream.packets`.
    """
    plan, groups = stream.manifest.plan, _group_of_packets(stream)
    arrival = np.where(mask.received, groups, -1)
    is_keyframe = np.array([plan.is_keyframe(packet.id.block) for packet in stream.packets], bool)
    num_datagrams = datagrams_of(np.array([packet.num_bytes for packet in stream.packets], np.int64))
    for attempt in range(1, ATTEMPTS_PER_GROUP * len(plan.gop_spans)):
        group = attempt // ATTEMPTS_PER_GROUP
        sent_before = (groups < group) | ((groups == group) & (attempt % ATTEMPTS_PER_GROUP > 0))
        resent = np.flatnonzero(is_keyframe & (arrival < 0) & sent_before)
        arrived, _ = draw_in_order(num_datagrams[resent], loss, seed + attempt * SEED_STEP)
        arrival[resent[arrived]] = group
    return arrival


def _group_of_packets(stream: SceneStream) -> np.ndarray:
    """Returns the index of the group of pictures of each packet, int64."""
    plan = stream.manifest.plan
    return np.array([plan.gop_of_block(packet.id.block) for packet in stream.packets], np.int64)


@checked
def draw_mask(stream: SceneStream, loss: LossModel, *, seed: int, send_order: str = "interleaved") -> PacketLossMask:
    """Draws at random which packets of a stream are received when each is sent once.

    Args:
        stream: Stream to send.
        loss: Loss model.
        seed: Random seed, at least 0.
        send_order: Sending order of the packets, one of `splatwire.bitstream.SEND_ORDERS`.

    Raises:
        UnknownNameError: If the send order is unknown.
        InvalidValueError: If the seed is not an integer of at least 0.
        DatasetError: If the loss model is a recorded trace with too few entries.
    """
    seed = whole_number(seed, "seed")
    position = {packet.id: index for index, packet in enumerate(stream.packets)}
    order = np.array([position[packet.id] for packet in send_sequence(stream, send_order)], np.int64)
    num_datagrams = datagrams_of(np.array([packet.num_bytes for packet in stream.packets], np.int64))
    # With a loss model of whole packets, streams with equally many packets get the same losses, for fair comparisons.
    received_in_order, num_losses = draw_in_order(num_datagrams[order], loss, seed)
    received = np.empty(len(order), bool)
    received[order] = received_in_order
    num_lost = num_losses if loss.unit == "datagram" else int(num_datagrams[~received].sum())
    return PacketLossMask(received, int(num_datagrams.sum()), num_lost)


def draw_in_order(num_datagrams: np.ndarray, loss: LossModel, seed: int) -> tuple[np.ndarray, int]:
    """Draws at random which packets are received, under a loss model of packets or of datagrams.

    A packet is lost if any of its datagrams is lost.

    Args:
        num_datagrams: Number of datagrams of each packet, in sending order, int64.
        loss: The loss model.
        seed: Random seed.

    Returns:
        Two values: the mask of received packets in sending order, bool (packets); and the number of losses, counted in
        the unit of the loss model (packets or datagrams).
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    if loss.unit == "pak" or not len(num_datagrams):
        received = draw_checked(loss, len(num_datagrams), rng)
        return received, int((~received).sum())
    arrived = draw_checked(loss, int(num_datagrams.sum()), rng)
    starts = np.cumsum(num_datagrams) - num_datagrams
    return np.logical_and.reduceat(arrived, starts), int((~arrived).sum())


def datagrams_of(num_bytes: np.ndarray) -> np.ndarray:
    """Returns how many datagrams each packet fills, given packet sizes in bytes, int64."""
    return np.maximum(1, -(-num_bytes // DATAGRAM_BYTES))


def _num_elements(packets: Sequence[Packet]) -> int:
    """Returns the number of distinct elements (Gaussians or anchors) in packets."""
    return sum({(packet.id.block, packet.id.index_in_block): packet.num_elements for packet in packets}.values())
