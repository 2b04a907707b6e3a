"""Datagrams of a transfer as the planner simulates it: kind and size in sending order, without content."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from splatwire.arguments import CheckedFields, array_of, checked
from splatwire.bitstream import SceneStream, send_sequence
from splatwire.channel import LossModel
from splatwire.channel.loss_models import draw_checked
from splatwire.errors import InvalidValueError, shown, whole_number
from splatwire.transport.fec import MAX_REPAIR, symbol_bytes_for
from splatwire.transport.protocol.layout import ParityGroup, SourceBlocks, bundled_bytes, init_segment, parity_groups
from splatwire.transport.protocol.protection import Protection, num_bundled_packets, packets_in_tiers, protected_tiers
from splatwire.transport.protocol.send_schedule import build_send_schedule
from splatwire.transport.protocol.served_stream import default_symbol_bytes
from splatwire.transport.protocol.wire import (
    DATA,
    DATA_OVERHEAD,
    INIT_SYMBOL,
    INIT_SYMBOL_OVERHEAD,
    PARITY,
    PARITY_OVERHEAD,
)

MAX_MASK_ENTRIES = 1_000_000_000
"""Maximum number of datagrams in all simulated transfers."""
SYMBOLS_TO_SPARE = 1
"""Number of symbols beyond the K source symbols that a RaptorQ decoder is assumed to need; decoding then fails with
probability 1e-4 (RFC 6330, 1)."""


@dataclass(frozen=True, eq=False)
class StreamLoad(CheckedFields):
    """Sizes of the packets of a stream, in sending order.

    Attributes:
        init_segment_bytes: Bytes of the init segment without bundled packets: manifest and side information.
        packet_bytes: Bytes of each packet, int64 (P).
        elements: Number of elements of each packet, int64 (P).
        tiers: Importance tier of each packet, int64 (P), ascending.
    """

    init_segment_bytes: int
    packet_bytes: np.ndarray
    elements: np.ndarray
    tiers: np.ndarray

    @property
    def num_tiers(self) -> int:
        """Number of importance tiers."""
        return int(self.tiers.max(initial=0)) + 1

    @staticmethod
    def of_stream(stream: SceneStream) -> "StreamLoad":
        """Measures the packet sizes of a complete stream."""
        ordered, plan = send_sequence(stream, "tiers"), stream.manifest.plan
        return StreamLoad(
            len(init_segment(stream.manifest, stream.side_info)),
            np.array([packet.num_bytes for packet in ordered], dtype=np.int64),
            np.array([packet.num_elements for packet in ordered], dtype=np.int64),
            np.array([plan.tier_of(packet.id.block) for packet in ordered], dtype=np.int64),
        )


@dataclass(frozen=True, eq=False)
class TransferModel:
    """Datagrams of a simulated transfer in sending order: kind and size, without content.

    Attributes:
        kind: Kind of each datagram: `INIT_SYMBOL` (init segment), `DATA` (packet) or `PARITY` (repair symbol),
            int64 (n).
        group: Source block of an init segment symbol, or parity group of a repair symbol; int64 (n).
        symbol: Index of a symbol in its block or group; for a packet, its index in sending order; int64 (n).
        num_bytes: Size of each datagram with headers, bytes, int64 (n).
        source_block_sizes: Number of source symbols of each source block of the init segment.
        groups: Parity groups: packets that share repair symbols.
        num_packets: Number of packets.
        num_bundled: Number of packets that are sent inside the init segment. These are the first packets in sending
            order; they have no `DATA` datagrams of their own.
    """

    kind: np.ndarray
    group: np.ndarray
    symbol: np.ndarray
    num_bytes: np.ndarray
    source_block_sizes: tuple[int, ...]
    groups: tuple[ParityGroup, ...]
    num_packets: int
    num_bundled: int = 0

    def bytes_by_kind(self) -> dict[str, int]:
        """Returns the bytes of a complete transfer by purpose.

        Returns:
            Total size of the datagrams, in bytes, by purpose: `init_segment`, `init_protection` (its
            repair symbols), `packets`, and `packet_protection` (parity of the packets).
        """
        sizes = np.array((*self.source_block_sizes, 0), dtype=np.int64)[self._source_block()]
        repair = (self.kind == INIT_SYMBOL) & (self.symbol >= sizes)
        masks = {
            "init_segment": (self.kind == INIT_SYMBOL) & ~repair,
            "init_protection": repair,
            "packets": self.kind == DATA,
            "packet_protection": self.kind == PARITY,
        }
        return {name: int(self.num_bytes[mask].sum()) for name, mask in masks.items()}

    def sent_within(self, budget_bytes: float | int) -> int:
        """Returns the number of datagrams that fit into a budget of bytes, in sending order."""
        return int(np.searchsorted(np.cumsum(self.num_bytes), budget_bytes, side="right"))

    def _source_block(self) -> np.ndarray:
        return np.where(self.kind == INIT_SYMBOL, self.group, 0)


@checked
def model_transfer(load: StreamLoad, protection: Protection) -> TransferModel:
    """Lists the datagrams of a transfer, given the packet sizes and the redundancy.

    Args:
        load: Sizes of the stream's packets.
        protection: Redundancy settings.

    Raises:
        InvalidValueError: If the protection does not fit the stream.
    """
    num_bundled = num_bundled_packets(len(load.packet_bytes), protection)
    init_segment_bytes = load.init_segment_bytes + bundled_bytes(
        int(load.packet_bytes[:num_bundled].sum()), num_bundled
    )
    symbol_bytes = protection.init_symbol_bytes or default_symbol_bytes(init_segment_bytes)
    source_blocks = SourceBlocks(init_segment_bytes, symbol_bytes)
    block_sizes = tuple(source_blocks.size(s) for s in range(source_blocks.num_blocks))
    with_repair = [size + min(round(protection.init_repair * size), MAX_REPAIR) for size in block_sizes]
    members = load.tiers.tolist()
    tiers = protected_tiers(members, protection)
    groups = tuple(parity_groups(tiers))
    items = build_send_schedule(
        with_repair, tiers, [group.repair for group in groups], protection, packets_in_tiers(members, protection)
    )
    table = np.array(items, dtype=np.int64).reshape(-1, 3)
    parity_bytes = symbol_bytes_for(int(load.packet_bytes.max(initial=0))) + PARITY_OVERHEAD
    size = np.where(table[:, 0] == INIT_SYMBOL, symbol_bytes + INIT_SYMBOL_OVERHEAD, parity_bytes)
    data = table[:, 0] == DATA
    size[data] = load.packet_bytes[table[data, 2]] + DATA_OVERHEAD
    return TransferModel(
        table[:, 0], table[:, 1], table[:, 2], size, block_sizes, groups, len(load.packet_bytes), num_bundled
    )


@dataclass(frozen=True, eq=False)
class SimulatedTransfers(CheckedFields):
    """Side information and packets that arrive in each of T simulated transfers.

    Attributes:
        side_info: Mask of the transfers in which the side information is complete, bool (T).
        packets: Mask of packets that are received, recovered, or part of the init segment, bool (T, P).
    """

    side_info: np.ndarray
    packets: np.ndarray


@checked
def simulate(model: TransferModel, received: np.ndarray) -> SimulatedTransfers:
    """Simulates the receiver: returns which packets are received, or recovered by forward error correction.

    Args:
        model: Datagrams of a transfer.
        received: Mask of received datagrams in each of T transfers, bool (T, n).
    """
    received = transfer_masks(received, "received", len(model.kind))
    side_info, trials = side_info_arrivals(model, received), len(received)
    packets = np.zeros((trials, model.num_packets), dtype=np.bool_)
    data = model.kind == DATA
    packets[:, model.symbol[data]] = received[:, data]
    packets[:, : model.num_bundled] = True
    for number, group in enumerate(model.groups):
        members = group.start + group.step * np.arange(group.size)
        parity = received[:, (model.kind == PARITY) & (model.group == number)].sum(axis=1)
        enough = packets[:, members].sum(axis=1) + parity >= group.size + SYMBOLS_TO_SPARE * (group.size > 1)
        packets[np.ix_(enough, members)] = True
    return SimulatedTransfers(side_info, packets)


@checked
def side_info_arrivals(model: TransferModel, received: np.ndarray) -> np.ndarray:
    """Returns the mask of the simulated transfers in which the side information is complete, bool (T).

    Args:
        model: Datagrams of a transfer.
        received: Mask of received datagrams in each of T transfers, bool (T, n).
    """
    received = transfer_masks(received, "received", len(model.kind))
    complete = np.ones(len(received), dtype=np.bool_)
    for source_block, size in enumerate(model.source_block_sizes):
        mine = (model.kind == INIT_SYMBOL) & (model.group == source_block)
        of_block = received[:, mine]
        all_sources = of_block[:, model.symbol[mine] < size].all(axis=1)
        complete &= all_sources | (of_block.sum(axis=1) >= size + SYMBOLS_TO_SPARE)
    return complete


def transfer_masks(masks: Any, name: str, num_datagrams: int) -> np.ndarray:
    """Checks masks of received datagrams, and converts them to a boolean array (T, n).

    Args:
        masks: Array or nested lists: one row for each of T transfers, True for a received datagram.
        name: Name of the argument, for messages.
        num_datagrams: Minimum length of a row, n.

    Raises:
        InvalidValueError: If `masks` is not such an array, or has too few datagrams.
    """
    checked = array_of(masks, name, ("T", "n"), "b")
    if not len(checked) or checked.shape[1] < num_datagrams:
        raise InvalidValueError(f"{name}: expected masks of {num_datagrams} or more datagrams, not {shown(checked)}")
    return checked


@checked
def draw_losses(loss: LossModel, trials: int, num_datagrams: int, seed: int) -> np.ndarray:
    """Draws random masks of received datagrams from a loss model, bool (trials, num_datagrams).

    Raises:
        InvalidValueError: If a number is not positive, the seed is negative, or the masks have over 1e9 entries.
    """
    whole_number(seed, "seed")
    whole_number(trials, "trials", 1, MAX_MASK_ENTRIES)
    whole_number(num_datagrams, "num_datagrams", 1, MAX_MASK_ENTRIES // trials)
    rngs = (np.random.Generator(np.random.PCG64([seed, trial])) for trial in range(trials))
    return np.stack([draw_checked(loss, num_datagrams, rng) for rng in rngs])
