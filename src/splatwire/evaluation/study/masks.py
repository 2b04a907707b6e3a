"""Creates loss mask files for evaluating other codecs under equal losses; measures packet loss due to datagram loss."""

import io
import statistics
from dataclasses import dataclass

import numpy as np

from splatwire.bitstream import SceneStream, send_sequence
from splatwire.channel import PacketLossMask, draw_mask, parse_loss
from splatwire.evaluation.study.definition import Loss


@dataclass(frozen=True)
class PacketLossRates:
    """Share of a stream's packets that is lost if datagrams are lost at a given rate.

    A packet is lost if any of its datagrams is lost.

    Attributes:
        model: The loss model of datagrams.
        datagram_rate: Lost share of the datagrams, mean over seeds.
        packet_rate: Lost share of the stream's packets, mean over seeds.
    """

    model: str
    datagram_rate: float
    packet_rate: float


def measure_packet_loss(stream: SceneStream, model: str, seeds: tuple[int, ...], send_order: str) -> PacketLossRates:
    """Measures which share of a stream's packets is lost if datagrams are lost by a given model.

    Args:
        stream: The complete stream.
        model: Specification of the loss model of datagrams, such as `bernoulli:0.1`.
        seeds: Seeds of the simulated losses.
        send_order: Order in which the packets are sent.
    """
    loss = parse_loss(model, "datagram")
    masks = [draw_mask(stream, loss, seed=seed, send_order=send_order) for seed in seeds]
    return PacketLossRates(
        model,
        statistics.fmean(mask.num_lost_datagrams / max(1, mask.num_datagrams) for mask in masks),
        statistics.fmean(mask.num_lost / max(1, len(mask.received)) for mask in masks),
    )


def mask_bytes(stream: SceneStream, mask: PacketLossMask, loss: Loss, seed: int) -> bytes:
    """Serialises a packet loss mask as an npz file, for evaluating other codecs on the same losses.

    The file has these arrays with one entry per packet, ascending by packet id:

    * `block`, `lane`, `part`: id of the packet (`PacketId`).
    * `num_anchors`: number of anchors of the packet.
    * `num_bytes`: size of the packet in bytes.
    * `send_index`: position of the packet in the send order.
    * `received`: True if the packet is received.

    The entries `loss`, `unit`, `send_order` and `seed` describe the loss model.

    Args:
        stream: The complete stream.
        mask: Mask of the received packets.
        loss: The loss model.
        seed: Seed of the loss.
    """
    position = {packet.id: index for index, packet in enumerate(send_sequence(stream, loss.send_order))}
    ids = [packet.id for packet in stream.packets]
    return _npz(
        block=np.array([i.block for i in ids], np.int32),
        lane=np.array([i.index_in_block for i in ids], np.int32),
        part=np.array([i.part for i in ids], np.int32),
        num_anchors=np.array([packet.num_elements for packet in stream.packets], np.int32),
        num_bytes=np.array([packet.num_bytes for packet in stream.packets], np.int32),
        send_index=np.array([position[i] for i in ids], np.int32),
        received=mask.received,
        loss=np.array(loss.model),
        unit=np.array(loss.unit),
        send_order=np.array(loss.send_order),
        seed=np.array(seed),
    )


def anchor_bytes(stream: SceneStream, positions: np.ndarray) -> bytes:
    """Serialises, as an npz file, which anchors each packet of a stream contains.

    The file has these arrays:

    * `positions`: positions of all anchors in coding order, world units, float32 (N, 3).
    * `ranks`: indices of anchors in `positions`, packet after packet, int32.
    * `starts`: index of each packet's first entry in `ranks`, and the length of `ranks`, int64. Packets are in
      ascending order of their ids; packet i contains the anchors `ranks[starts[i]:starts[i + 1]]`.

    Args:
        stream: The complete stream.
        positions: Positions of all anchors in coding order, (N, 3).
    """
    plan = stream.manifest.plan
    hashed = plan.packetization.hashed
    members = [plan.members(p.id, p.num_elements if hashed else None) for p in stream.packets]
    starts = np.cumsum([0, *(len(ranks) for ranks in members)]).astype(np.int64)
    ranks = np.concatenate(members).astype(np.int32) if members else np.empty(0, np.int32)
    return _npz(starts=starts, ranks=ranks, positions=positions.astype(np.float32))


def _npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()
