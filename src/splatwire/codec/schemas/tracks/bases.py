"""Bases of tracks: explicit Gaussians, coded as those of a still scene are, some of them with each group."""

from dataclasses import dataclass, replace

import numpy as np

from splatwire.codec.schemas.gaussians.blocks import Boxes
from splatwire.codec.schemas.gaussians.encoder import encode_block, fit_side_info
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.codec.schemas.gaussians.side_info import SideInfo, read_side_info, write_side_info
from splatwire.codec.schemas.gaussians.source_scene import SourceScene, levels_of
from splatwire.codec.threads import ordered_map
from splatwire.model import SplatCoding
from splatwire.packets import HEADER_BYTES, Packet, PacketId, Packetization, PacketPlan, make_packet
from splatwire.scene.splats import Splats

FINEST_UNIT = 28
"""`-log2` of the finest lattice, relative to the scene's size. Float32 says no more of most places; on a finer one
what moves far fits no coefficient (`layout.MAX_COEFFICIENT`) and begins anew: bytes, and a ghost where it is lost."""


@dataclass(frozen=True, eq=False)
class CodedBases:
    """Tracks that are born in a group.

    Attributes:
        order: Which of the given Gaussians each track is, in the order of the tracks, int64 (n).
        rows: Their integers, int64 (n, COLUMNS); places are in half lattice units, of the scene.
        digested: What the stream's digest takes, rows and harmonics block by block.
        packets: Their packets, of blocks from 0.
        num_blocks: How many blocks these are.
    """

    order: np.ndarray
    rows: np.ndarray
    digested: list[tuple[np.ndarray, np.ndarray]]
    packets: list[Packet]
    num_blocks: int


def span_size(count: int, block_size: int) -> int:
    """Most elements of a block of a run of so many: all are as large, see `splatwire.packets.tiers.spans_of`."""
    return -(-count // -(-count // block_size))


class BaseEncoder:
    """Codes births, group after group; steps, lattice and tables are those of the first.

    Args:
        quality: How finely they are quantised.
        packetization: How they are split.
        threads: Threads to use, which changes no bit.
    """

    def __init__(self, quality: Quality, packetization: Packetization, threads: int | None) -> None:
        self._quality, self._packetization, self._threads = quality, packetization, threads
        self._infos: list[SideInfo] = []
        self._like: SideInfo | None = None
        self._level = 0

    @property
    def info(self) -> SideInfo:
        """Side information of all bases so far."""
        boxes = [info.boxes for info in self._infos]
        joined = Boxes(
            *(np.concatenate([getattr(b, name) for b in boxes]) for name in ("shifts", "origins", "extents"))
        )
        return replace(self._infos[0], boxes=joined, defaults=np.concatenate([i.defaults for i in self._infos]))

    def fit(self, splats: Splats, classes: np.ndarray | None) -> None:
        """Fits steps, lattice and tables to other Gaussians than those of the first group; before it, see `encode`."""
        self._fitted(splats, classes)

    def encode(self, splats: Splats, classes: np.ndarray | None) -> CodedBases:
        """Codes the Gaussians that are born with a group.

        Args:
            splats: They, at least one; all can be drawn.
            classes: Class of precision of each; None for the finest in the first group, and later for a middle one.

        Raises:
            InvalidValueError: If one is too far away from the others.
        """
        source, plan, info = self._fitted(splats, classes)
        self._infos.append(info)
        return self._coded(source, plan, info)

    def _fitted(self, splats: Splats, classes: np.ndarray | None) -> tuple[SourceScene, PacketPlan, SideInfo]:
        """Gaussians in blocks, and what is told of these beside the packets."""
        size = span_size(splats.num_gaussians, self._packetization.block_size)
        plan = PacketPlan(replace(self._packetization, block_size=size), splats.num_gaussians)
        source = SourceScene.of(splats, plan, classes, None, self._quality, self._coding(splats, classes),
                                most_unit=FINEST_UNIT)  # fmt: skip
        known = None if self._like is None else self._like.transform
        fitted = fit_side_info(source, {}, known, self._like, self._threads_for(plan))
        info = read_side_info(write_side_info(fitted), plan.num_blocks)
        if self._like is None:
            self._like, self._level = info, int(np.median(source.classes))
        return source, plan, info

    def _coding(self, splats: Splats, classes: np.ndarray | None) -> SplatCoding | None:
        """How those of later groups are coded; None for the first."""
        if self._like is None:
            return None
        info, count = self._like, splats.num_gaussians
        most = self._quality.classes_of(splats.degree) - 1
        levels = np.full(count, self._level, np.uint8) if classes is None else levels_of(classes, count, most)
        transform, bases = info.transform, tuple(info.bases.tolist())
        return SplatCoding(info.size_log, info.unit, info.coarsest, bases, transform, levels)

    def _threads_for(self, plan: PacketPlan) -> int | None:
        """Waking another thread takes as long as a block."""
        return 1 if plan.num_blocks == 1 else self._threads

    def _coded(self, source: SourceScene, plan: PacketPlan, info: SideInfo) -> CodedBases:
        most = plan.packetization.packet_bytes - HEADER_BYTES

        def encode(block: int):  # type: ignore[no-untyped-def]
            return encode_block(source.arranged(block, info), info, block, np.zeros(0, np.int64), most)

        order, rows, digested, packets = [], [], [], []
        for block, coded in enumerate(ordered_map(encode, range(plan.num_blocks), self._threads_for(plan))):
            starts = np.cumsum(coded.sizes) - coded.sizes
            for start, count, payload in zip(starts.tolist(), coded.sizes.tolist(), coded.payloads, strict=True):
                packets.append(make_packet(PacketId(block, start), count, payload))
            order.append(source.ranked(block, info, coded.sizes))
            digested.append((coded.rows, coded.harmonics))
            rows.append(placed(coded.rows, info, block))
        return CodedBases(np.concatenate(order), np.concatenate(rows), digested, packets, plan.num_blocks)


def placed(rows: np.ndarray, info: SideInfo, block: int) -> np.ndarray:
    """Integers of a block with places in half lattice units of the scene, int64 (n, COLUMNS)."""
    whole = rows.copy()
    whole[:, :3] += 2 * info.boxes.corners[block]
    return whole
