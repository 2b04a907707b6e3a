"""Common code of the anchor codecs `hacpp` and `causal`: coding order, preparation, base classes of their coders."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int64

from splatwire.anchors.voxels import voxel_indices
from splatwire.arguments import checked
from splatwire.bitstream import (
    HEADER_BYTES,
    Manifest,
    Packet,
    Packetization,
    PacketPlan,
    SceneStream,
    count_tiers,
    spread_packetization,
    tier_order,
)
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.bitstream.sections import sections_of
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.geometry import anchor_order, corner_of
from splatwire.codec.metadata import SECTION as METADATA
from splatwire.codec.metadata import metadata_sections
from splatwire.codec.schema import CHUNK, CodedPackets, DecodedRows, Options, Prepared
from splatwire.codec.threads import ordered_map
from splatwire.codec.tier_sizes import SECTION as TIER_SIZES
from splatwire.codec.tier_sizes import encode_tier_sizes, read_tier_sizes
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.tiers import encode_tiers, read_tiers
from splatwire.errors import InvalidValueError
from splatwire.ops.morton import MAX_AXIS_BITS
from splatwire.types import AnchorScene, TierSizes


@runtime_checkable
class AnchorEncoder(Protocol):
    """Interface of encoders for the anchors of a scene. The anchors are numbered in coding order."""

    def encode(self, ranks: np.ndarray, counts: np.ndarray, max_payload_bytes: int | None) -> CodedPackets:
        """Encodes groups of anchors; may be called from several threads.

        Args:
            ranks: Indices, in coding order, of the n anchors to encode: first the anchors of group 0, then those of
                group 1, and so on, int64 (n).
            counts: Number of anchors in each group, int64 (groups).
            max_payload_bytes: Maximum payload size; larger groups are divided. None to leave groups undivided.
        """


EncoderFactory = Callable[[AnchorScene, Packetization, dict[str, bytes], float | None], tuple[AnchorEncoder, bytes]]
RepackEncoderFactory = Callable[[AnchorScene, Packetization, bytes], tuple[AnchorEncoder, bytes]]


def prepare_anchors(
    scene: AnchorScene, options: Options, create_encoder: EncoderFactory, manifest_fields: Mapping[str, Any]
) -> Prepared:
    """Prepares a scene of anchors for encoding: sorts the anchors, plans the packets and fits the side information.

    Args:
        scene: The scene; all of its anchors are drawable.
        options: Encoding options. Without a packetization, the result of `spread_packetization` is used.
        create_encoder: Function that fits the side information. Its arguments are the scene with anchors in coding
            order, the packetization, named sections, and `Options.network_tolerance`. It returns the encoder of the
            anchors, and the side information.
        manifest_fields: Further fields of the manifest.

    Raises:
        InvalidValueError: If the scene cannot be encoded, or an option does not apply to anchors.
    """
    if options.quality is not None or options.class_offsets is not None:
        raise InvalidValueError("qualities and classes of precision are for explicit Gaussians: anchors have own steps")
    packetization = options.packetization
    index = coding_order(scene, "morton" if packetization is None else packetization.order)
    packetization = packetization or spread_packetization(len(index))
    tier_of = np.zeros(len(index), np.uint8) if options.tiers is None else np.asarray(options.tiers)[index]
    scene = scene.select(index)
    plan = _plan(scene, packetization, tier_of)
    sections = {
        **BACKGROUND_SECTION.sections(scene.background), **ORIGIN_SECTION.sections(scene.origin),
        **metadata_sections(scene.metadata),
    }  # fmt: skip
    if plan.tiers:
        sections[TIERS] = encode_tiers(tier_of, len(plan.tiers))
        sections[TIER_SIZES] = encode_tier_sizes(scene.anchors, tier_of, len(plan.tiers))
    encoder, side_info = create_encoder(scene, packetization, sections, options.network_tolerance)
    return Prepared(PlanEncoder(encoder, plan, tier_of), side_info, plan, manifest_fields)


def prepare_anchor_repack(
    stream: SceneStream, scene: AnchorScene, packetization: Packetization, create_encoder: RepackEncoderFactory,
    manifest_fields: Mapping[str, Any],
    *section_names: str,
) -> Prepared:  # fmt: skip
    """Prepares a decoded stream of anchors for encoding into other packets.

    Args:
        stream: The complete stream.
        scene: The scene decoded from it.
        packetization: Parameters of the new division into packets.
        create_encoder: Function that returns the encoder of the anchors, and the side information of the new stream.
        manifest_fields: Further fields of the new manifest.
        *section_names: Names of the sections of side information that `create_encoder` computes again for the new
        stream.

    Raises:
        InvalidValueError: If the order of the anchors changes, and the stream has sections that depend on this order.
            All sections depend on the order, except background, origin, metadata and those in `section_names`.
    """
    sections = sections_of(stream)
    tier_of = read_tiers(sections, stream.manifest)
    if packetization.order != stream.manifest.packetization.order:
        if kept := sorted(set(sections) - {BACKGROUND_SECTION.name, ORIGIN_SECTION.name, METADATA, *section_names}):
            order = stream.manifest.packetization.order
            raise InvalidValueError(f"'{kept[0]}' of this stream is for anchors in {order} order")
        scene = scene_in_order(scene, packetization.order)
    plan = _plan(scene, packetization, tier_of)
    encoder, side_info = create_encoder(scene, packetization, stream.side_info)
    return Prepared(PlanEncoder(encoder, plan, tier_of), side_info, plan, manifest_fields)


@checked
def scene_in_order(scene: AnchorScene, order: str) -> AnchorScene:
    """Returns the drawable anchors of a scene in coding order, as a scene.

    Args:
        scene: The scene.
        order: `morton` (Z-order) or `raster` (by z, then y, then x).

    Raises:
        InvalidValueError: If no anchor is drawable, or the drawable anchors span too many voxels (`coding_order`).
    """
    return scene.select(coding_order(scene, order))


def coding_order(scene: AnchorScene, order: str) -> Int64[np.ndarray, "n"]:
    """Sorts the drawable anchors of a scene into coding order.

    Args:
        scene: The scene, N anchors, n of them drawable (`splatwire.types.validity`).
        order: `morton` (Z-order) or `raster` (by z, then y, then x).

    Returns:
        Entry i is the index in `scene` of the i-th anchor in coding order, int64 (n).

    Raises:
        InvalidValueError: If no anchor is drawable, or the drawable anchors span more than 2**21 voxels along an axis,
            from a corner that is rounded down to `CORNER_ALIGNMENT` voxels.
    """
    drawable = np.flatnonzero(scene.drawable)
    if not len(drawable):
        raise InvalidValueError("the scene has no anchor that draws anything: there is nothing to encode")
    voxels = voxel_indices(scene.anchors.positions[drawable], scene.coding.voxel_size)
    span = int((voxels - corner_of(voxels)).max()) + 1
    if span > 1 << MAX_AXIS_BITS:
        raise InvalidValueError(
            f"the anchors span {span:,} voxels along an axis, more than {1 << MAX_AXIS_BITS:,}: remove those far away, "
            "or choose a larger voxel size"
        )
    return drawable[anchor_order(voxels, order)]


def _plan(scene: AnchorScene, packetization: Packetization, tier_of: np.ndarray) -> PacketPlan:
    groups = len(scene.coding.config.layout.feature_groups) if packetization.separated else 0
    return PacketPlan(packetization, scene.anchors.num_anchors, count_tiers(tier_of, packetization), groups)


class PlanEncoder:
    """Encodes the packets of a packet plan, many packets at once.

    Args:
        encoder: Encoder of groups of anchors.
        plan: Packet plan: assignment of elements to packets.
        tier_of: Importance tier of each anchor in coding order, uint8 (N).
    """

    def __init__(self, encoder: AnchorEncoder, plan: PacketPlan, tier_of: np.ndarray) -> None:
        members, p = plan.all_members(), plan.packetization
        self._encoder, self._starts, self._rank_at = encoder, members.starts, tier_order(tier_of)[members.indices]
        self._max_payload_bytes = p.packet_bytes - HEADER_BYTES if p.hashed else None

    def batches(self) -> Iterator[slice]:
        """Yields slices of consecutive groups of anchors. Different slices can be encoded in parallel.

        A group is a packet or, with hashed grouping, a whole block, which the encoder divides into packets.
        """
        # Each slice contains about `CHUNK` anchors.
        return chunks(np.diff(self._starts))

    def encode(self, batch: slice) -> CodedPackets:
        """Encodes a slice of consecutive groups of anchors, as yielded by `batches`."""
        starts = self._starts[batch.start : batch.stop + 1]
        return self._encoder.encode(self._rank_at[starts[0] : starts[-1]], np.diff(starts), self._max_payload_bytes)


def chunks(sizes: np.ndarray, max_anchors: int = CHUNK) -> Iterator[slice]:
    """Divides groups of anchors into slices of consecutive groups, and yields the slices.

    Args:
        sizes: Number of anchors of each group.
        max_anchors: Maximum number of anchors in a slice. A slice may exceed it only if just one of its groups has
            anchors.
    """
    first, total = 0, 0
    for p, size in enumerate(sizes):
        if total and total + size > max_anchors:
            yield slice(first, p)
            first, total = p, 0
        total += int(size)
    if first < len(sizes):
        yield slice(first, len(sizes))


def update_digest(digest: Any, rows: DecodedRows) -> None:
    """Adds the decoded integers of anchors to a hash, with which receivers verify their decoding.

    Args:
        digest: hashlib object that is updated.
        rows: Result of `decode`. Only the first array, which has all integers of an anchor in one row, is added.
    """
    # The manifest contains the hash of all integers. A receiver compares it with the hash of its decoded integers.
    digest.update(np.ascontiguousarray(rows[0].astype("<i4")).data)


class AnchorDecoder:
    """Base class of the decoders of anchor streams.

    Subclasses set `working_bytes_per_anchor`, the working memory per anchor in bytes.

    Args:
        manifest: The stream's manifest.
        sections: Named sections of its side information.

    Raises:
        BitstreamError: If side information and manifest contradict each other.
    """

    batches_are_blocks, packets_independent, redecode_on_demand = False, True, False
    working_bytes_per_anchor: int
    """Memory of each anchor during decoding, bytes."""

    def __init__(self, manifest: Manifest, sections: Mapping[str, bytes]) -> None:
        self.sections, self._num = sections, manifest.num_elements
        tiers, sizes = read_tiers(sections, manifest), read_tier_sizes(sections, manifest)
        self.order = tier_order(tiers) if manifest.tiers else None
        self._records = () if sizes is None else (TierSizes(sizes[tiers]),)

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        """Returns the working memory of a decoding thread, bytes. It grows with the size of the largest packet."""
        return self.working_bytes_per_anchor * (max((packet.num_elements for packet in packets), default=0) + CHUNK)

    def allocate(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        """Allocates arrays for all anchors, and predicts the attributes of all anchors from the side information.

        The predictions are kept in separate arrays. Concealers use them for anchors whose packets are lost.

        Args:
            threads: Number of threads; None for one per processor.
            progress: Called with the completed fraction of the work, 0 to 1.
        """
        self._allocate_arrays()

        def predict(start: int) -> int:
            ranks = np.arange(start, min(start + CHUNK, self._num))
            self.predict(ranks)
            return int(ranks[-1]) + 1

        for done in ordered_map(predict, range(0, self._num, CHUNK), threads):
            if progress:
                progress(done / self._num)

    def _allocate_arrays(self) -> None:
        """Allocates arrays for the attributes of all anchors. Attributes are 0 until their packets are decoded."""
        raise NotImplementedError

    def predict(self, ranks: np.ndarray) -> None:
        """Predicts the attributes of n anchors from the side information, and stores the predictions in this object.

        Concealers use the predictions of the anchors whose packets are lost.

        Args:
            ranks: Indices of the n anchors in coding order, int64 (n).
        """
        raise NotImplementedError

    def update_digest(self, digest: Any, rows: DecodedRows) -> None:
        """Adds the decoded integers of anchors to a hash, with which receivers verify their decoding."""
        update_digest(digest, rows)
