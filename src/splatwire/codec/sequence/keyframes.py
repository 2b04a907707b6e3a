"""Encoder of the keyframe Gaussians of a sequence.

A track is a Gaussian that persists over frames. Its keyframe Gaussian is its initial state; motion is coded as offsets
from it.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np

from splatwire.bitstream import HEADER_BYTES, Packet, PacketId, Packetization, PacketPlan, make_packet
from splatwire.codec.gaussians.blocks import Boxes
from splatwire.codec.gaussians.encoder import encode_block, fit_side_info
from splatwire.codec.gaussians.layout import STEP_BITS
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.side_info import SideInfo, read_side_info, write_blocks, write_side_info
from splatwire.codec.gaussians.source_scene import SourceScene, to_precision_classes
from splatwire.codec.sequence.layout import MAX_COORD, MAX_LOG2_RATIO
from splatwire.codec.sequence.side_info import Shot, log2_lattice_ratio
from splatwire.codec.sequence.steps import motion_shifts
from splatwire.codec.threads import ordered_map
from splatwire.types import SplatCoding
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
MAX_KEYFRAME_LATTICE_BITS = 28
"""Maximum number of lattice bits: `-log2` of the smallest lattice spacing, relative to the scene size. Float32
positions are rarely more precise. On a finer lattice, coefficients of fast motion exceed `layout.MAX_COEFFICIENT`, and
the track needs a new keyframe Gaussian: this costs bytes, and its loss leaves a ghost (a stale Gaussian that is still
drawn).
"""
KEPT_UNIT_OCTAVES = range(-3, 11)
"""Range of lattice spacings for which a new shot keeps the unit of motion: log2 of half the spacing, in units of
motion. If the lattice is finer by more than 3 octaves, the smallest steps of motion (see `encoder.LOG_STEP_RATIOS`) are
finer than the unit.
"""
WARNED_COUNT, WARNED_SHARE = 64, 0.5
"""Warning of a lattice that is too coarse: minimum number, and minimum fraction, of the new Gaussians of a group that
are smaller than two lattice spacings. A lattice that is fitted to Gaussians is finer than this.
"""
MIN_STEP_CHANGE = 16
"""Smallest change of quantisation steps at a scene cut for which a new shot begins, octaves with `STEP_BITS` fractional
bits."""


@dataclass(frozen=True, eq=False)
class CodedKeyframes:
    """Encoded keyframe Gaussians of one group of frames.

    Attributes:
        order: Entry i is the input index of the i-th keyframe Gaussian in packet order, int64 (n).
        rows: Decoded integers of the keyframe Gaussians, int64 (n, columns). Positions are relative to their blocks.
        positions: Positions relative to the scene's origin, in units of motion, int64 (n, 3).
        block_rows: Decoded integers of each block, `rows` and harmonics, from which the stream's digest is computed.
        packets: Packets of the keyframe Gaussians; blocks are numbered from 0.
        num_blocks: Number of blocks.
    """

    order: np.ndarray
    rows: np.ndarray
    positions: np.ndarray
    block_rows: list[tuple[np.ndarray, np.ndarray]]
    packets: list[Packet]
    num_blocks: int


@dataclass(frozen=True, eq=False)
class _Fitted:
    """Gaussians that are ready to be encoded: sorted into blocks, with packet plan and side information."""

    source: SourceScene
    plan: PacketPlan
    info: SideInfo


@dataclass(frozen=True, eq=False)
class _EncodedShot:
    """Side information of one shot.

    A shot is a run of groups of frames whose keyframe Gaussians share a lattice, quantisation steps and tables.

    Attributes:
        first_group: Index of the first group.
        group_infos: Side information of each group with keyframe Gaussians.
        motion_unit_info: Side information that determines the unit of motion of the shot.
    """

    first_group: int
    group_infos: list[SideInfo]
    motion_unit_info: SideInfo


def even_block_size(count: int, block_size: int) -> int:
    """Returns the block size that divides elements evenly into as few blocks as possible.

    Args:
        count: Number of elements, at least one.
        block_size: Maximum number of elements in a block.
    """
    return -(-count // -(-count // block_size))


class KeyframeEncoder:
    """Encodes the keyframe Gaussians of a sequence, one group of frames after another.

    Args:
        quality: Quality setting.
        packetization: Parameters of the division into packets.
        threads: Number of threads; None for one per processor.
    """

    def __init__(self, quality: Quality, packetization: Packetization, threads: int | None) -> None:
        self._quality, self._packetization, self._threads = quality, packetization, threads
        self._shots: list[_EncodedShot] = []
        self._template: SideInfo | None = None
        self._warned = False
        self._median_class = 0

    @property
    def shots(self) -> tuple[Shot, ...]:
        """Side information of the keyframe Gaussians encoded so far, one entry for each shot.

        A shot is a range of groups of frames that share quantisation steps and probability tables. A scene cut may
        begin a new shot.
        """
        shots, block = list[Shot](), 0
        for shot in self._shots:
            infos = shot.group_infos
            boxes = [info.boxes for info in infos]
            joined = Boxes(
                *(np.concatenate([getattr(b, name) for b in boxes]) for name in ("shifts", "grid_corners", "extents"))
            )
            info = replace(infos[0], boxes=joined, block_means=np.concatenate([i.block_means for i in infos]))
            shots.append(Shot(shot.first_group, block, info, self._log2_ratio_to_first(shot.motion_unit_info)))
            block += len(info.block_means)
        return tuple(shots)

    @property
    def motion_unit_info(self) -> SideInfo:
        """Side information that determines the unit of motion in the current shot (see `shots`).

        The unit of motion is half the lattice spacing in this side information. The shot of the side information is the
        current one, or an earlier one whose unit the current shot keeps: the current lattice may be up to 8 times finer
        or 1,024 times coarser (`KEPT_UNIT_OCTAVES`).
        """
        return self._shots[-1].motion_unit_info

    @property
    def log2_motion_unit(self) -> int:
        """log2 of the ratio of the unit of motion in the current shot to the unit of motion in the first shot.

        A shot is a range of groups of frames that share a lattice, quantisation steps and tables; a scene cut may begin
        a new shot.
        """
        return self._log2_ratio_to_first(self.motion_unit_info) if self._shots else 0

    def _log2_ratio_to_first(self, info: SideInfo) -> int:
        return log2_lattice_ratio(info, self._shots[0].group_infos[0])

    def shifts_of(self, rows: np.ndarray, log_step_ratios: np.ndarray) -> np.ndarray:
        """Returns log2 of the quantisation steps of the motion of tracks (Gaussians over time), int64 (n, channels).

        Args:
            rows: Decoded integers of the tracks' keyframe Gaussians, int64 (n, columns).
            log_step_ratios: For each kind of channel, log2 of the ratio of the quantisation steps of motion to those of
                the keyframe Gaussian, int64 (kinds).
        """
        info = self._shots[-1].group_infos[-1]
        return motion_shifts(rows, info, log_step_ratios, log2_lattice_ratio(info, self.motion_unit_info))

    def encode(
        self, splats: Splats, class_offsets: np.ndarray | None, group: int, *, cut: bool = False
    ) -> CodedKeyframes:
        """Encodes the keyframe Gaussians of a group of frames.

        Args:
            splats: The Gaussians, at least one; each must have a visible effect.
            class_offsets: Class offset of each Gaussian, which selects its quantisation steps: 0 for the finest
                steps, negative for coarser ones; None for a default.
            group: Index of the group of frames.
            cut: True if another scene begins in the group.

        Raises:
            InvalidValueError: If a Gaussian is too far away from the others.
        """
        size = even_block_size(splats.num_gaussians, self._packetization.block_size)
        plan = PacketPlan(replace(self._packetization, block_size=size), splats.num_gaussians)
        template, median_class = self._template, self._median_class
        if template is None:
            return self._begin_shot(self._fit(splats, class_offsets, plan, None, None), group)
        if cut:
            refitted = self._fit(splats, class_offsets, plan, None, None)
            if self._needs_new_shot(refitted.info):
                return self._begin_shot(refitted, group)
        coding = self._shot_coding(splats, class_offsets, template, median_class)
        self._warn_of_coarse_lattice(splats, template)
        continued = self._fit(splats, class_offsets, plan, coding, template)
        coded = self._encode_fitted(continued)
        if cut:
            refitted = self._fit(splats, class_offsets, plan, coding, None)
            new_shot_bytes = _num_bytes(self._encode_fitted(refitted)) + len(write_side_info(refitted.info))
            if new_shot_bytes < _num_bytes(coded) + len(write_blocks(continued.info.boxes, continued.info.block_means)):
                return self._begin_shot(refitted, group)
        self._shots[-1].group_infos.append(continued.info)
        return coded

    def _warn_of_coarse_lattice(self, splats: Splats, info: SideInfo) -> None:
        """Logs a warning once if most Gaussians of a group are too small for the position lattice of `info`."""
        spacing = float(np.ldexp(1.0, info.size_log - info.lattice_bits))
        small = int((splats.scales.max(axis=1) < 2 * spacing).sum())
        if self._warned or small < max(WARNED_COUNT, WARNED_SHARE * splats.num_gaussians):
            return
        self._warned = True
        LOG.warning(
            "%s of %s new Gaussians are smaller than two steps of their positions (a step is %.3g): earlier frames "
            "show a scene that is far larger. Encode the scenes as separate clips",
            f"{small:,}", f"{splats.num_gaussians:,}", spacing,
        )  # fmt: skip

    def _begin_shot(self, fitted: "_Fitted", group: int) -> CodedKeyframes:
        """Starts a new shot (see `shots`), and encodes the keyframe Gaussians of its first group of frames.

        Args:
            fitted: The keyframe Gaussians, with quantisation steps and probability tables of the new shot.
            group: Index of the group of frames.
        """
        keeps_unit = self._shots and log2_lattice_ratio(fitted.info, self.motion_unit_info) in KEPT_UNIT_OCTAVES
        motion_unit_info = self.motion_unit_info if keeps_unit else fitted.info
        self._shots.append(_EncodedShot(group, [fitted.info], motion_unit_info))
        self._template, self._median_class = fitted.info, int(np.median(fitted.source.precision_classes))
        return self._encode_fitted(fitted)

    def _needs_new_shot(self, info: SideInfo) -> bool:
        """True if the quantisation steps of `info` differ enough from those of the current shot to begin a new shot.

        If the units of motion differ by more than the format allows (`MAX_LOG2_RATIO`), no new shot can begin, and
        the result is False.
        """
        assert self._template is not None
        step_change = np.abs(info.base_exponents - self._template.base_exponents).max() + (
            abs(info.size_log - self._template.size_log) << STEP_BITS
        )
        return bool(step_change >= MIN_STEP_CHANGE) and abs(self._log2_ratio_to_first(info)) <= MAX_LOG2_RATIO

    def _fit(
        self, splats: Splats, class_offsets: np.ndarray | None, plan: PacketPlan, coding: SplatCoding | None,
        template: SideInfo | None,
    ) -> "_Fitted":  # fmt: skip
        """Sorts Gaussians into blocks and computes their side information.

        Args:
            splats: The Gaussians.
            class_offsets: Class offset of each Gaussian, which selects its quantisation steps: 0 for the finest
                steps, negative for coarser ones; None for the finest steps.
            plan: Packet plan of the Gaussians.
            coding: Quantisation parameters; None to choose them.
            template: Side information with probability tables to use; None to fit new tables.
        """
        source = SourceScene.of(
            splats, plan, class_offsets, None, self._quality, coding, max_lattice_bits=MAX_KEYFRAME_LATTICE_BITS
        )
        fixed_transform = None if coding is None else coding.transform
        fitted = fit_side_info(source, {}, fixed_transform, template, self._threads_for(plan))
        return _Fitted(source, plan, read_side_info(write_side_info(fitted), plan.num_blocks))

    def _shot_coding(
        self, splats: Splats, class_offsets: np.ndarray | None, info: SideInfo, median_class: int
    ) -> SplatCoding:
        """Returns the quantisation parameters of the current shot for further Gaussians.

        A shot is a range of groups of frames that share these parameters; a scene cut may begin a new shot.

        Args:
            splats: The Gaussians to encode.
            class_offsets: Class offset of each Gaussian, which selects its quantisation steps: 0 for the finest
                steps, negative for coarser ones; None to use `median_class` for all.
            info: Side information of the shot.
            median_class: Median precision class of the shot's first Gaussians, in the numbering of the bitstream (0 is
                the coarsest).
        """
        count, finest_class = splats.num_gaussians, self._quality.num_classes(splats.degree) - 1
        precision_classes = (
            np.full(count, median_class, np.uint8)
            if class_offsets is None
            else to_precision_classes(class_offsets, count, finest_class)
        )
        transform, base_exponents = info.transform, tuple(info.base_exponents.tolist())
        return SplatCoding(
            info.size_log, info.lattice_bits, info.max_position_shift, base_exponents, transform, precision_classes
        )

    def _threads_for(self, plan: PacketPlan) -> int | None:
        """Returns the number of threads that encode the blocks of a packet plan; None for all cores."""
        # Starting a second thread takes as long as encoding a block.
        return 1 if plan.num_blocks == 1 else self._threads

    def _encode_fitted(self, fitted: "_Fitted") -> CodedKeyframes:
        source, plan, info = fitted.source, fitted.plan, fitted.info
        max_payload_bytes = plan.packetization.packet_bytes - HEADER_BYTES

        def encode(block: int):  # type: ignore[no-untyped-def]
            return encode_block(source.block_source(block, info), info, block, np.zeros(0, np.int64), max_payload_bytes)

        order, rows, positions, block_rows, packets = [], [], [], [], []
        lattice_shift = log2_lattice_ratio(info, self.motion_unit_info)
        for block, coded in enumerate(ordered_map(encode, range(plan.num_blocks), self._threads_for(plan))):
            starts = np.cumsum(coded.counts) - coded.counts
            for start, count, payload in zip(starts.tolist(), coded.counts.tolist(), coded.payloads, strict=True):
                packets.append(make_packet(PacketId(block, start), count, payload))
            order.append(source.packet_order(block, info, coded.counts))
            block_rows.append((coded.rows, coded.harmonic_rows))
            rows.append(coded.rows)
            positions.append(to_motion_units(coded.rows, info, block, lattice_shift))
        return CodedKeyframes(
            np.concatenate(order),
            np.concatenate(rows),
            np.concatenate(positions),
            block_rows,
            packets,
            plan.num_blocks,
        )


def _num_bytes(coded: CodedKeyframes) -> int:
    return sum(packet.num_bytes for packet in coded.packets)


def to_motion_units(rows: np.ndarray, info: SideInfo, block: int, lattice_shift: int) -> np.ndarray:
    """Converts the positions of a block's Gaussians to the unit of motion.

    Args:
        rows: Decoded integers of a block's Gaussians, int64 (n, columns), with positions in halves of the lattice
            spacing.
        info: Side information with the bounding boxes of blocks.
        block: Index of the block in the side information.
        lattice_shift: log2 of the ratio of half the lattice spacing to the unit of motion.

    Returns:
        Positions in the unit of motion, int64 (n, 3).
    """
    positions = rows[:, :3] + 2 * info.boxes.corners[block]
    scaled = positions << lattice_shift if lattice_shift > 0 else positions >> -lattice_shift
    return np.clip(scaled, -MAX_COORD, MAX_COORD)
