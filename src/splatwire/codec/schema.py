"""Interface between the codec and the kinds of scene that it can encode.

A schema names the encoder and the decoder of one kind of scene, such as explicit Gaussians. This module defines
the data class of a schema, and the typing protocols (structural types) for its encoder and its decoder.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from splatwire.bitstream import Manifest, Packet, PacketBatch, Packetization, PacketPlan, SceneStream
from splatwire.bitstream.limits import StreamSchema
from splatwire.lazy_names import renamed_attributes
from splatwire.types.received_scene import ReceivedScene

CHUNK = 3000
"""Elements processed at once: large enough for efficient matrix products, small enough for the CPU cache."""
DecodedRows = tuple[np.ndarray, ...]
"""Decoded integers of elements: arrays with one row per element.

They are symbols (entropy-coded integers), or quantised values that a decoder reconstructs from symbols.
"""


@dataclass(frozen=True, eq=False)
class CodedPackets:
    """Result of encoding one part of a stream, which becomes one or more packets.

    Attributes:
        counts: int64 (packets), number of elements in each packet.
        payloads: Payload of each packet.
        decoded_rows: Integers that a decoder obtains from the packets: arrays with one row for each element.
    """

    counts: np.ndarray
    payloads: list[bytes]
    decoded_rows: DecodedRows

    __getattr__ = renamed_attributes("CodedPackets", {"rows": "decoded_rows"})


@runtime_checkable
class Encoder(Protocol):
    """Interface of an encoder, which converts the elements of one scene to packets."""

    def batches(self) -> Iterator[Any]:
        """Yields the parts of the stream in order; none is empty. Different parts can be encoded in parallel.

        A part is any value that this encoder's `encode` accepts, such as the index of a block.
        """

    def encode(self, batch: Any) -> CodedPackets:
        """Encodes one part of the stream, as yielded by `batches`; may be called from several threads."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """Scene prepared for encoding: encoder, side information and packet plan.

    Attributes:
        encoder: Encoder of the scene's elements.
        side_info: Side information of the stream.
        plan: Packet plan: assignment of elements to packets.
        manifest_fields: Further fields of the manifest, by name.
    """

    encoder: Encoder
    side_info: bytes
    plan: PacketPlan
    manifest_fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Options:
    """Options of `splatwire.codec.encode_scene` that are passed to the codec of a scene."""

    packetization: Packetization | None = None
    tiers: np.ndarray | None = None
    quality: Any = None
    class_offsets: np.ndarray | None = None
    network_tolerance: float | None = None
    threads: int | None = None


@runtime_checkable
class Decoder(Protocol):
    """Interface of a decoder of one stream. The results are arrays of all elements in the order of the decoded scene.

    Attributes:
        sections: Named sections of the side information.
        order: Entry i is the index in the decoded scene of the element with plan index i (see `PacketPlan`), int64 (N).
            None if both indices are equal, as for explicit Gaussians and for anchors with a single tier.
        batches_are_blocks: True if a batch (packets decoded in one call) is always one block; False if batches may mix
            blocks.
        packets_independent: True if each packet of a batch can also be decoded alone.
        redecode_on_demand: True to save memory by decoding packets again instead of storing decoded integers.
        scene_bytes: Memory that `allocate` and `scene` allocate, bytes.
        row_bytes: Memory of the decoded integers of one element, bytes.
    """

    sections: Mapping[str, bytes]
    order: np.ndarray | None
    batches_are_blocks: bool
    packets_independent: bool
    redecode_on_demand: bool
    scene_bytes: int
    row_bytes: int

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        """Returns the working memory of one thread that decodes the given packets, bytes."""

    def allocate(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        """Allocates arrays for all elements. Required before `store` and `scene`, but not before `decode`.

        Args:
            threads: Number of threads; None for one per processor.
            progress: Called with the completed fraction of the work, 0 to 1; None for no calls.
        """

    def decode(self, batch: PacketBatch) -> DecodedRows:
        """Decodes packets; any bytes decode without an error. May be called from several threads.

        Returns:
            The integers of the packets' elements, packet by packet.
        """

    def store(self, batch: PacketBatch, rows: DecodedRows) -> None:
        """Writes decoded elements to the arrays of the scene.

        If batches are whole blocks (`batches_are_blocks`), this method also estimates the lost elements of the block.

        Args:
            batch: The decoded packets.
            rows: Result of `decode` for these packets.
        """

    def update_digest(self, digest: Any, rows: DecodedRows) -> None:
        """Adds decoded integers to the hash of all integers, for comparison with the hash in the manifest."""
        # The division of the elements into batches does not change the hash. Batches with losses are not added.

    def scene(self) -> ReceivedScene:
        """Returns the scene decoded so far, with masks of the received elements and the stream's metadata.

        Attributes are not copied: the scene shares memory with the arrays that `store` fills.
        """


@dataclass(frozen=True, eq=False, kw_only=True)
class Schema(StreamSchema):
    """Schema: the codec of one kind of scene, with its encoder, its decoder and properties of its streams.

    See `register_schema`.

    Attributes:
        scene_type: Type of the scenes that the codec encodes.
        provides: Types of the data that every decoded stream has for concealers (`ReceivedScene.provides`): type of the
            elements, and types of side information.
        prepare: Function that prepares a scene for encoding. It may assume that all elements of the scene are drawable.
        open_decoder: Function that creates a decoder from manifest, side information and the number of received bytes.
        update_digest: Function that adds decoded integers to a hash (a `hashlib` object), for the digest of the stream.
        can_encode: Function that returns True for the scenes of `scene_type` that the codec can encode.
        prepare_repack: Function that prepares a stream for a new division into packets with the same decoded integers.
            None if the codec does not support this.
        can_repack: Function that returns True for streams that can be divided into other packets.
        remap_sections: Function that updates named sections after a stream was divided into other packets. Its
            arguments are the stream before the division and the stream after it. It returns the second stream; element
            indices in the named sections of the result refer to the order of the second stream.
    """

    scene_type: type
    provides: frozenset[type]
    prepare: Callable[[Any, Options], Prepared]
    open_decoder: Callable[[Manifest, bytes, int], Decoder]
    update_digest: Callable[[Any, DecodedRows], None]
    can_encode: Callable[[Any], bool] = lambda scene: True
    prepare_repack: Callable[[SceneStream, Packetization, int | None], Prepared] | None = None
    can_repack: Callable[[SceneStream], bool] = lambda stream: True
    remap_sections: Callable[[SceneStream, SceneStream], SceneStream] = lambda stream, packed: packed


def schema_for(stream_schema: StreamSchema, **attributes: Any) -> Schema:
    """Creates the definition of a codec (`Schema`) from stream properties, encoder and decoder.

    Args:
        stream_schema: Properties of the codec's streams, such as name and format version.
        **attributes: The other attributes of `Schema` as keyword arguments, such as the encoder and the decoder.
    """
    return Schema(**{**vars(stream_schema), "codec_path": "", "scene_path": ""}, **attributes)
