"""Gaussians to stream."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from splatwire.codec.antialiasing import antialiasing_sections
from splatwire.codec.background import background_sections
from splatwire.codec.metadata import metadata_sections
from splatwire.codec.origin import origin_sections
from splatwire.codec.schema import CodedPackets, Options, Prepared
from splatwire.codec.schemas.gaussians.attributes import empty_rows, fit_transform, to_harmonics
from splatwire.codec.schemas.gaussians.blocks import make_boxes
from splatwire.codec.schemas.gaussians.fit import empty_statistics, first_scales, fit_bits, fit_scales
from splatwire.codec.schemas.gaussians.layout import NUM_CONTEXTS
from splatwire.codec.schemas.gaussians.quality import quality_of
from splatwire.codec.schemas.gaussians.side_info import SideInfo, read_side_info, write_side_info
from splatwire.codec.schemas.gaussians.source_scene import BlockSource, SourceScene
from splatwire.codec.threads import ordered_map
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.tiers import encode_tiers
from splatwire.errors import InvalidValueError
from splatwire.model import SplatScene
from splatwire.packets import HEADER_BYTES, PRESETS, PacketPlan, shape_tiers

FITTED_PACKET = 150
"""Gaussians of a packet while tables are fitted."""
FITTED_SHARE, FEWEST, MOST = 1 / 8, 128, 640
"""Share of the packets that tables are fitted to, but at least and at most about so many: time stays linear."""
BYTES_PER_GAUSSIAN = 160
BYTES_PER_HARMONIC = 12


def prepare_splats(
    scene: SplatScene, options: Options, like: SideInfo | None = None, *, sorted_already: bool = False
) -> Prepared:
    """Gets Gaussians ready to be coded.

    Which Gaussian is at which place of the stream is the encoder's choice: places travel in packets.

    Args:
        scene: The Gaussians, all of which can be drawn. With neither quality nor classes, those that were decoded
            become the same integers again.
        options: How they are to be coded; without a packetization, that of the paper.
        like: Side information whose tables and named sections are taken, of the stream that the Gaussians come from.
        sorted_already: Whether the Gaussians lie block by block as they come; else a Morton curve sorts them.

    Raises:
        InvalidValueError: If there is nothing to encode, or the packetization or an option is not for this.
        UnknownNameError: If there is no such quality.
    """
    splats, packetization = scene.splats, options.packetization or PRESETS["paper"]
    if not splats.num_gaussians:
        raise InvalidValueError("there is no Gaussian that draws anything: there is nothing to encode")
    if not packetization.common:
        raise InvalidValueError("Gaussians travel whole and in Morton order: no separated packaging, no raster order")
    if options.noise is not None:
        raise InvalidValueError("explicit Gaussians have no networks whose noise could be tolerated")
    coding = scene.coding if options.quality is None and options.classes is None else None
    shapes = shape_tiers(options.tiers, packetization) if options.tiers is not None else ()
    plan = PacketPlan(packetization, splats.num_gaussians, shapes)
    quality = quality_of(options.quality or "default")
    tiers = options.tiers if shapes else None
    source = SourceScene.of(splats, plan, options.classes, tiers, quality, coding, sorted_already=sorted_already)
    sections = {**({} if like is None else like.sections), **background_sections(scene.background)}
    sections |= {**antialiasing_sections(scene.antialiased), **origin_sections(scene.origin)}
    sections |= metadata_sections(scene.metadata)
    sections.pop(TIERS, None)
    if shapes:
        tier_of = np.repeat(np.arange(len(shapes), dtype=np.uint8), [shape.num_elements for shape in shapes])
        sections[TIERS] = encode_tiers(tier_of, len(shapes))
    known = None if coding is None else coding.transform
    side_info = write_side_info(fit_side_info(source, sections, known, like, options.threads))
    # Predict from what a decoder will read, not from what was meant.
    return Prepared(GaussianEncoder(source, plan, read_side_info(side_info, plan.num_blocks)), side_info, plan)


def fit_side_info(
    scene: SourceScene, sections: Mapping[str, bytes], known: np.ndarray | None, like: SideInfo | None,
    threads: int | None,
) -> SideInfo:  # fmt: skip
    """Side information: boxes and means of blocks, and tables fitted to a part of the scene, or those of `like`.

    So is the transform of harmonics, unless one is `known`.
    """
    ends = np.array(list(ordered_map(scene.ends, range(scene.num_blocks), threads)))
    boxes = make_boxes(ends[:, 0], ends[:, 1], scene.coarsest)
    means = list(ordered_map(scene.means, range(scene.num_blocks), threads))
    zero = np.full(NUM_CONTEXTS, 128, dtype=np.int64)
    side = (scene.splats.degree + 1) ** 2 - 1
    transform = _transform(scene) if known is None or len(known) != side else known
    fields = (
        scene.splats.degree,
        scene.size_log,
        scene.unit,
        scene.bases,
        scene.coarsest,
        transform,
        boxes,
        np.clip(means, -511, 511),
    )
    if like is not None:
        return SideInfo(*fields, like.bit_zero, like.scales, sections)
    first, (bits, residuals) = SideInfo(*fields, zero, first_scales()), empty_statistics()

    blocks = scene.some_blocks()
    wanted = np.clip(scene.edges[-1] / FITTED_PACKET * FITTED_SHARE, FEWEST, MOST) / len(blocks)

    def count(block: int) -> tuple[np.ndarray, np.ndarray]:
        size = int(scene.edges[block + 1] - scene.edges[block])
        parts = -(-size // FITTED_PACKET)
        edges = np.arange(parts + 1) * size // parts
        chosen = np.unique(np.linspace(0, parts - 1, min(parts, int(np.ceil(wanted)))).astype(int))
        some = np.concatenate([np.arange(edges[part], edges[part + 1]) for part in chosen])
        return encode_block(scene.arranged(block, first, some), first, block, np.diff(edges)[chosen], 0).statistics

    for some_bits, some_residuals in ordered_map(count, blocks, threads):
        bits += some_bits
        residuals += some_residuals
    return SideInfo(*fields, fit_bits(bits), fit_scales(residuals), sections)


def _transform(scene: SourceScene) -> np.ndarray:
    """Transform of the harmonics, fitted to a part of the scene in units of steps."""
    if not scene.splats.degree:
        return np.zeros((0, 0), dtype=np.int64)
    blocks = scene.some_blocks()
    where = np.concatenate([np.arange(scene.edges[b], scene.edges[b + 1]) for b in blocks])
    where = where[:: -(-len(where) // (FITTED_PACKET * FEWEST))]
    return fit_transform(to_harmonics(scene.pick(where)), 2.0 ** scene.classes_at(where))


@dataclass(frozen=True, eq=False)
class CodedBlock:
    """What encoding a block gave.

    Attributes:
        sizes: int64 (P), Gaussians of each packet.
        payloads: Of each packet.
        rows: int64 (n, COLUMNS), as a decoder finds them.
        harmonics: int32 (n, M).
        statistics: See `empty_statistics`.
    """

    sizes: np.ndarray
    payloads: list[bytes]
    rows: np.ndarray
    harmonics: np.ndarray
    statistics: tuple[np.ndarray, np.ndarray]


def encode_block(source: BlockSource, info: SideInfo, block: int, sizes: np.ndarray, most: int) -> CodedBlock:
    """Encodes what is arranged of a block in packets of these sizes, or of at most `most` bytes if that is not 0."""
    from splatwire.codec.schemas.gaussians import _packet_kernels as kernels

    bits = int(info.boxes.bits[block])
    count, width = len(source.codes), info.num_harmonics
    rows, harmonics = empty_rows(count, width)
    buffer = np.zeros(count * (BYTES_PER_GAUSSIAN + BYTES_PER_HARMONIC * width) + kernels.SLACK, dtype=np.uint8)
    statistics, defaults = empty_statistics(), info.block_defaults[block]
    stream = (info.kernel_tables(), info.kernel_stream(), info.models(), statistics, bits, defaults, source)
    if most:
        sizes, ends = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        used = kernels.encode_cut(*stream, most, buffer, rows, harmonics, sizes, ends)
        sizes, ends = sizes[:used], ends[:used]
    else:
        ends = np.zeros(len(sizes), dtype=np.int64)
        kernels.encode_fixed(*stream, sizes, buffer, rows, harmonics, ends)
    begins = np.concatenate([[0], ends])
    payloads = [buffer[a:b].tobytes() for a, b in itertools.pairwise(begins)]
    return CodedBlock(sizes, payloads, rows, harmonics, statistics)


class GaussianEncoder:
    """See `splatwire.codec.schema.Encoder`: a run is a block.

    Args:
        scene: The Gaussians, sorted into blocks.
        plan: How they are split.
        info: Side information, as a decoder reads it.
    """

    def __init__(self, scene: SourceScene, plan: PacketPlan, info: SideInfo) -> None:
        self._scene, self._plan, self._info, p = scene, plan, info, plan.packetization
        self._most = p.packet_bytes - HEADER_BYTES if p.hashed else 0
        self._sizes = [np.zeros(0, np.int64)] * plan.num_blocks if p.hashed else _fixed_sizes(plan)

    def runs(self) -> Iterator[int]:
        """See `Encoder.runs`."""
        return iter(range(self._plan.num_blocks))

    def encode(self, run: int) -> CodedPackets:
        """See `Encoder.encode`."""
        source = self._scene.arranged(run, self._info)
        coded = encode_block(source, self._info, run, self._sizes[run], self._most)
        return CodedPackets(coded.sizes, coded.payloads, (coded.rows, coded.harmonics))


def _fixed_sizes(plan: PacketPlan) -> list[np.ndarray]:
    """Gaussians of each packet, block by block."""
    counts, blocks = plan.group_counts(), np.array([packet_id.block for packet_id in plan.ids])
    return [counts[blocks == block] for block in range(plan.num_blocks)]
