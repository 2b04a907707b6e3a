"""Which packets arrive, in either unit of loss, and what one unit means in the other."""

import hashlib
import io
import statistics
from dataclasses import dataclass

import numpy as np

from splatwire.channel import LossModel, parse_loss
from splatwire.evaluate.study.definition import Loss
from splatwire.packets import SceneStream, send_sequence

DATAGRAM_BYTES = 1200
"""Largest datagram that passes every path (RFC 9000, 14)."""


@dataclass(frozen=True, eq=False)
class LossMask:
    """The fate of every packet of a stream.

    Attributes:
        received: True where the packet arrived, in the order of `SceneStream.packets`, bool.
        num_datagrams: Datagrams sent.
        num_lost_datagrams: Datagrams lost by the channel; with unit `pak`, the datagrams of lost packets.
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


def datagrams_of(num_bytes: np.ndarray) -> np.ndarray:
    """Datagrams that packets of so many bytes fill, int64."""
    return np.maximum(1, -(-num_bytes // DATAGRAM_BYTES))


def draw_mask(stream: SceneStream, loss: Loss, seed: int) -> LossMask:
    """Sends every packet of a stream once.

    With unit `pak` the fate of the i-th packet sent depends on the model, the seed and the number of packets alone
    (`splatwire.channel.transmit`). With unit `datagram` the same process runs over the datagrams that the packets fill,
    one after another, and a packet arrives if all of its datagrams do: its bytes are useless otherwise.

    Args:
        stream: What is sent.
        loss: What is lost.
        seed: Seed of the mask.

    Raises:
        DatasetError: If a trace is too short.
    """
    position = {packet.id: index for index, packet in enumerate(stream.packets)}
    order = np.array([position[packet.id] for packet in send_sequence(stream, loss.send_order)], np.int64)
    sizes = np.array([packet.num_bytes for packet in stream.packets], np.int64)
    count = datagrams_of(sizes)
    sent, lost = draw_in_order(count[order], parse_loss(loss.model), loss.unit, seed)
    received = np.empty(len(order), bool)
    received[order] = sent
    num_lost = lost if loss.unit == "datagram" else int(count[~received].sum())
    return LossMask(received, int(count.sum()), num_lost)


def draw_in_order(datagrams: np.ndarray, model: LossModel, unit: str, seed: int) -> tuple[np.ndarray, int]:
    """Draws the fate of packets in the order in which they are sent.

    Args:
        datagrams: Datagrams of each packet, int64.
        model: The process.
        unit: What it loses, `pak` or `datagram`.
        seed: Seed of the draw.

    Returns:
        True where the packet arrives, bool; and how many units were lost.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    if unit == "pak" or not len(datagrams):
        received = model.received(len(datagrams), rng)
        return received, int((~received).sum())
    arrived = model.received(int(datagrams.sum()), rng)
    starts = np.cumsum(datagrams) - datagrams
    return np.logical_and.reduceat(arrived, starts), int((~arrived).sum())


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
    masks = [draw_mask(stream, Loss(model, "datagram", send_order), seed) for seed in seeds]
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
        num_anchors=np.array([packet.num_anchors for packet in stream.packets], np.int32),
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
    members = [plan.members(p.id, p.num_anchors if hashed else None) for p in stream.packets]
    starts = np.cumsum([0, *(len(ranks) for ranks in members)]).astype(np.int64)
    ranks = np.concatenate(members).astype(np.int32) if members else np.empty(0, np.int32)
    return _npz(starts=starts, ranks=ranks, positions=positions.astype(np.float32))


def _npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()
