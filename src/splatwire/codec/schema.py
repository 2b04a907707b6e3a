"""What a schema of anchors has to know: how it codes some anchors, and how it reads them again.

Which anchors share a packet, in which order, and what arrived, is the same for all of them (`splatwire.codec.encoding`,
`splatwire.codec.decoding`).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from splatwire.model import AnchorScene, Partial
from splatwire.packets import Packet

CHUNK_ANCHORS = 3000
"""Anchors worked on at once: enough to keep the matrix products busy, small enough to stay in the cache."""


@dataclass(frozen=True, eq=False)
class CodedPackets:
    """Some packets.

    Attributes:
        counts: int64 (packets), anchors of each.
        payloads: Their payloads.
        rows: int32 (n, symbols), all integers of their anchors, as the digest takes them.
    """

    counts: np.ndarray
    payloads: list[bytes]
    rows: np.ndarray


@runtime_checkable
class AnchorEncoder(Protocol):
    """Codes the anchors of one scene, which are sorted by rank."""

    def encode(self, ranks: np.ndarray, counts: np.ndarray, packet_bytes: int | None) -> CodedPackets:
        """Codes groups of anchors; may be called from several threads.

        Args:
            ranks: int64 (n), the anchors of all groups, group by group.
            counts: int64 (groups), anchors of each.
            packet_bytes: Most bytes of a payload, if groups are to be cut into packets by size; None for one (or, of
                separated attributes, one for each part) to a group.
        """


@runtime_checkable
class AnchorDecoder(Protocol):
    """Reads the anchors of one stream; what it keeps of them is by rank, zero where nothing was received.

    Attributes:
        sections: Named sections of the side information.
        num_symbols: Integers of an anchor.
        scene_bytes: Memory that `make_room` and `scene` take.
        row_bytes: Memory that each anchor takes that is being decoded.
    """

    sections: Mapping[str, bytes]
    num_symbols: int
    scene_bytes: int
    row_bytes: int

    def make_room(self) -> None:
        """Makes arrays for all anchors, which `predict`, `store` and `scene` work on; `decode` needs none."""

    def predict(self, ranks: np.ndarray) -> None:
        """Evaluates what is expected of some anchors before any packet; needed once for each of them."""

    def decode(self, ranks: np.ndarray, counts: np.ndarray, payloads: Sequence[bytes]) -> np.ndarray:
        """Decodes packets; any bytes decode to something. May be called from several threads.

        Args:
            ranks: int64 (n), anchors of all packets, packet by packet; where there is room, `predict` knows them.
            counts: int64 (packets), anchors of each.
            payloads: One for each packet.

        Returns:
            int32 (n, symbols), as `CodedPackets.rows`.
        """

    def store(self, ranks: np.ndarray, rows: np.ndarray) -> None:
        """Writes the attributes of anchors that were decoded and predicted."""

    def scene(self) -> Partial[AnchorScene]:
        """The scene over the arrays, which share its memory."""


def update_digest(digest: Any, rows: np.ndarray) -> None:
    """Adds the integers of some anchors to a hashlib object, one anchor after another.

    Packets are added in plan order, so that the digest does not depend on how they were batched.
    """
    digest.update(np.ascontiguousarray(rows.astype("<i4")).data)


def most_at_once(packets: Iterable[Packet]) -> int:
    """Anchors that are worked on at once at most: a chunk, or those of the largest packet."""
    return max((packet.num_anchors for packet in packets), default=0) + CHUNK_ANCHORS


def chunks(sizes: np.ndarray, most: int = CHUNK_ANCHORS) -> Iterator[slice]:
    """Splits packets of the given sizes into runs of about `most` anchors, at least one packet each."""
    first, total = 0, 0
    for p, size in enumerate(sizes):
        if total and total + size > most:
            yield slice(first, p)
            first, total = p, 0
        total += int(size)
    if first < len(sizes):
        yield slice(first, len(sizes))
