"""What loss masks mean for others: in datagrams, and as files that another codec can be measured with."""

import io
import statistics
from dataclasses import dataclass

import numpy as np

from splatwire.channel import LossMask, draw_mask, parse_loss
from splatwire.evaluate.study.definition import Loss
from splatwire.packets import SceneStream, send_sequence


@dataclass(frozen=True)
class Equivalence:
    """What losing datagrams means for the packets of one stream.

    Attributes:
        model: The process, which loses datagrams.
        datagram_rate: Share of datagrams lost, mean over seeds.
        pak_rate: Share of packets lost for it, mean over seeds.
    """

    model: str
    datagram_rate: float
    pak_rate: float


def equivalence(stream: SceneStream, model: str, seeds: tuple[int, ...], send_order: str) -> Equivalence:
    """Simulates a process on the datagrams of a stream and counts the packets that it breaks."""
    loss = parse_loss(model, "datagram")
    masks = [draw_mask(stream, loss, seed=seed, send_order=send_order) for seed in seeds]
    return Equivalence(
        model,
        statistics.fmean(mask.num_lost_datagrams / max(1, mask.num_datagrams) for mask in masks),
        statistics.fmean(mask.num_lost / max(1, len(mask.received)) for mask in masks),
    )


def mask_bytes(stream: SceneStream, mask: LossMask, loss: Loss, seed: int) -> bytes:
    """A mask as an npz file, so that another codec can be measured on the same losses.

    Arrays: `block`, `lane`, `part`, `num_anchors`, `num_bytes` and `received` per packet, ascending by packet id;
    `send_index` is the place of each packet in the order of sending; `loss`, `unit`, `send_order`, `seed` say how it
    was drawn. The anchors of a packet are in the file of the stream (`anchor_bytes`).
    """
    position = {packet.id: index for index, packet in enumerate(send_sequence(stream, loss.send_order))}
    ids = [packet.id for packet in stream.packets]
    return _npz(
        block=np.array([i.block for i in ids], np.int32),
        lane=np.array([i.lane for i in ids], np.int32),
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
    """Which anchors each packet holds, as an npz file.

    Packet i, ascending by packet id, holds the anchors `ranks[starts[i]:starts[i + 1]]` of `positions` (world units,
    float32, N 3).

    Args:
        stream: The complete stream.
        positions: Anchor positions by rank.
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
