"""Sending a stream through a channel that loses packets."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from splatwire.channel.loss_models import LossModel
from splatwire.errors import InvalidValueError
from splatwire.packets import Packet, SceneStream, send_sequence


@dataclass(frozen=True)
class TransmitRecord:
    """What a transmission did; every figure drawn from its result should name the unit that was lost.

    Attributes:
        loss: The loss model, as `parse_loss` reads it.
        unit: What was lost as one: `pak`, or `datagram` where packets are cut to fit one.
        seed: Seed of the mask.
        send_order: One of `splatwire.packets.SEND_ORDERS`.
        num_sent: Packets sent.
        num_lost: Packets lost.
        num_lost_anchors: Anchors that lost at least one packet.
        num_sent_anchors: Anchors of which at least one packet was sent.
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
    num_lost_anchors: int
    num_sent_anchors: int
    bytes_sent: int
    bytes_received: int
    bytes_protected: int
    lost: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, strings and lists only."""
        return {**asdict(self), "lost": list(self.lost)}


def transmit(
    stream: SceneStream, loss: LossModel, *, seed: int, send_order: str = "interleaved"
) -> tuple[SceneStream, TransmitRecord]:
    """Sends every packet of a stream once; side information and manifest always arrive (paper 3.2.2).

    The fate of the i-th packet sent depends on the loss model, the seed and the number of packets alone, not on their
    content: streams with equally many packets meet the same mask, so methods are compared on equal losses.

    Args:
        stream: What is sent.
        loss: Which packets are lost.
        seed: Seed of the mask.
        send_order: One of `splatwire.packets.SEND_ORDERS`, which `splatwire.packets.send_sequence` explains.

    Returns:
        The stream with the packets that arrived, and what happened.

    Raises:
        UnknownNameError: If there is no such send order.
        InvalidValueError: If the seed is negative.
    """
    if seed < 0:
        raise InvalidValueError(f"a seed must not be negative, {seed} is")
    sent = send_sequence(stream, send_order)
    received = loss.received(len(sent), np.random.Generator(np.random.PCG64(seed)))
    kept = [packet for packet, ok in zip(sent, received, strict=True) if ok]
    lost = sorted((packet for packet, ok in zip(sent, received, strict=True) if not ok), key=lambda packet: packet.id)
    parts = stream.parts()
    record = TransmitRecord(
        loss=loss.name,
        unit=stream.manifest.packetization.unit if loss.unit == "pak" else loss.unit,
        seed=seed,
        send_order=send_order,
        num_sent=len(sent),
        num_lost=len(lost),
        num_lost_anchors=_num_anchors(lost),
        num_sent_anchors=_num_anchors(sent),
        bytes_sent=sum(packet.num_bytes for packet in sent),
        bytes_received=sum(packet.num_bytes for packet in kept),
        bytes_protected=parts["manifest"] + parts["side_info"],
        lost=tuple(packet.id.filename for packet in lost),
    )
    return stream.with_packets(kept), record


def _num_anchors(packets: list[Packet]) -> int:
    """Distinct anchors of packets: the parts of a separated packet hold the same ones."""
    return sum({(packet.id.block, packet.id.lane): packet.num_anchors for packet in packets}.values())
