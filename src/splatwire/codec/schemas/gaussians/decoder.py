"""Stream to Gaussians: takes bytes and nothing else."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.background import read_background
from splatwire.codec.metadata import read_metadata
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.origin import read_origin
from splatwire.codec.schema import Rows, Run
from splatwire.codec.schemas.gaussians.attributes import empty_rows, to_splats, update_digest
from splatwire.codec.schemas.gaussians.copies import read_copies
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
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.model import Partial, SplatCoding, SplatScene
from splatwire.packets import GAUSSIANS, Manifest, Packet
from splatwire.packets.limits import LEVELS, MAX_BLOCK_SIZE
from splatwire.scene import Erasures
from splatwire.scene.splats import Splats

PIECE = 1 << 13
"""Gaussians that are floats of 64 bits at a time."""
_GOLDEN = np.array([0.8191725134, 0.6710436067, 0.5497004779])
"""Powers of the plastic number's four-dimensional cousin: multiples of them fill a box evenly (Roberts, 2018)."""


class GaussianDecoder:
    """See `splatwire.codec.schema.Decoder`.

    A lost Gaussian has no opacity, the mean size and colour of its block, and the place of one that was received.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        num_bytes: Bytes of the stream that are there.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it is damaged or contradicts the manifest.
    """

    order: np.ndarray | None = None
    whole_blocks, alone, again = True, True, False

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        info = open_side_info(manifest, side_info)
        self._info, self._plan, self._num, self.sections = info, manifest.plan, manifest.num_elements, info.sections
        self.scene_bytes = self._num * (4 * (11 + 3 * (info.degree + 1) ** 2) + 8)
        self.row_bytes = 8 * int(COLUMNS) + 4 * info.num_harmonics
        copies = read_copies(info, self._num)
        self._said = () if copies is None else (copies,)

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        """See `Decoder.working_bytes`: integers of a few blocks, whose results wait for others, floats of `PIECE`."""
        spans = (span for span in self._plan.spans if span.num_elements)
        largest = max((self._plan.block_elements(span.first_block) for span in spans), default=0)
        return largest * (4 * self.row_bytes + 64) + (4 << 20)

    def expect(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        """See `Decoder.expect`: what is expected of lost Gaussians hangs on the rest of their block (`store`)."""
        self._splats = blank_splats(self._num, self._info.degree)
        self._levels = np.zeros(self._num, dtype=np.uint8)
        self._erasures = Erasures.of_anchors(np.zeros(self._num, dtype=np.bool_))

    def decode(self, run: Run) -> Rows:
        """See `Decoder.decode`."""
        return decode_packets(self._info, run.block, run.counts, run.payloads)

    def store(self, run: Run, rows: Rows) -> None:
        """See `Decoder.store`."""
        places = self._plan.block_ranks(run.block)
        known = self._erasures.received
        known[run.ranks] = True
        received = known[places].all(axis=1)
        if not received.all():
            gaps = empty_rows(len(places), self._info.num_harmonics)
            for filled, some in zip(gaps, rows, strict=True):
                filled[received] = some
            rows = gaps
        store_block(self._splats, places, rows[0], rows[1], received, self._info, run.block)
        if received.any():
            self._levels[places] = rows[0][:, CLASS].astype(np.uint8)

    def update_digest(self, digest: Any, rows: Rows) -> None:
        """See `Decoder.update_digest`."""
        update_digest(digest, rows)

    def scene(self) -> Partial[SplatScene]:
        """See `Decoder.scene`."""
        scene = SplatScene(
            self._splats,
            background=read_background(self.sections),
            coding=coding_of(self._info, self._levels),
            antialiased=ANTIALIASED in self.sections,
            origin=read_origin(self.sections),
            metadata=read_metadata(self.sections),
        )
        return Partial(scene, self._erasures, concealer_sections(self.sections), self._said)


def coding_of(info: SideInfo, classes: np.ndarray) -> SplatCoding | None:
    """What encodes Gaussians to the same integers again; None in streams whose integers depend on packets.

    Args:
        info: The stream's side information.
        classes: Class of precision of each Gaussian, uint8 (N).
    """
    if info.coarsest < 0:
        return None
    return SplatCoding(info.size_log, info.unit, info.coarsest, tuple(info.bases.tolist()), info.transform, classes)


def open_side_info(manifest: Manifest, side_info: bytes) -> SideInfo:
    """Reads the side information of a stream of Gaussians.

    Raises:
        MissingSideInfoError: If there are none.
        BitstreamError: If they are damaged, or the stream holds something else.
    """
    if manifest.codec not in (GAUSSIANS, LEVELS) or manifest.packetization.separated:
        raise BitstreamError("the stream does not hold whole Gaussians")
    if not side_info:
        raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
    return read_side_info(side_info, manifest.plan.num_blocks)


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
    return Splats(*(np.zeros((count, *shape), np.float32) for shape in ((3,), (4,), (3,), (), ((degree + 1) ** 2, 3))))


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
        for name, values in vars(decoded).items():
            getattr(splats, name)[places[some]] = values
    gone = places[lost]
    splats.opacities[gone] = 0
    splats.quats[gone] = (1, 0, 0, 0)


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
