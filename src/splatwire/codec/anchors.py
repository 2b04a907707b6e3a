"""What schemas of anchors share: their order, their tiers, and how runs of packets are cut."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int64

from splatwire.codec.background import SECTION as BACKGROUND
from splatwire.codec.background import background_sections
from splatwire.codec.geometry import anchor_order
from splatwire.codec.metadata import metadata_sections
from splatwire.codec.schema import CHUNK, CodedPackets, Options, Prepared, Rows
from splatwire.codec.threads import ordered_map
from splatwire.codec.tier_sizes import SECTION as TIER_SIZES
from splatwire.codec.tier_sizes import encode_tier_sizes, read_tier_sizes
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.tiers import encode_tiers, read_tiers
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene, TierSizes
from splatwire.model.voxels import voxel_indices
from splatwire.packets import (
    HEADER_BYTES,
    Manifest,
    Packet,
    Packetization,
    PacketPlan,
    SceneStream,
    shape_tiers,
    spread_packetization,
    tier_order,
)
from splatwire.packets.sections import sections_of


@runtime_checkable
class AnchorCoder(Protocol):
    """Codes anchors of one scene, which are sorted by rank."""

    def encode(self, ranks: np.ndarray, counts: np.ndarray, packet_bytes: int | None) -> CodedPackets:
        """Codes groups of anchors; may be called from several threads.

        Args:
            ranks: int64 (n), the anchors of all groups, group by group.
            counts: int64 (groups), anchors of each.
            packet_bytes: Most bytes of a payload, if groups are to be cut into packets by size; None for one (or, of
                separated attributes, one for each part) to a group.
        """


Coder = Callable[[AnchorScene, Packetization, dict[str, bytes], float | None], tuple[AnchorCoder, bytes]]
CoderAgain = Callable[[AnchorScene, Packetization, bytes], tuple[AnchorCoder, bytes]]


def prepare_anchors(scene: AnchorScene, options: Options, coder: Coder, stated: Mapping[str, Any]) -> Prepared:
    """Gets a scene of anchors ready to be coded.

    Args:
        scene: The scene, all of whose anchors can be drawn.
        options: How it is to be coded; without a packetization, `spread_packetization`.
        coder: Quantises what all packets share; gives what codes anchors, and the side information.
        stated: What the manifest says beside the plan.

    Raises:
        InvalidValueError: If there is nothing to encode, values are not finite or too large, a tier is empty, or
            the packetization or an option is not for anchors.
    """
    if options.quality is not None or options.classes is not None:
        raise InvalidValueError("qualities and classes of precision are for explicit Gaussians: anchors have own steps")
    packetization = options.packetization
    index = coding_order(scene, "morton" if packetization is None else packetization.order)
    packetization = packetization or spread_packetization(len(index))
    tier_of = np.zeros(len(index), np.uint8) if options.tiers is None else np.asarray(options.tiers)[index]
    scene = scene.select(index)
    plan = _plan(scene, packetization, tier_of)
    sections = {**background_sections(scene.background), **metadata_sections(scene.metadata)}
    if plan.tiers:
        sections[TIERS] = encode_tiers(tier_of, len(plan.tiers))
        sections[TIER_SIZES] = encode_tier_sizes(scene.anchors, tier_of, len(plan.tiers))
    made, side_info = coder(scene, packetization, sections, options.noise)
    return Prepared(AnchorEncoder(made, plan, tier_of), side_info, plan, stated)


def prepare_anchors_again(
    stream: SceneStream, scene: AnchorScene, packetization: Packetization, coder: CoderAgain, stated: Mapping[str, Any],
    *own: str,
) -> Prepared:  # fmt: skip
    """Gets the integers of a complete stream ready for other packets.

    Args:
        stream: The stream.
        scene: What it decodes to.
        packetization: How its anchors are split.
        coder: Gives what codes anchors under its side information, and that.
        stated: What the manifest says beside the plan.
        own: Named sections that the coder makes anew.

    Raises:
        InvalidValueError: If the stream has sections for anchors in another order.
    """
    sections = sections_of(stream)
    tier_of = read_tiers(sections, stream.manifest)
    if packetization.order != stream.manifest.packetization.order:
        if kept := sorted(set(sections) - {BACKGROUND, *own}):
            order = stream.manifest.packetization.order
            raise InvalidValueError(f"'{kept[0]}' of this stream is for anchors in {order} order")
        scene = scene_in_order(scene, packetization.order)
    plan = _plan(scene, packetization, tier_of)
    made, side_info = coder(scene, packetization, stream.side_info)
    return Prepared(AnchorEncoder(made, plan, tier_of), side_info, plan, stated)


def scene_in_order(scene: AnchorScene, order: str) -> AnchorScene:
    """The scene's drawable anchors, sorted by rank.

    Args:
        scene: The scene.
        order: As in `Packetization.order`.

    Returns:
        The scene with the anchors that can be drawn, render hints left out.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    return scene.select(coding_order(scene, order))


def coding_order(scene: AnchorScene, order: str) -> Int64[np.ndarray, "n"]:
    """Indices of the scene's drawable anchors, sorted by rank.

    Args:
        scene: The scene, N anchors of which n can be drawn (`splatwire.scene.rows`).
        order: As in `Packetization.order`.

    Raises:
        InvalidValueError: If no anchor is left.
    """
    drawable = np.flatnonzero(scene.drawable)
    if not len(drawable):
        raise InvalidValueError("the scene has no anchor that draws anything: there is nothing to encode")
    voxels = voxel_indices(scene.anchors.positions[drawable], scene.coding.voxel_size)
    return drawable[anchor_order(voxels, order)]


def _plan(scene: AnchorScene, packetization: Packetization, tier_of: np.ndarray) -> PacketPlan:
    groups = len(scene.coding.config.layout.feature_groups) if packetization.separated else 0
    return PacketPlan(packetization, scene.anchors.num_anchors, shape_tiers(tier_of, packetization), groups)


class AnchorEncoder:
    """See `splatwire.codec.schema.Encoder`: runs are of about as many anchors as are worked on at once.

    Args:
        coder: What codes anchors.
        plan: How they are split.
        tier_of: Tier of each by rank, uint8 (N).
    """

    def __init__(self, coder: AnchorCoder, plan: PacketPlan, tier_of: np.ndarray) -> None:
        groups, p = plan.groups(), plan.packetization
        self._coder, self._starts, self._rank_at = coder, groups.starts, tier_order(tier_of)[groups.ranks]
        self._most = p.packet_bytes - HEADER_BYTES if p.hashed else None

    def runs(self) -> Iterator[slice]:
        """See `Encoder.runs`."""
        return chunks(np.diff(self._starts))

    def encode(self, run: slice) -> CodedPackets:
        """See `Encoder.encode`."""
        starts = self._starts[run.start : run.stop + 1]
        return self._coder.encode(self._rank_at[starts[0] : starts[-1]], np.diff(starts), self._most)


def chunks(sizes: np.ndarray, most: int = CHUNK) -> Iterator[slice]:
    """Splits packets of the given sizes into runs of about `most` anchors, at least one packet each."""
    first, total = 0, 0
    for p, size in enumerate(sizes):
        if total and total + size > most:
            yield slice(first, p)
            first, total = p, 0
        total += int(size)
    if first < len(sizes):
        yield slice(first, len(sizes))


def update_digest(digest: Any, rows: Rows) -> None:
    """See `splatwire.codec.schema.Decoder.update_digest`: one anchor after another."""
    digest.update(np.ascontiguousarray(rows[0].astype("<i4")).data)


class AnchorDecoder:
    """What decoders of anchors share, see `splatwire.codec.schema.Decoder`.

    Args:
        manifest: The stream's manifest.
        sections: Named sections of its side information.

    Raises:
        BitstreamError: If side information and manifest contradict each other.
    """

    whole_blocks, alone, again = False, True, False
    chunk_bytes: int
    """Memory that each anchor takes that is being decoded."""

    def __init__(self, manifest: Manifest, sections: Mapping[str, bytes]) -> None:
        self.sections, self._num = sections, manifest.num_elements
        tiers, sizes = read_tiers(sections, manifest), read_tier_sizes(sections, manifest)
        self.order = tier_order(tiers) if manifest.tiers else None
        self._said = () if sizes is None else (TierSizes(sizes[tiers]),)

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        """See `Decoder.working_bytes`: a chunk, or the largest packet."""
        return self.chunk_bytes * (max((packet.num_elements for packet in packets), default=0) + CHUNK)

    def expect(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        """See `Decoder.expect`."""
        self.make_room()

        def predict(start: int) -> int:
            ranks = np.arange(start, min(start + CHUNK, self._num))
            self.predict(ranks)
            return int(ranks[-1]) + 1

        for done in ordered_map(predict, range(0, self._num, CHUNK), threads):
            if progress:
                progress(done / self._num)

    def make_room(self) -> None:
        """Makes arrays for all anchors, zero where nothing was received."""
        raise NotImplementedError

    def predict(self, ranks: np.ndarray) -> None:
        """Evaluates what is expected of some anchors before any packet."""
        raise NotImplementedError

    def update_digest(self, digest: Any, rows: Rows) -> None:
        """See `Decoder.update_digest`."""
        update_digest(digest, rows)
