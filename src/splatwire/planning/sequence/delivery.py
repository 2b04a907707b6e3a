"""Simulates the delivery of a sequence's packets over a lossy channel."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splatwire.bitstream import PacketId, SceneStream, send_sequence
from splatwire.channel import LossModel
from splatwire.channel.loss_models import draw_checked
from splatwire.planning.transfer_model import TransferModel, simulate
from splatwire.transport.fec import symbol_bytes_for
from splatwire.transport.protocol.layout import init_segment, parity_groups
from splatwire.transport.protocol.motion_parity import GroupPackets, ProtectedOrder, group_packets, order_and_protect
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.send_schedule import build_send_schedule
from splatwire.transport.protocol.wire import DATA, DATA_OVERHEAD, PARITY_OVERHEAD


@dataclass(frozen=True, eq=False)
class SequenceLoad:
    """Sizes and importance of the packets of a sequence, in sending order.

    Attributes:
        ids: Ids of the packets.
        init_segment_bytes: Bytes of manifest and side information.
        packet_bytes: Size of the datagram with each packet, bytes, int64 (P).
        importance: Expected loss of quality if a packet is missing, float64 (P).
        groups: Indices of the packets of each group of pictures.
    """

    ids: tuple[PacketId, ...]
    init_segment_bytes: int
    packet_bytes: np.ndarray
    importance: np.ndarray
    groups: tuple[GroupPackets, ...]

    @staticmethod
    def of(stream: SceneStream, importance: Mapping[PacketId, float]) -> "SequenceLoad":
        """Returns the sizes of a complete sequence's packets, with the given importance of each packet."""
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
        """Size of a parity datagram in bytes; each carries one repair symbol."""
        return symbol_bytes_for(int(self.packet_bytes.max(initial=0)) - DATA_OVERHEAD) + PARITY_OVERHEAD

    @property
    def num_bytes(self) -> int:
        """Bytes of the whole sequence without parity."""
        return self.init_segment_bytes + int(self.packet_bytes.sum())


@dataclass(frozen=True, eq=False)
class MotionTransfer:
    """Datagrams of a sequence, or of one of its groups of pictures, for simulating losses.

    Attributes:
        order: Indices of the packets in sending order, int64.
        model: Kind and size of each datagram.
    """

    order: np.ndarray
    model: TransferModel

    @staticmethod
    def of(load: SequenceLoad, protected: ProtectedOrder) -> "MotionTransfer":
        """Builds the list of datagrams that a transfer sends: motion packets, and repair symbols (parity).

        Args:
            load: Sizes of the sequence's packets.
            protected: Sending order of the packets, and the ranges of packets that share parity.
        """
        order, codes = np.array(protected.order, np.int64), tuple(parity_groups(protected.parity_ranges))
        timing = Protection(parity_until=0.0)  # repair symbols are sent among their packets
        items = build_send_schedule([], protected.parity_ranges, [code.repair for code in codes], timing, [len(order)])
        table = np.array(items, np.int64).reshape(-1, 3)
        kind, group, symbol = table.T
        size, data = np.full(len(table), load.parity_bytes), kind == DATA
        size[data] = load.packet_bytes[order[symbol[data]]]
        return MotionTransfer(order, TransferModel(kind, group, symbol, size, (), codes, len(order)))

    @property
    def parity_bytes(self) -> int:
        """Total size of the datagrams with repair symbols, bytes."""
        return self.model.bytes_by_kind()["packet_protection"]

    def received_packets(self, received: np.ndarray) -> np.ndarray:
        """Returns the mask of packets that are received or recovered in simulated transfers, bool (T, packets).

        Args:
            received: Mask of received datagrams in each of T transfers, bool (T, n).
        """
        return simulate(self.model, received[:, : len(self.model.kind)]).packets


def model_motion_transfer(load: SequenceLoad, protection: Protection, group: int | None = None) -> MotionTransfer:
    """Returns the datagrams that are sent for the motion of a sequence, or of one group of pictures, with parity.

    Args:
        load: Sizes and importance of the sequence's packets.
        protection: Share of parity for the motion of each group.
        group: Index of the group of pictures; None for the whole sequence.
    """
    importance = load.importance.tolist()
    groups = range(len(load.groups)) if group is None else [group]
    protected = [order_and_protect([load.groups[number]], importance, protection, number) for number in groups]
    order = tuple(packet for part in protected for packet in part.order)
    return MotionTransfer.of(
        load, ProtectedOrder(order, tuple(one for part in protected for one in part.parity_ranges))
    )


def delivered(load: SequenceLoad, protection: Protection, loss: LossModel, seed: int) -> set[PacketId]:
    """Simulates one lossy transfer of a sequence; returns the ids of the packets that are received or recovered.

    Args:
        load: Sizes and importance of the sequence's packets.
        protection: Share of parity for the motion of each group.
        loss: Loss model, applied to datagrams.
        seed: Random seed of the simulated losses of datagrams.
    """
    whole = model_motion_transfer(load, protection)
    received = draw_checked(loss, len(whole.model.kind), np.random.Generator(np.random.PCG64(seed)))
    received_packets = whole.received_packets(received[None])[0]
    return {load.ids[packet] for packet in whole.order[received_packets].tolist()}
