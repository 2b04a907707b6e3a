"""Models the delivery of motion packets over a lossy channel."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from splatwire.bitstream import PacketId, SceneStream, send_sequence
from splatwire.channel import LossModel
from splatwire.planning.transfer_model import TransferModel, simulate
from splatwire.transport.fec import symbol_bytes_for
from splatwire.transport.protocol.layout import init_segment, parity_groups
from splatwire.transport.protocol.motion_parity import Arranged, GroupPackets, arrange, group_packets
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.send_schedule import build_send_schedule
from splatwire.transport.protocol.wire import DATA, DATA_OVERHEAD, PARITY_OVERHEAD


@dataclass(frozen=True, eq=False)
class SequenceLoad:
    """Sizes and importance of the packets of a complete sequence, in sending order.

    Attributes:
        ids: Ids of the packets.
        head_bytes: Bytes of manifest and side information.
        packet_bytes: Datagram size of each packet, bytes, int64 (P).
        importance: Importance of each packet, float64 (P).
        groups: Indices of the packets of each group of pictures.
    """

    ids: tuple[PacketId, ...]
    head_bytes: int
    packet_bytes: np.ndarray
    importance: np.ndarray
    groups: tuple[GroupPackets, ...]

    @staticmethod
    def of(stream: SceneStream, importance: Mapping[PacketId, float]) -> "SequenceLoad":
        """Returns the sizes and importance of the packets of a complete sequence."""
        ordered = send_sequence(stream, "tiers")
        return SequenceLoad(
            tuple(packet.id for packet in ordered),
            len(init_segment(stream.manifest, stream.side_info)),
            np.array([packet.num_bytes + DATA_OVERHEAD for packet in ordered], np.int64),
            np.array([importance[packet.id] for packet in ordered]),
            tuple(group_packets(ordered, stream.manifest.plan)),
        )

    @property
    def parity_bytes(self) -> int:
        """Size of a datagram with one repair symbol, bytes."""
        return symbol_bytes_for(int(self.packet_bytes.max(initial=0)) - DATA_OVERHEAD) + PARITY_OVERHEAD

    @property
    def num_bytes(self) -> int:
        """Bytes of the whole sequence without parity."""
        return self.head_bytes + int(self.packet_bytes.sum())


@dataclass(frozen=True, eq=False)
class MotionTransfer:
    """Model of the transfer of a sequence, or of one group of pictures, for simulating losses.

    Attributes:
        order: Indices of the packets in sending order, int64.
        model: Sizes and kinds of the datagrams.
    """

    order: np.ndarray
    model: TransferModel

    @staticmethod
    def of(load: SequenceLoad, found: Arranged, protection: Protection) -> "MotionTransfer":
        """Builds the model of a transfer.

        Args:
            load: Sizes of all packets of the sequence.
            found: Sending order of the packets, and their parity.
            protection: Amounts of redundancy.
        """
        order, codes = np.array(found.order, np.int64), tuple(parity_groups(found.parity_ranges))
        timing = replace(protection, parity_until=0.0)
        items = build_send_schedule([], found.parity_ranges, [code.repair for code in codes], timing, [len(order)])
        table = np.array(items, np.int64).reshape(-1, 3)
        kind, group, symbol = table.T
        size, data = np.full(len(table), load.parity_bytes), kind == DATA
        size[data] = load.packet_bytes[order[symbol[data]]]
        return MotionTransfer(order, TransferModel(kind, group, symbol, size, (), codes, len(order)))

    @property
    def parity_bytes(self) -> int:
        """Bytes of all repair symbols."""
        return self.model.bytes_by_kind()["packet_protection"]

    def received_packets(self, received: np.ndarray) -> np.ndarray:
        """Simulates transfers: returns the mask of packets that are received or recovered, bool (T, packets).

        Args:
            received: Mask of received datagrams in each of T transfers, bool (T, n).
        """
        return simulate(self.model, received[:, : len(self.model.kind)]).packets


def model_motion_transfer(load: SequenceLoad, protection: Protection, group: int | None = None) -> MotionTransfer:
    """Returns the model of the datagrams of a sequence, or of one of its groups of pictures.

    Args:
        load: Sizes and importance of the packets of the sequence.
        protection: Amounts of parity for the motion of each group.
        group: Index of the group of pictures; None for the whole sequence.
    """
    importance = load.importance.tolist()
    groups = range(len(load.groups)) if group is None else [group]
    found = [arrange([load.groups[number]], importance, protection, number) for number in groups]
    order = tuple(packet for part in found for packet in part.order)
    return MotionTransfer.of(
        load, Arranged(order, tuple(one for part in found for one in part.parity_ranges)), protection
    )


def delivered(load: SequenceLoad, protection: Protection, loss: LossModel, seed: int) -> set[PacketId]:
    """Simulates one transfer of a sequence; returns the ids of packets that are received or recovered.

    Args:
        load: Packets of the sequence.
        protection: Amounts of parity for the motion of each group.
        loss: Loss model, in datagrams.
        seed: Seed of the losses.
    """
    whole = model_motion_transfer(load, protection)
    received = loss.received(len(whole.model.kind), np.random.Generator(np.random.PCG64(seed)))
    there = whole.received_packets(received[None])[0]
    return {load.ids[packet] for packet in whole.order[there].tolist()}
