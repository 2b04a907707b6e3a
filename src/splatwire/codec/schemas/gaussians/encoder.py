"""Gaussians to stream."""

import hashlib
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from splatwire.codec.background import background_sections
from splatwire.codec.schemas.gaussians.attributes import (
    Sources,
    check_finite,
    empty_rows,
    fit_transform,
    scene_log,
    to_sources,
    transformed,
)
from splatwire.codec.schemas.gaussians.blocks import (
    arrange_block,
    block_codes,
    block_sizes,
    cell_shift,
    gaussian_order,
    make_boxes,
    to_lattice,
)
from splatwire.codec.schemas.gaussians.digest import update_digest
from splatwire.codec.schemas.gaussians.fit import empty_statistics, first_scales, fit_bits, fit_scales
from splatwire.codec.schemas.gaussians.layout import (
    BITS,
    COEFFICIENTS,
    MAX_CELL_BITS,
    MAX_LATTICE_BITS,
    NUM_CONTEXTS,
    S_POSITION,
    STEP_BITS,
)
from splatwire.codec.schemas.gaussians.quality import QUALITIES, Quality
from splatwire.codec.schemas.gaussians.side_info import DEFAULT_SHIFT, SideInfo, read_side_info, write_side_info
from splatwire.codec.threads import ordered_map
from splatwire.codec.tiers import SECTION as TIERS
from splatwire.codec.tiers import encode_tiers
from splatwire.errors import InvalidValueError
from splatwire.packets import (
    GAUSSIANS,
    HEADER_BYTES,
    Packet,
    Packetization,
    PacketPlan,
    SceneStream,
    make_packet,
    make_stream,
    shape_tiers,
)
from splatwire.scene.background import BLACK, Background
from splatwire.scene.splats import Splats
from splatwire.version import __version__

FITTED_BLOCKS = 48
"""Tables are fitted to at most so many blocks, spread over the scene."""
FITTED_PACKET = 150
"""Gaussians of a packet while tables are fitted."""
SPREAD_OVER = 3000
"""A packet is spread over about so many Gaussians."""
BYTES_PER_GAUSSIAN = 160
BYTES_PER_HARMONIC = 12


def encode_splats(
    splats: Splats,
    packetization: Packetization,
    *,
    background: Background = BLACK,
    classes: np.ndarray | None = None,
    quality: Quality = QUALITIES["default"],
    tiers: np.ndarray | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> SceneStream:
    """Encodes Gaussians into independently decodable packets.

    Which Gaussian is at which place of the stream is the encoder's choice: places travel in packets.

    Args:
        splats: The Gaussians.
        packetization: How they are split.
        background: RGB behind them.
        classes: Class of precision of each, 0 for the finest and an octave of steps coarser for each below
            (`precision_classes`); None for the finest everywhere.
        quality: How finely they are quantised.
        tiers: Tier of each, 0 for the most important; None for one tier.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        The complete stream.

    Raises:
        InvalidValueError: If there is nothing to encode, values are not finite, or the packetization is not for this.
    """
    check_finite(splats)
    if packetization.separated or packetization.order != "morton":
        raise InvalidValueError("Gaussians travel whole and in Morton order: no separated packaging, no raster order")
    shapes = shape_tiers(tiers, packetization) if tiers is not None else ()
    plan = PacketPlan(packetization, splats.num_gaussians, shapes)
    scene = _Scene.of(splats, plan, classes, tiers if shapes else None, quality)
    sections = dict(background_sections(background))
    if shapes:
        sections[TIERS] = encode_tiers(np.repeat(np.arange(len(shapes)), [s.num_anchors for s in shapes]), len(shapes))
    side_info = write_side_info(_fit(scene, sections, threads))
    # Predict from what a decoder will read, not from what was meant.
    info = read_side_info(side_info, plan.num_blocks)
    packets, digest = _encode_packets(scene, plan, info, threads, progress)
    return make_stream(
        packetization=packetization, num_anchors=plan.num_anchors, side_info=side_info, packets=packets,
        symbols_digest=digest, writer=f"splatwire {__version__}", tiers=plan.tiers, codec=GAUSSIANS,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Scene:
    """Gaussians sorted into blocks; a block's integers are made when they are needed."""

    splats: Splats
    order: np.ndarray
    edges: np.ndarray
    places: np.ndarray
    classes: np.ndarray
    size_log: int
    unit: int
    bases: np.ndarray
    contiguous: bool

    @staticmethod
    def of(
        splats: Splats, plan: PacketPlan, classes: np.ndarray | None, tiers: np.ndarray | None, quality: Quality
    ) -> "_Scene":
        means, size_log = splats.means.numpy().astype(np.float64), scene_log(splats)
        order, bases = gaussian_order(means, tiers), quality.bases(splats.degree)
        found = np.zeros(len(order), np.int64) if classes is None else np.asarray(classes).astype(np.int64)
        if found.shape != order.shape:
            raise InvalidValueError(f"{found.shape} classes of precision for {len(order)} Gaussians")
        levels = np.clip(found + quality.classes - 1, 0, quality.classes - 1)
        unit = _lattice_unit(splats, levels, bases, size_log)
        edges = np.concatenate([[0], np.cumsum(block_sizes(plan))]).astype(np.int64)
        return _Scene(
            splats,
            order,
            edges,
            to_lattice(means[order], unit, size_log),
            levels[order],
            size_log,
            unit,
            bases,
            plan.packetization.grouping == "contiguous",
        )

    @property
    def num_blocks(self) -> int:
        return len(self.edges) - 1

    def some_blocks(self) -> list[int]:
        """Blocks that tables are fitted to."""
        return np.unique(np.linspace(0, self.num_blocks - 1, min(self.num_blocks, FITTED_BLOCKS)).astype(int)).tolist()

    def sources(self, block: int) -> Sources:
        """What a block's Gaussians are quantised from, as they come in `order`."""
        index = self.order[self.edges[block] : self.edges[block + 1]]
        return to_sources(self.splats.select(torch.from_numpy(index)), self.size_log)

    def arranged(self, block: int, info: SideInfo) -> tuple[Any, ...]:
        """What the kernels encode of a block, in the order in which packets are filled."""
        here, bits = slice(self.edges[block], self.edges[block + 1]), int(info.boxes.bits[block])
        places = self.places[here] - info.boxes.corners[block]
        codes, at = block_codes(places, bits), cell_shift(places, bits)
        by = arrange_block(codes >> 3 * (at - max(bits - MAX_CELL_BITS, 0)), 0 if self.contiguous else SPREAD_OVER)
        s = self.sources(block).select(by)
        return (
            np.int64(at),
            np.int64(not self.contiguous),
            codes[by],
            places[by],
            self.classes[here][by],
            s.logs,
            s.axes,
            s.colours,
            transformed(s.harmonics, info.transform),
        )


def _lattice_unit(splats: Splats, levels: np.ndarray, bases: np.ndarray, size_log: int) -> int:
    """A lattice as fine as the finest step of a place."""
    logs = np.sort(np.log2(splats.scales.numpy().astype(np.float64)), axis=1) - size_log
    c, octaves = COEFFICIENTS[S_POSITION] / (1 << STEP_BITS), bases[S_POSITION] / (1 << STEP_BITS)
    finest = octaves + levels + c[0] * (logs[:, 2] + logs[:, 1]) + c[1] * (logs[:, 2] - logs[:, 1])
    finest = np.maximum(finest, 1 - logs[:, 1])
    far = np.log2(np.abs(splats.means.numpy().astype(np.float64)).max() + 1e-30) - size_log
    return int(np.clip(np.ceil(finest.max()), 0, max(min(MAX_LATTICE_BITS - 2 - np.ceil(far), 38), 0)))


def _defaults(sources: Sources) -> np.ndarray:
    """Means of opacity, scales as they are sent, and colour, in sixteenths."""
    logs = sources.logs.astype(np.float64)
    ratio = (logs[:, 2] - logs[:, 3]) / (1 << BITS)
    thin = (1 - 2.0**-ratio) / np.log(2) * (1 << BITS)
    values = np.stack([logs[:, 0], logs[:, 1], logs[:, 1] - logs[:, 2], thin], axis=1)
    means = np.concatenate([values.mean(axis=0), sources.colours.mean(axis=0)])
    return np.rint(means / (1 << DEFAULT_SHIFT)).astype(np.int64)


def _fit(scene: _Scene, sections: Mapping[str, bytes], threads: int | None) -> SideInfo:
    """Side information: boxes and means of blocks, and tables fitted to a part of the scene."""
    boxes = make_boxes(scene.places, np.diff(scene.edges))
    means = list(ordered_map(lambda block: _defaults(scene.sources(block)), range(scene.num_blocks), threads))
    zero = np.full(NUM_CONTEXTS, 128, dtype=np.int64)
    transform = _transform(scene)
    fields = (scene.splats.degree, scene.size_log, scene.unit, scene.bases, transform, boxes, np.clip(means, -511, 511))
    first, (bits, residuals) = SideInfo(*fields, zero, first_scales()), empty_statistics()

    def count(block: int) -> tuple[np.ndarray, np.ndarray]:
        size = int(scene.edges[block + 1] - scene.edges[block])
        parts = -(-size // FITTED_PACKET)
        sizes = np.diff(np.arange(parts + 1) * size // parts)
        return _encode_block(scene, first, block, sizes, 0).statistics

    for some_bits, some_residuals in ordered_map(count, scene.some_blocks(), threads):
        bits += some_bits
        residuals += some_residuals
    return SideInfo(*fields, fit_bits(bits), fit_scales(residuals), sections)


def _transform(scene: _Scene) -> np.ndarray:
    """Transform of the harmonics, fitted to a part of the scene in units of steps."""
    if not scene.splats.degree:
        return np.zeros((0, 0), dtype=np.int64)
    blocks = scene.some_blocks()
    weights = np.concatenate([2.0 ** scene.classes[scene.edges[b] : scene.edges[b + 1]] for b in blocks])
    return fit_transform(np.concatenate([scene.sources(b).harmonics for b in blocks]), weights)


@dataclass(frozen=True, eq=False)
class _Block:
    """What encoding a block gave."""

    sizes: np.ndarray
    payloads: list[bytes]
    rows: np.ndarray
    harmonics: np.ndarray
    statistics: tuple[np.ndarray, np.ndarray]


def _encode_block(scene: _Scene, info: SideInfo, block: int, sizes: np.ndarray, most: int) -> _Block:
    """Encodes a block in packets of the given sizes, or, if `most` is not 0, of at most so many bytes."""
    from splatwire.codec.schemas.gaussians import _packet_kernels as kernels

    bits = int(info.boxes.bits[block])
    source = scene.arranged(block, info)
    count, width = len(source[2]), info.num_harmonics
    rows, harmonics = empty_rows(count, width)
    buffer = np.zeros(count * (BYTES_PER_GAUSSIAN + BYTES_PER_HARMONIC * width) + kernels.SLACK, dtype=np.uint8)
    statistics, defaults = empty_statistics(), info.block_defaults()[block]
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
    return _Block(sizes, payloads, rows, harmonics, statistics)


def _encode_packets(
    scene: _Scene, plan: PacketPlan, info: SideInfo, threads: int | None, progress: Callable[[float], None] | None
) -> tuple[list[Packet], str]:
    """All packets in the order of the plan, and the digest of what they hold."""
    p, digest, packets = plan.packetization, hashlib.sha256(), list[Packet]()
    most = p.packet_bytes - HEADER_BYTES if p.hashed else 0
    sizes = [np.zeros(0, np.int64)] * plan.num_blocks if p.hashed else _fixed_sizes(plan)

    def encode(block: int) -> _Block:
        return _encode_block(scene, info, block, sizes[block], most)

    ids = iter(() if p.hashed else plan.ids)
    first = 0
    for block, coded in enumerate(ordered_map(encode, range(plan.num_blocks), threads)):
        update_digest(digest, coded.rows, coded.harmonics)
        for size, payload in zip(coded.sizes.tolist(), coded.payloads, strict=True):
            packets.append(make_packet(plan.name_hashed(first) if p.hashed else next(ids), size, payload))
            first += size
        if progress:
            progress((block + 1) / plan.num_blocks)
    for packet in packets:
        if p.hashed and packet.num_bytes > p.packet_bytes:
            raise InvalidValueError(
                f"a Gaussian of this scene takes {packet.num_bytes} bytes, a packet holds {p.packet_bytes}: "
                "choose a larger packet size or another preset"
            )
    return packets, digest.hexdigest()


def _fixed_sizes(plan: PacketPlan) -> list[np.ndarray]:
    """Gaussians of each packet, block by block."""
    counts, blocks = np.diff(plan.groups().starts), np.array([packet_id.block for packet_id in plan.ids])
    return [counts[blocks == block] for block in range(plan.num_blocks)]
