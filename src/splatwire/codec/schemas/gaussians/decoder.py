"""Stream to Gaussians: takes bytes and nothing else."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from splatwire.codec.memory import threads_within
from splatwire.codec.schemas.gaussians.attributes import empty_rows, to_splats
from splatwire.codec.schemas.gaussians.digest import update_digest
from splatwire.codec.schemas.gaussians.layout import (
    AXIS,
    CLASS,
    COLUMNS,
    DIRECTION_BITS,
    LATTICE,
    LUMA,
    MAX_COLOUR,
    MAX_LOG,
    MAX_THIN,
    SCALE0,
    SCALE1,
    SCALE2,
)
from splatwire.codec.schemas.gaussians.side_info import SideInfo, read_side_info
from splatwire.codec.threads import ordered_map
from splatwire.errors import BitstreamError, DesyncError, MissingSideInfoError
from splatwire.model import SplatCoding
from splatwire.packets import GAUSSIANS, ArrivedBlock, Manifest, SceneStream, arrived_blocks
from splatwire.packets.limits import MAX_BLOCK_SIZE
from splatwire.scene.splats import Splats

PIECE = 1 << 13
"""Gaussians that are floats of 64 bits at a time."""
_GOLDEN = np.array([0.8191725134, 0.6710436067, 0.5497004779])
"""Powers of the plastic number's four-dimensional cousin: multiples of them fill a box evenly (Roberts, 2018)."""


def decode_splats(
    stream: SceneStream, *, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> tuple[Splats, np.ndarray, dict[str, bytes]]:
    """Decodes what arrived of a stream.

    Args:
        stream: The stream; packets may be missing, side information may not.
        threads: Threads to use, which changes no bit; None for one for each processor.
        progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        All N Gaussians by place; which of them were received, bool (N); the named sections of the side information.
        A lost one has no opacity, the mean size and colour of its block, and the place of one that was received.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If the stream contradicts itself.
        DesyncError: If nothing was lost and yet the decoded integers are not those that were encoded.
    """
    found = decode_gaussians(stream, threads=threads, progress=progress)
    return found.splats, found.known, dict(found.info.sections)


@dataclass(frozen=True, eq=False)
class DecodedGaussians:
    """What arrived of a stream.

    Attributes:
        splats: All N Gaussians by place.
        known: bool (N), which of them were received.
        levels: uint8 (N), their classes of precision, 0 where lost.
        info: The side information.
    """

    splats: Splats
    known: np.ndarray
    levels: np.ndarray
    info: SideInfo

    @property
    def coding(self) -> SplatCoding | None:
        """What encodes the Gaussians to the same integers again; None in streams whose integers depend on packets."""
        info = self.info
        if info.coarsest < 0:
            return None
        transform, levels = torch.from_numpy(info.transform), torch.from_numpy(self.levels)
        return SplatCoding(info.size_log, info.unit, info.coarsest, tuple(info.bases.tolist()), transform, levels)


def decode_gaussians(
    stream: SceneStream, *, threads: int | None = None, progress: Callable[[float], None] | None = None
) -> DecodedGaussians:
    """Decodes what arrived of a stream, see `decode_splats`."""
    manifest, plan = stream.manifest, stream.manifest.plan
    info = open_side_info(manifest, stream.side_info)
    what, working = f"decoding {manifest.num_anchors:,} Gaussians", working_bytes(info, manifest)
    threads = threads_within(scene_bytes(info, manifest), working, stream.num_bytes, what, threads)
    splats, known = blank_splats(manifest.num_anchors, info.degree), np.zeros(manifest.num_anchors, dtype=np.bool_)
    levels = np.zeros(manifest.num_anchors, dtype=np.uint8)
    complete, digest = len(stream.packets) == manifest.num_packets, hashlib.sha256()

    def decode(arrived: ArrivedBlock) -> tuple[int, np.ndarray | None, np.ndarray | None]:
        rows, harmonics, received = decode_block(info, arrived)
        store_block(splats, arrived.ranks, rows, harmonics, received, info, arrived.number)
        known[arrived.ranks] = received
        if received.any():
            levels[arrived.ranks] = rows[:, CLASS]
        return arrived.number, *((rows, harmonics) if complete else (None, None))

    for block, rows, harmonics in ordered_map(decode, arrived_blocks(plan, stream.packets, gaps=True), threads):
        if rows is not None and harmonics is not None:
            update_digest(digest, rows, harmonics)
        if progress:
            progress((block + 1) / plan.num_blocks)
    if complete and digest.hexdigest() != manifest.symbols_digest:
        raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
    return DecodedGaussians(splats, known, levels, info)


def scene_bytes(info: SideInfo, manifest: Manifest) -> int:
    """Memory of a scene of all Gaussians, as `blank_splats` makes it, and of what is known of each."""
    return manifest.num_anchors * (4 * (11 + 3 * (info.degree + 1) ** 2) + 8)


def row_bytes(info: SideInfo) -> int:
    """Memory of the decoded integers of a Gaussian."""
    return 8 * int(COLUMNS) + 4 * info.num_harmonics


def working_bytes(info: SideInfo, manifest: Manifest) -> int:
    """Memory that a thread works with, and results that wait for it: integers of a few blocks, floats of `PIECE`."""
    largest = max((span.block_anchors(span.first_block) for span in manifest.plan.spans if span.num_anchors), default=0)
    return largest * (4 * row_bytes(info) + 64) + (4 << 20)


def open_side_info(manifest: Manifest, side_info: bytes) -> SideInfo:
    """Reads the side information of a stream of Gaussians.

    Raises:
        MissingSideInfoError: If there are none.
        BitstreamError: If they are damaged, or the stream holds something else.
    """
    if manifest.codec != GAUSSIANS or manifest.packetization.separated:
        raise BitstreamError("the stream does not hold whole Gaussians")
    if not side_info:
        raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
    return read_side_info(side_info, manifest.plan.num_blocks)


def decode_block(info: SideInfo, arrived: ArrivedBlock) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decodes what arrived of one block; any bytes decode to something.

    Args:
        info: The stream's side information.
        arrived: The block's packets.

    Returns:
        Rows int64 (n, COLUMNS) and harmonics int32 (n, M) by `ArrivedBlock.ranks`, 0 where nothing was received; what
        was, bool (n).
    """
    received = arrived.received
    if received.all():
        return *decode_packets(info, arrived.number, arrived.counts, arrived.payloads), received
    rows, harmonics = empty_rows(len(received), info.num_harmonics)
    if arrived.packets:
        found = decode_packets(info, arrived.number, arrived.counts, arrived.payloads)
        rows[received], harmonics[received] = found
    return rows, harmonics, received


def decode_packets(
    info: SideInfo, block: int, counts: np.ndarray, payloads: Sequence[bytes]
) -> tuple[np.ndarray, np.ndarray]:
    """Decodes packets of one block; any bytes decode to something.

    Args:
        info: The stream's side information.
        block: The block.
        counts: int64 (packets), Gaussians of each.
        payloads: One for each packet.

    Returns:
        Rows int64 (n, COLUMNS) and harmonics int32 (n, M), packet by packet.
    """
    from splatwire.codec.schemas.gaussians import _packet_kernels as kernels

    assert max(counts, default=0) <= MAX_BLOCK_SIZE, "one of more places than there are intervals has none"
    data = np.frombuffer(b"".join(payloads), dtype=np.uint8).copy()
    ends = np.concatenate([[0], np.cumsum([len(payload) for payload in payloads])]).astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    rows, harmonics = empty_rows(int(starts[-1]), info.num_harmonics)
    boxes = np.full(len(payloads), info.boxes.bits[block])
    defaults = np.repeat(info.block_defaults[block : block + 1], len(payloads), axis=0)
    kernels.decode_packets(
        info.kernel_tables(), info.kernel_stream(), info.models(), data, ends, starts, boxes, defaults, rows, harmonics
    )
    return rows, harmonics


def blank_splats(count: int, degree: int) -> Splats:
    """Gaussians to be filled, zero everywhere."""
    return Splats(
        torch.zeros(count, 3), torch.zeros(count, 4), torch.zeros(count, 3), torch.zeros(count),
        torch.zeros(count, (degree + 1) ** 2, 3),
    )  # fmt: skip


def store_block(
    splats: Splats,
    places: np.ndarray,
    rows: np.ndarray,
    harmonics: np.ndarray,
    received: np.ndarray,
    info: SideInfo,
    block: int,
) -> None:
    """Writes a block's Gaussians into `splats`, those that were lost as they are expected.

    Args:
        splats: All Gaussians of the scene.
        places: int64 (n), where those of the block lie in it.
        rows: int64 (n, COLUMNS); what was not received is ignored.
        harmonics: int32 (n, M), 0 where nothing was received.
        received: bool (n).
        info: The stream's side information.
        block: The block.
    """
    lost = np.flatnonzero(~received)
    filled = rows.copy() if len(lost) else rows
    if len(lost):
        filled[lost] = _expected(info, block, rows[received][:, LATTICE : LATTICE + 3], lost)
    for first in range(0, len(rows), PIECE):
        some = slice(first, first + PIECE)
        origins = np.broadcast_to(info.boxes.corners[block], filled[some][:, :3].shape)
        decoded = to_splats(filled[some], harmonics[some], origins, info.unit, info.size_log, info.transform)
        index = torch.from_numpy(places[some])
        for name, values in vars(decoded).items():
            getattr(splats, name)[index] = values
    gone = torch.from_numpy(places[lost])
    splats.opacities[gone] = 0
    splats.quats[gone] = torch.tensor([1.0, 0.0, 0.0, 0.0])


def _expected(info: SideInfo, block: int, near: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Rows of a block's lost Gaussians: its means, at places of received ones, or all over its box."""
    rows, defaults = empty_rows(len(lost), 0)[0], info.block_defaults[block]
    rows[:, SCALE0] = np.clip(defaults[1], -MAX_LOG, MAX_LOG)
    rows[:, SCALE1] = np.clip(defaults[2], 0, MAX_LOG)
    rows[:, SCALE2] = np.clip(defaults[3], 0, MAX_THIN)
    rows[:, LUMA : LUMA + 3] = np.clip(defaults[4:], -MAX_COLOUR, MAX_COLOUR)
    rows[:, AXIS + 2] = 1 << DIRECTION_BITS
    if len(near):
        rows[:, LATTICE : LATTICE + 3] = near[np.arange(len(lost)) * len(near) // len(lost)]
    else:
        sides = (info.boxes.extents[block] + 1) << info.boxes.shifts[block]
        share = (0.5 + np.arange(1, len(lost) + 1)[:, None] * _GOLDEN) % 1.0
        rows[:, LATTICE : LATTICE + 3] = (2 * sides * share).astype(np.int64)
    return rows
