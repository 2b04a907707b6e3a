"""Stream to Gaussians: takes bytes and nothing else."""

import hashlib
from collections.abc import Callable

import numpy as np
import torch

from splatwire.codec.schemas.gaussians.attributes import empty_rows, to_splats
from splatwire.codec.schemas.gaussians.blocks import block_sizes
from splatwire.codec.schemas.gaussians.digest import update_digest
from splatwire.codec.schemas.gaussians.layout import (
    AXIS,
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
from splatwire.packets import GAUSSIANS, Manifest, Packet, SceneStream, arrange_groups
from splatwire.scene.splats import Splats

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
    manifest = stream.manifest
    info = open_side_info(manifest, stream.side_info)
    plan = manifest.plan
    starts, packets = arrange_groups(plan, stream.packets)
    splats, known = blank_splats(manifest.num_anchors, info.degree), np.zeros(manifest.num_anchors, dtype=np.bool_)
    sizes = np.diff(starts)
    first_group = np.searchsorted(starts, np.concatenate([[0], np.cumsum(block_sizes(plan))]))
    digest = hashlib.sha256()

    def decode(block: int) -> tuple[np.ndarray, np.ndarray]:
        here = slice(first_group[block], first_group[block + 1])
        rows, harmonics, received = decode_block(info, block, sizes[here], packets[here])
        places = plan.block_ranks(block)
        store_block(splats, places, rows, harmonics, received, info, block)
        known[places] = received
        return rows, harmonics

    for block, integers in enumerate(ordered_map(decode, range(plan.num_blocks), threads)):
        update_digest(digest, *integers)
        if progress:
            progress((block + 1) / plan.num_blocks)
    if len(stream.packets) == manifest.num_packets and digest.hexdigest() != manifest.symbols_digest:
        raise DesyncError("all packets arrived, but the decoded integers are not those that were encoded")
    return splats, known, dict(info.sections)


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


def decode_block(
    info: SideInfo, block: int, sizes: np.ndarray, packets: tuple[Packet | None, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decodes the packets of one block; any bytes decode to something.

    Args:
        info: The stream's side information.
        block: The block.
        sizes: Gaussians of each packet or gap.
        packets: The packets; None for a gap.

    Returns:
        Rows int64 (n, COLUMNS) and harmonics int32 (n, M), 0 where nothing was received; what was, bool (n).
    """
    from splatwire.codec.schemas.gaussians import _packet_kernels as kernels

    there = np.array([packet is not None for packet in packets], dtype=np.bool_)
    received = np.repeat(there, sizes)
    rows, harmonics = empty_rows(len(received), info.num_harmonics)
    payloads = [packet.payload for packet in packets if packet is not None]
    if not payloads:
        return rows, harmonics, received
    data = np.frombuffer(b"".join(payloads), dtype=np.uint8).copy()
    ends = np.concatenate([[0], np.cumsum([len(payload) for payload in payloads])]).astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes[there])]).astype(np.int64)
    found, levels = empty_rows(int(starts[-1]), info.num_harmonics)
    boxes = np.full(len(payloads), info.boxes.bits[block])
    defaults = np.repeat(info.block_defaults[block : block + 1], len(payloads), axis=0)
    kernels.decode_packets(
        info.kernel_tables(), info.kernel_stream(), info.models(), data, ends, starts, boxes, defaults, found, levels
    )
    rows[received], harmonics[received] = found, levels
    return rows, harmonics, received


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
    origins = np.broadcast_to(info.boxes.corners[block], (len(rows), 3))
    decoded = to_splats(filled, harmonics, origins, info.unit, info.size_log, info.transform)
    index = torch.from_numpy(places)
    for name, values in vars(decoded).items():
        getattr(splats, name)[index] = values
    gone = index[torch.from_numpy(lost)]
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
