"""Decoder of explicit Gaussians."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splatwire.bitstream import GAUSSIANS, Manifest, Packet
from splatwire.bitstream.limits import LEVELS, MAX_BLOCK_SIZE, UPDATE
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.gaussians import _packet_kernels as kernels
from splatwire.codec.gaussians.attributes import empty_rows, fill_splats, update_digest
from splatwire.codec.gaussians.blocks import CACHE_GAUSSIANS
from splatwire.codec.gaussians.copies import read_copies
from splatwire.codec.gaussians.layout import (
    AXIS,
    CLASS,
    COLUMNS,
    DIRECTION_BITS,
    ELONGATION,
    FLATNESS,
    LUMA,
    MAX_COLOUR,
    MAX_COMPANDED,
    MAX_LOG,
    POSITION,
    SCALE0,
)
from splatwire.codec.gaussians.side_info import SideInfo, read_side_info
from splatwire.codec.memory import packet_reader_bytes
from splatwire.codec.metadata import read_metadata
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.schema import DecodedRows, PacketBatch
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.types import LossMask, ReceivedScene, SplatCoding, SplatScene
from splatwire.types.splats import Splats

_GOLDEN = np.array([0.8191725134, 0.6710436067, 0.5497004779])
"""Multiples of these numbers, modulo 1, fill a unit cube evenly (R-sequence, generalised golden ratio; Roberts, 2018).
"""


class GaussianDecoder:
    """Decodes packets of explicit Gaussians to a scene; implements `splatwire.codec.schema.Decoder`.

    Lost Gaussians get opacity 0. Their positions, scales and base colours are estimated.

    Args:
        manifest: The stream's manifest.
        side_info: The stream's side information, serialised.
        num_bytes: Number of received bytes of the stream; not used, but all decoders have this parameter.

    Raises:
        MissingSideInfoError: If the side information is empty.
        BitstreamError: If the side information is damaged or contradicts the manifest.
    """

    order: np.ndarray | None = None
    batches_are_blocks, packets_independent, redecode_on_demand = True, True, False

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        info = open_side_info(manifest, side_info)
        self._info, self._plan, self._num, self.sections = info, manifest.plan, manifest.num_elements, info.sections
        self.scene_bytes = self._num * (4 * (11 + 3 * (info.degree + 1) ** 2) + 8)
        self.row_bytes = 8 * int(COLUMNS) + 4 * info.num_harmonic_columns
        copies = read_copies(info, self._num)
        self._records = () if copies is None else (copies,)

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        """Returns the memory that each decoding thread needs in addition to the scene, bytes."""
        # Integers of several pending blocks, floats of `CACHE_GAUSSIANS` Gaussians, and words of the largest packet.
        spans = (span for span in self._plan.spans if span.num_elements)
        largest = max((self._plan.block_elements(span.first_block) for span in spans), default=0)
        return largest * (4 * self.row_bytes + 64) + (4 << 20) + packet_reader_bytes(packets)

    def allocate(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        """Allocates the arrays of the scene, and marks all Gaussians as not received.

        Args:
            threads: Not used.
            progress: Not used.
        """
        self._splats = blank_splats(self._num, self._info.degree)
        self._precision_classes = np.zeros(self._num, dtype=np.uint8)
        self._loss_mask = LossMask.of_elements(np.zeros(self._num, dtype=np.bool_))

    def decode(self, batch: PacketBatch) -> DecodedRows:
        """Decodes the received packets of one spatial block to integers.

        Args:
            batch: The packets.

        Returns:
            Two arrays with a row for each Gaussian, packet by packet: all attributes except spherical harmonics, int64
            (n, columns), and the harmonics, int32 (n, harmonics).
        """
        return decode_packets(self._info, batch.block, batch.counts, batch.payloads)

    def store(self, batch: PacketBatch, rows: DecodedRows) -> None:
        """Writes the Gaussians of a block to the scene as floats; lost Gaussians get estimated attributes.

        Args:
            batch: Received packets of the block.
            rows: Result of `decode` for these packets.
        """
        indices, received_mask = batch.indices, self._loss_mask.received
        received_mask[indices] = True
        if len(indices) < self._plan.block_elements(batch.block):
            indices = self._plan.block_indices(batch.block)
        received = received_mask[indices, 0]  # Gaussians are received as a whole
        if not received.all():
            all_rows = empty_rows(len(indices), self._info.num_harmonic_columns)
            for filled, received_rows in zip(all_rows, rows, strict=True):
                filled[received] = received_rows
            rows = all_rows
        store_block(self._splats, indices, rows[0], rows[1], received, self._info, batch.block)
        if received.any():
            self._precision_classes[indices] = rows[0][:, CLASS].astype(np.uint8)

    def update_digest(self, digest: Any, rows: DecodedRows) -> None:
        """Adds the decoded integers of one block to a hash, with which receivers verify their decoding."""
        update_digest(digest, rows)

    def scene(self) -> ReceivedScene[SplatScene]:
        """Returns the scene decoded so far, with the mask of received Gaussians and the stream's metadata.

        The scene shares memory with the arrays that `store` fills.
        """
        scene = SplatScene(
            self._splats,
            background=BACKGROUND_SECTION.read(self.sections),
            coding=coding_of(self._info, self._precision_classes),
            antialiased=ANTIALIASED in self.sections,
            origin=ORIGIN_SECTION.read(self.sections),
            metadata=read_metadata(self.sections),
        )
        return ReceivedScene(scene, self._loss_mask, concealer_sections(self.sections), self._records)


def coding_of(info: SideInfo, precision_classes: np.ndarray) -> SplatCoding | None:
    """Returns the quantisation parameters with which a decoded scene can be encoded again without loss.

    Args:
        info: The stream's side information.
        precision_classes: Precision class of each Gaussian, which selects its quantisation steps, uint8 (N).

    Returns:
        The parameters; None for side information of version 2, whose integers depend on the division into packets.
    """
    if info.packet_dependent:
        return None
    return SplatCoding(
        info.size_log,
        info.lattice_bits,
        info.max_position_shift,
        tuple(info.base_exponents.tolist()),
        info.transform,
        precision_classes,
    )


def open_side_info(manifest: Manifest, side_info: bytes) -> SideInfo:
    """Reads the side information of a stream of explicit Gaussians.

    Args:
        manifest: The stream's manifest.
        side_info: The side information, serialised.

    Raises:
        MissingSideInfoError: If the side information is empty.
        BitstreamError: If the side information is damaged, or the stream does not contain explicit Gaussians.
    """
    if manifest.schema_name not in (GAUSSIANS, LEVELS, UPDATE) or manifest.packetization.separated:
        raise BitstreamError("the stream does not hold whole Gaussians")
    if not side_info:
        raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
    return read_side_info(side_info, manifest.plan.num_blocks)


def decode_packets(
    info: SideInfo, block: int, counts: np.ndarray, payloads: Sequence[bytes]
) -> tuple[np.ndarray, np.ndarray]:
    """Decodes packets of one block to integers.

    Args:
        info: The stream's side information.
        block: Index of the spatial block.
        counts: int64 (packets), number of Gaussians in each packet.
        payloads: Content of each packet without its header.

    Returns:
        Two arrays with a row for each Gaussian, packet by packet. The first has the decoded integers of all attributes
        except harmonics, int64 (n, columns). The second has those of the spherical harmonics, int32 (n, harmonics).
    """
    assert max(counts, default=0) <= MAX_BLOCK_SIZE, "a packet has fewer than 2**16 Gaussians"
    data = np.frombuffer(b"".join(payloads), dtype=np.uint8).copy()
    byte_starts = np.concatenate([[0], np.cumsum([len(payload) for payload in payloads])]).astype(np.int64)
    gaussian_starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    # Any bytes decode without an error.
    rows, harmonics = empty_rows(int(gaussian_starts[-1]), info.num_harmonic_columns)
    box_bits = np.full(len(payloads), info.boxes.bits[block])
    block_means = np.repeat(info.block_means[block : block + 1], len(payloads), axis=0)
    kernels.decode_packets(
        info.kernel_tables, info.step_parameters(), info.models(), data, byte_starts, gaussian_starts, box_bits,
        block_means, rows, harmonics,
    )  # fmt: skip
    return rows, harmonics


def blank_splats(count: int, degree: int) -> Splats:
    """Allocates `count` Gaussians with spherical harmonics of the given degree, all attributes zero."""
    return Splats(*(np.zeros((count, *shape), np.float32) for shape in ((3,), (4,), (3,), (), ((degree + 1) ** 2, 3))))


def store_block(
    splats: Splats,
    indices: np.ndarray,
    rows: np.ndarray,
    harmonics: np.ndarray,
    received: np.ndarray,
    info: SideInfo,
    block: int,
) -> None:
    """Writes the Gaussians of a block to the scene as floats.

    Lost Gaussians get opacity 0, no rotation, no harmonics above degree 0, and estimated positions, scales and base
    colours.

    Args:
        splats: All Gaussians of the scene, changed in place.
        indices: int64 (n), indices of the block's Gaussians in `splats`.
        rows: int64 (n, columns), decoded integers of each Gaussian except harmonics.
        harmonics: int32 (n, harmonics), decoded integers of the spherical harmonics, 0 for lost Gaussians.
        received: Mask of received Gaussians, bool (n).
        info: The stream's side information.
        block: Index of the spatial block.
    """
    lost = np.flatnonzero(~received)
    filled = rows.copy() if len(lost) else rows
    if len(lost):
        filled[lost] = _estimate_lost(info, block, rows[received][:, POSITION : POSITION + 3], len(lost))
    for first in range(0, len(rows), CACHE_GAUSSIANS):
        chunk = slice(first, first + CACHE_GAUSSIANS)
        corners = np.broadcast_to(info.boxes.corners[block], filled[chunk][:, :3].shape)
        fill_splats(
            splats,
            indices[chunk],
            filled[chunk],
            harmonics[chunk],
            corners,
            info.lattice_bits,
            info.size_log,
            info.transform,
        )
    lost_indices = indices[lost]
    splats.opacities[lost_indices] = 0
    splats.quats[lost_indices] = (1, 0, 0, 0)


def _estimate_lost(info: SideInfo, block: int, received_positions: np.ndarray, num_lost: int) -> np.ndarray:
    """Estimates the decoded integers of a block's lost Gaussians.

    Positions are copied from received Gaussians of the block. If no Gaussian was received, positions are spread over
    the bounding box of the block. Scales and colour are the block's means.

    Args:
        info: Side information of the stream, with mean attributes of each block.
        block: Index of the spatial block.
        received_positions: Positions of the block's received Gaussians in half lattice spacings, relative to the corner
            of the block's bounding box, int64 (received, 3).
        num_lost: Number of lost Gaussians.

    Returns:
        Integers of the lost Gaussians, int64 (num_lost, columns).
    """
    rows, block_means = empty_rows(num_lost, 0)[0], info.block_means[block]
    rows[:, SCALE0] = np.clip(block_means[1], -MAX_LOG, MAX_LOG)
    rows[:, ELONGATION] = np.clip(block_means[2], 0, MAX_LOG)
    rows[:, FLATNESS] = np.clip(block_means[3], 0, MAX_COMPANDED)
    rows[:, LUMA : LUMA + 3] = np.clip(block_means[4:], -MAX_COLOUR, MAX_COLOUR)
    rows[:, AXIS + 2] = 1 << DIRECTION_BITS
    if len(received_positions):
        rows[:, POSITION : POSITION + 3] = received_positions[np.arange(num_lost) * len(received_positions) // num_lost]
    else:
        sides = (info.boxes.extents[block] + 1) << info.boxes.shifts[block]
        relative_positions = (0.5 + np.arange(1, num_lost + 1)[:, None] * _GOLDEN) % 1.0
        rows[:, POSITION : POSITION + 3] = (2 * sides * relative_positions).astype(np.int64)
    return rows
