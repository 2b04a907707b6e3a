"""What the trunk knows of a kind of element: one record, what codes it, and what reads it again.

Which elements share a packet, in which order, and what arrived, is the same for all of them
(`splatwire.codec.encoding`, `splatwire.codec.decoding`, `splatwire.codec.progressive`).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from splatwire.model.partial import Partial
from splatwire.packets import Manifest, Packet, Packetization, PacketPlan, SceneStream

CHUNK = 3000
"""Elements worked on at once: enough to keep matrix products busy, small enough to stay in the cache."""
Rows = tuple[np.ndarray, ...]
"""Decoded integers of some elements: arrays with one row for each of them."""


@dataclass(frozen=True, eq=False)
class CodedPackets:
    """Some packets.

    Attributes:
        counts: int64 (packets), elements of each.
        payloads: Their payloads.
        rows: All integers of their elements, as a decoder finds them.
    """

    counts: np.ndarray
    payloads: list[bytes]
    rows: Rows


@runtime_checkable
class Encoder(Protocol):
    """Codes the elements of one scene, as a plan splits them."""

    def runs(self) -> Iterator[Any]:
        """Parts of the plan, in its order, that are coded side by side; none is empty."""

    def encode(self, run: Any) -> CodedPackets:
        """Codes one of them; may be called from several threads."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene that is ready to be coded.

    Attributes:
        encoder: What codes it.
        side_info: What all of its packets share.
        plan: How they split it.
        stated: What the manifest says beside the plan, by its field.
    """

    encoder: Encoder
    side_info: bytes
    plan: PacketPlan
    stated: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Options:
    """How a scene is to be coded, see `splatwire.codec.encode_scene`."""

    packetization: Packetization | None = None
    tiers: np.ndarray | None = None
    quality: Any = None
    classes: np.ndarray | None = None
    noise: float | None = None
    threads: int | None = None


@dataclass(frozen=True, eq=False)
class Run:
    """Packets that are decoded together.

    Attributes:
        block: The block of the first of them, or, where nothing of a block arrived, that one.
        packets: They, ascending by id.
        members: Ranks of the elements of each, int64, in the order in which it holds them.
    """

    block: int
    packets: tuple[Packet, ...]
    members: tuple[np.ndarray, ...]

    @property
    def ranks(self) -> np.ndarray:
        """Ranks of all elements, int64, packet by packet."""
        return np.concatenate([np.empty(0, dtype=np.int64), *self.members])

    @property
    def counts(self) -> np.ndarray:
        """Elements of each packet, int64."""
        return np.array([packet.num_elements for packet in self.packets], dtype=np.int64)

    @property
    def payloads(self) -> list[bytes]:
        """Payload of each packet."""
        return [packet.payload for packet in self.packets]


@runtime_checkable
class Decoder(Protocol):
    """Reads the elements of one stream; what it keeps of them is by rank.

    Attributes:
        sections: Named sections of the side information.
        order: Rank at each place of the manifest's plan, int64 (N); None if they are the same.
        whole_blocks: Whether a run is what arrived of one block, of all blocks; else packets of any blocks share one.
        alone: Whether packets of a run can be decoded one by one, too.
        again: Whether packets are kept, and decoded again where they are asked for, because their integers take many
            times the memory.
        scene_bytes: Memory that `expect` and `scene` take.
        row_bytes: Memory that the decoded integers of an element take.
    """

    sections: Mapping[str, bytes]
    order: np.ndarray | None
    whole_blocks: bool
    alone: bool
    again: bool
    scene_bytes: int
    row_bytes: int

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        """Memory that a thread works with when it decodes some of these packets."""

    def expect(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        """Makes arrays for all elements, which `store` and `scene` work on; `decode` needs none."""

    def decode(self, run: Run) -> Rows:
        """Decodes packets; any bytes decode to something. May be called from several threads.

        Returns:
            The integers of its elements, packet by packet.
        """

    def store(self, run: Run, rows: Rows) -> None:
        """Writes the attributes of elements that were decoded, and of lost ones of a run that is a block."""

    def update_digest(self, digest: Any, rows: Rows) -> None:
        """Adds the integers of a complete run to a hashlib object, so that it does not matter how runs were cut."""

    def scene(self) -> Partial:
        """The scene over the arrays, which share its memory, and all that the stream says of it."""


@dataclass(frozen=True, eq=False)
class Schema:
    """One kind of element: registered once (`splatwire.codec.registry`), asked for by name or by a scene.

    Attributes:
        name: What manifests call it, as registered in `splatwire.packets.limits`.
        codes: Whether a scene is coded with it.
        offers: Kinds of records that a concealer finds in every decoded stream (`Partial.offers`).
        prepare: Gets a scene ready to be coded; all of its elements can be drawn.
        prepare_again: Gets a complete stream ready to be put into other packets: the same integers, side information
            that says the same.
        open_decoder: Reads manifest and side information, and how many bytes of the stream are there.
        update_digest: See `Decoder.update_digest`.
        repackable: Whether the integers of a stream may be put into other packets.
        carried: Brings what a stream says of single elements, by their rank, into the same in other packets.
    """

    name: str
    codes: Callable[[Any], bool]
    offers: frozenset[type]
    prepare: Callable[[Any, Options], Prepared]
    prepare_again: Callable[[SceneStream, Packetization, int | None], Prepared]
    open_decoder: Callable[[Manifest, bytes, int], Decoder]
    update_digest: Callable[[Any, Rows], None]
    repackable: Callable[[SceneStream], bool] = lambda stream: True
    carried: Callable[[SceneStream, SceneStream], SceneStream] = lambda stream, packed: packed
