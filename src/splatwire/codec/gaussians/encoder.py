"""Encoder of explicit Gaussians: side information, and packets block by block."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from splatwire.bitstream import HEADER_BYTES, PRESETS, PacketPlan, count_tiers
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec.antialiasing import antialiasing_sections
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.gaussians import _packet_kernels as kernels
from splatwire.codec.gaussians.attributes import fit_transform, to_harmonics
from splatwire.codec.gaussians.blocks import make_boxes
from splatwire.codec.gaussians.fit import (
    empty_statistics,
    fit_scale_indices,
    fit_zero_probabilities,
    initial_scale_indices,
)
from splatwire.codec.gaussians.layout import COLUMNS
from splatwire.codec.gaussians.quality import quality_of
from splatwire.codec.gaussians.side_info import MAX_MEAN, SideInfo, even_odds, read_side_info, write_side_info
from splatwire.codec.gaussians.source_scene import BlockSource, SourceScene
from splatwire.codec.metadata import metadata_sections
from splatwire.codec.schema import CodedPackets, Options, Prepared
from splatwire.codec.threads import ordered_map
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.tiers import encode_tiers
from splatwire.errors import InvalidValueError
from splatwire.types import SplatScene

FITTED_PACKET = 150
"""Number of Gaussians per packet while context tables are fitted, before the final packets are known."""
FITTED_SHARE = 1 / 8
"""Fraction of the packets of the scene to which context tables are fitted."""
MIN_FITTED = 128
"""Minimum number of these packets."""
MAX_FITTED = 640
"""Maximum number of these packets, which limits the encoding time."""
MAX_TRANSFORM_SAMPLE = 19_200
"""Maximum number of Gaussians to which the transform of harmonics is fitted."""
BYTES_PER_GAUSSIAN = 160
"""Size of the output buffer per Gaussian, bytes: an upper limit of its coded size without harmonics."""
BYTES_PER_HARMONIC = 12
"""Additional size for each integer of its harmonics, bytes."""


def prepare_splats(
    scene: SplatScene, options: Options, template: SideInfo | None = None, *, sorted_already: bool = False
) -> Prepared:
    """Prepares Gaussians for encoding: sorts them into spatial blocks, and computes the side information.

    Args:
        scene: The Gaussians; each must have a visible effect.
        options: Encoding options; the default packetization is the preset "paper".
        template: Side information of the stream from which the Gaussians were decoded. Its named sections and fitted
            parameters are used again. None for Gaussians from elsewhere.
        sorted_already: True if the Gaussians are in block order.

    Raises:
        InvalidValueError: If the scene is empty, or the packetization or an option does not apply to explicit
            Gaussians.
        UnknownNameError: If the name of the quality is unknown.
    """
    splats, packetization = scene.splats, options.packetization or PRESETS["paper"]
    if not splats.num_gaussians:
        raise InvalidValueError("there is no Gaussian that draws anything: there is nothing to encode")
    if not packetization.universal:
        raise InvalidValueError(
            "a packet has all attributes of its Gaussians, in Morton order: no separated packaging, no raster order"
        )
    if options.network_tolerance is not None:
        raise InvalidValueError("network_tolerance is for anchors: explicit Gaussians have no networks")
    coding = scene.coding if options.quality is None and options.class_offsets is None else None
    tier_counts = count_tiers(options.tiers, packetization) if options.tiers is not None else ()
    plan = PacketPlan(packetization, splats.num_gaussians, tier_counts)
    quality = quality_of("default" if options.quality is None else options.quality)
    tiers = options.tiers if tier_counts else None
    source = SourceScene.of(splats, plan, options.class_offsets, tiers, quality, coding, sorted_already=sorted_already)
    sections = {**({} if template is None else template.sections), **BACKGROUND_SECTION.sections(scene.background)}
    sections |= {**antialiasing_sections(scene.antialiased), **ORIGIN_SECTION.sections(scene.origin)}
    sections |= metadata_sections(scene.metadata)
    sections.pop(TIERS, None)
    if tier_counts:
        num_tiers = len(tier_counts)
        tier_of = np.repeat(np.arange(num_tiers, dtype=np.uint8), [counts.num_elements for counts in tier_counts])
        sections[TIERS] = encode_tiers(tier_of, num_tiers)
    fixed_transform = None if coding is None else coding.transform
    side_info = write_side_info(fit_side_info(source, sections, fixed_transform, template, options.threads))
    # Predict from the side information as a decoder reads it, after quantisation.
    return Prepared(GaussianEncoder(source, plan, read_side_info(side_info, plan.num_blocks)), side_info, plan)


def fit_side_info(
    scene: SourceScene, sections: Mapping[str, bytes], fixed_transform: np.ndarray | None, template: SideInfo | None,
    threads: int | None,
) -> SideInfo:  # fmt: skip
    """Computes the side information of a stream of Gaussians.

    Args:
        scene: The Gaussians, sorted into blocks.
        sections: Named sections to include, content by name.
        fixed_transform: Decorrelating transform to use for the spherical harmonics, such as the transform of an earlier
            stream. None to fit a transform to a sample of the scene. A transform for another degree of harmonics is not
            used.
        template: Side information of another stream. Its probability tables are used again. None to fit tables to a
            sample of the scene.
        threads: Number of threads; None for one per processor.
    """
    block_summaries = ordered_map(scene.summary, range(scene.num_blocks), threads)
    bounds, means = (np.array(values) for values in zip(*block_summaries, strict=True))
    boxes = make_boxes(bounds[:, 0], bounds[:, 1], scene.max_position_shift)
    num_harmonics = (scene.splats.degree + 1) ** 2 - 1
    transform = (
        scene_transform(scene) if fixed_transform is None or len(fixed_transform) != num_harmonics else fixed_transform
    )
    fields = (
        scene.splats.degree,
        scene.size_log,
        scene.lattice_bits,
        scene.base_exponents,
        scene.max_position_shift,
        transform,
        boxes,
        np.clip(means, -MAX_MEAN, MAX_MEAN),
    )
    if template is not None:
        return SideInfo(*fields, template.zero_probabilities, template.scale_indices, sections)
    unfitted, (bit_counts, residuals) = SideInfo(*fields, even_odds(), initial_scale_indices()), empty_statistics()

    blocks = scene.sample_blocks()
    sampled_per_block = np.clip(scene.edges[-1] / FITTED_PACKET * FITTED_SHARE, MIN_FITTED, MAX_FITTED) / len(blocks)

    def count_symbols(block: int) -> tuple[np.ndarray, np.ndarray]:
        size = int(scene.edges[block + 1] - scene.edges[block])
        num_packets = -(-size // FITTED_PACKET)
        starts = np.arange(num_packets + 1) * size // num_packets
        num_sampled = min(num_packets, int(np.ceil(sampled_per_block)))
        sampled_packets = np.unique(np.linspace(0, num_packets - 1, num_sampled).astype(int))
        sample = np.concatenate([np.arange(starts[packet], starts[packet + 1]) for packet in sampled_packets])
        return encode_block(
            scene.block_source(block, unfitted, sample), unfitted, block, np.diff(starts)[sampled_packets], 0
        ).statistics

    for block_bit_counts, block_residuals in ordered_map(count_symbols, blocks, threads):
        bit_counts += block_bit_counts
        residuals += block_residuals
    return SideInfo(*fields, fit_zero_probabilities(bit_counts), fit_scale_indices(residuals), sections)


def scene_transform(scene: SourceScene) -> np.ndarray:
    """Fits the decorrelating transform of spherical harmonics to a sample of the scene, int64 (K, K)."""
    if not scene.splats.degree:
        return np.zeros((0, 0), dtype=np.int64)
    blocks = scene.sample_blocks()
    sample = np.concatenate([np.arange(scene.edges[b], scene.edges[b + 1]) for b in blocks])
    sample = sample[:: -(-len(sample) // MAX_TRANSFORM_SAMPLE)]
    return fit_transform(to_harmonics(scene.splats_at(sample)), 2.0 ** scene.classes_at(sample))


@dataclass(frozen=True, eq=False)
class CodedBlock:
    """Result of encoding a block of n Gaussians in P packets.

    Attributes:
        counts: int64 (P), number of Gaussians in each packet.
        payloads: Content of each packet without its header.
        rows: int64 (n, columns), decoded integers of each Gaussian except harmonics.
        harmonic_rows: int32 (n, harmonics), decoded integers of the spherical harmonics.
        statistics: Numbers of coded symbols by context, see `empty_statistics`. With a maximum payload size, attempts
            that did not fit are counted, too.
    """

    counts: np.ndarray
    payloads: list[bytes]
    rows: np.ndarray
    harmonic_rows: np.ndarray
    statistics: tuple[np.ndarray, np.ndarray]


def encode_block(
    source: BlockSource, info: SideInfo, block: int, counts: np.ndarray, max_payload_bytes: int
) -> CodedBlock:
    """Encodes Gaussians of a block in packets.

    Args:
        source: Attributes of the Gaussians, sorted for the division into packets.
        info: The stream's side information.
        block: Index of the spatial block.
        counts: int64 (P), number of Gaussians in each packet; ignored if `max_payload_bytes` is not 0.
        max_payload_bytes: Maximum size of a packet's payload, bytes; 0 to use `counts`.
    """
    box_bits = int(info.boxes.bits[block])
    num, width = len(source.codes), info.num_harmonic_columns
    rows, harmonics = np.empty((num, COLUMNS), np.int64), np.empty((num, width), np.int32)
    buffer = np.empty(num * (BYTES_PER_GAUSSIAN + BYTES_PER_HARMONIC * width) + kernels.SPARE_BYTES, dtype=np.uint8)
    statistics, block_means = empty_statistics(), info.block_means[block]
    arguments = (
        info.kernel_tables,
        info.step_parameters(),
        info.models(),
        statistics,
        box_bits,
        block_means,
        tuple(source),
    )
    if max_payload_bytes:
        counts, ends = np.zeros(num, dtype=np.int64), np.zeros(num, dtype=np.int64)
        num_packets = kernels.encode_limited(*arguments, max_payload_bytes, buffer, rows, harmonics, counts, ends)
        counts, ends = counts[:num_packets], ends[:num_packets]
    else:
        ends = np.zeros(len(counts), dtype=np.int64)
        kernels.encode_fixed(*arguments, counts, buffer, rows, harmonics, ends)
    byte_starts = np.concatenate([[0], ends])
    payloads = [buffer[a:b].tobytes() for a, b in itertools.pairwise(byte_starts)]
    return CodedBlock(counts, payloads, rows, harmonics, statistics)


class GaussianEncoder:
    """Encodes explicit Gaussians block by block; implements `splatwire.codec.schema.Encoder`.

    Args:
        scene: The Gaussians, sorted into blocks.
        plan: Packet plan: assignment of elements to packets.
        info: Side information as decoders read it, with quantised values.
    """

    def __init__(self, scene: SourceScene, plan: PacketPlan, info: SideInfo) -> None:
        self._scene, self._plan, self._info, p = scene, plan, info, plan.packetization
        self._max_payload_bytes = p.packet_bytes - HEADER_BYTES if p.hashed else 0
        self._counts = [np.zeros(0, np.int64)] * plan.num_blocks if p.hashed else _fixed_counts(plan)

    def batches(self) -> Iterator[int]:
        """Returns the indices of all spatial blocks in encoding order. Different blocks can be encoded in parallel."""
        return iter(range(self._plan.num_blocks))

    def encode(self, block: int) -> CodedPackets:
        """Encodes the Gaussians of one spatial block as packets.

        Args:
            block: Index of the block.
        """
        source = self._scene.block_source(block, self._info)
        coded = encode_block(source, self._info, block, self._counts[block], self._max_payload_bytes)
        return CodedPackets(coded.counts, coded.payloads, (coded.rows, coded.harmonic_rows))

    def packet_order(self, block: int, counts: np.ndarray) -> np.ndarray:
        """Returns a block's Gaussians in the order in which they are coded, packet by packet.

        Args:
            block: Index of the block.
            counts: Number of Gaussians in each packet of the block, from `encode`.

        Returns:
            Entry i is the index in the scene of the i-th Gaussian in packet order, int64 (n).
        """
        return self._scene.packet_order(block, self._info, counts)


def _fixed_counts(plan: PacketPlan) -> list[np.ndarray]:
    """Returns the number of Gaussians in each packet of a plan, as one int64 array per block."""
    counts, blocks = plan.member_counts(), np.array([packet_id.block for packet_id in plan.ids])
    return [counts[blocks == block] for block in range(plan.num_blocks)]
