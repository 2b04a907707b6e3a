"""Encoder of the keyframe Gaussians of a sequence.

A track is a Gaussian that persists over frames. Its keyframe Gaussian is its state in the first frame of the group of
frames where it begins, and is coded like an explicit Gaussian. Motion is then coded as offsets from it.
"""

from dataclasses import dataclass, replace

import numpy as np

from splatwire.bitstream import HEADER_BYTES, Packet, PacketId, Packetization, PacketPlan, make_packet
from splatwire.codec.gaussians.blocks import Boxes
from splatwire.codec.gaussians.encoder import encode_block, fit_side_info
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.side_info import SideInfo, read_side_info, write_side_info
from splatwire.codec.gaussians.source_scene import SourceScene, levels_of
from splatwire.codec.threads import ordered_map
from splatwire.types import SplatCoding
from splatwire.types.splats import Splats

FINEST_UNIT = 28
"""`-log2` of the smallest lattice spacing, relative to the scene's size. Float32 positions are rarely more precise. On
a finer lattice, coefficients of fast motion exceed `layout.MAX_COEFFICIENT`, and the track needs a new base: this costs
bytes, and its loss leaves a ghost (a stale Gaussian that is still drawn).
"""


@dataclass(frozen=True, eq=False)
class CodedKeyframes:
    """Encoded keyframe Gaussians of one group of frames.

    Attributes:
        order: Index in the encoder's input of each keyframe Gaussian, in coding order, int64 (n).
        rows: Decoded integers of the keyframe Gaussians, int64 (n, COLUMNS). Positions are relative to the scene's
            origin, in half lattice units.
        digested: Decoded integers of each block, from which the stream's digest is computed. Each block has two arrays
            (`gaussians.attributes.empty_rows`): first all attributes except spherical harmonics, then the harmonics.
        packets: Packets of the keyframe Gaussians; blocks are numbered from 0.
        num_blocks: Number of blocks.
    """

    order: np.ndarray
    rows: np.ndarray
    digested: list[tuple[np.ndarray, np.ndarray]]
    packets: list[Packet]
    num_blocks: int


def span_size(count: int, block_size: int) -> int:
    """Returns the block size with which elements are divided into as few blocks as possible, of nearly equal size.

    Args:
        count: Number of elements, at least one.
        block_size: Maximum number of elements in a block.
    """
    return -(-count // -(-count // block_size))


class KeyframeEncoder:
    """Encodes the keyframe Gaussians of a sequence, one group of frames after another.

    Quantisation steps, lattice and context tables are fitted to the first group and used for all groups.

    Args:
        quality: Quality setting.
        packetization: Parameters of the division into packets.
        threads: Number of threads, which does not affect the result; None for one per processor.
    """

    def __init__(self, quality: Quality, packetization: Packetization, threads: int | None) -> None:
        self._quality, self._packetization, self._threads = quality, packetization, threads
        self._infos: list[SideInfo] = []
        self._like: SideInfo | None = None
        self._level = 0

    @property
    def info(self) -> SideInfo:
        """Side information of all keyframe Gaussians encoded so far."""
        boxes = [info.boxes for info in self._infos]
        joined = Boxes(
            *(np.concatenate([getattr(b, name) for b in boxes]) for name in ("shifts", "origins", "extents"))
        )
        return replace(self._infos[0], boxes=joined, defaults=np.concatenate([i.defaults for i in self._infos]))

    def fit(self, splats: Splats, classes: np.ndarray | None) -> None:
        """Fits quantisation steps, lattice and context tables to the given Gaussians.

        Call this before the first `encode`, which otherwise fits them to the Gaussians of the first group.

        Args:
            splats: The Gaussians to fit to.
            classes: Precision class of each Gaussian, 0 for the finest and negative for coarser; None for the finest.
        """
        self._fitted(splats, classes)

    def encode(self, splats: Splats, classes: np.ndarray | None) -> CodedKeyframes:
        """Encodes the keyframe Gaussians of a group of frames.

        Args:
            splats: The Gaussians, at least one; each must have a visible effect.
            classes: Precision class of each Gaussian, 0 for the finest and negative for coarser. None for the finest
                class in the first group, and for a medium class in later groups.

        Raises:
            InvalidValueError: If a Gaussian is too far away from the others.
        """
        source, plan, info = self._fitted(splats, classes)
        self._infos.append(info)
        return self._coded(source, plan, info)

    def _fitted(self, splats: Splats, classes: np.ndarray | None) -> tuple[SourceScene, PacketPlan, SideInfo]:
        """Sorts Gaussians into blocks and computes their side information.

        The first call fits quantisation steps and context tables, and later calls use them again.
        """
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
        """Returns the quantisation parameters that were fitted to earlier Gaussians; None if none were fitted yet.

        Args:
            splats: The Gaussians to encode.
            classes: Precision class of each Gaussian, 0 for the finest and negative for coarser; None for a medium
                class.
        """
        if self._like is None:
            return None
        info, count = self._like, splats.num_gaussians
        most = self._quality.num_classes(splats.degree) - 1
        levels = np.full(count, self._level, np.uint8) if classes is None else levels_of(classes, count, most)
        transform, bases = info.transform, tuple(info.bases.tolist())
        return SplatCoding(info.size_log, info.unit, info.coarsest, bases, transform, levels)

    def _threads_for(self, plan: PacketPlan) -> int | None:
        """Returns the number of threads for a packet plan.

        A single block gets one thread, because starting a second thread takes as long as encoding a block.
        """
        return 1 if plan.num_blocks == 1 else self._threads

    def _coded(self, source: SourceScene, plan: PacketPlan, info: SideInfo) -> CodedKeyframes:
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
            rows.append(to_scene_positions(coded.rows, info, block))
        return CodedKeyframes(np.concatenate(order), np.concatenate(rows), digested, packets, plan.num_blocks)


def to_scene_positions(rows: np.ndarray, info: SideInfo, block: int) -> np.ndarray:
    """Converts the positions of a block's Gaussians from coordinates relative to the block to scene coordinates.

    Args:
        rows: Decoded integers of a block's Gaussians, int64 (n, COLUMNS), with positions in half lattice units.
        info: Side information with the bounding boxes of blocks.
        block: Index of the block.

    Returns:
        The integers with converted positions, int64 (n, COLUMNS).
    """
    whole = rows.copy()
    whole[:, :3] += 2 * info.boxes.corners[block]
    return whole
