"""From packets of schema `hacpp` to attributes: takes bytes and nothing else."""

import hashlib
import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from splatwire.codec.memory import check_memory, threads_within
from splatwire.codec.schema import CHUNK_ANCHORS, most_at_once, update_digest
from splatwire.codec.schemas.hacpp.arrays import DecodedArrays, assemble_scene, store_symbols
from splatwire.codec.schemas.hacpp.atomic import Symbols, decode_packets
from splatwire.codec.schemas.hacpp.coding_params import (
    factor_table,
    step_indices,
)
from splatwire.codec.schemas.hacpp.separated import decode_masks, decode_parts
from splatwire.codec.schemas.hacpp.side_info import SideInfo, read_side_info
from splatwire.codec.threads import ordered_map
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.model import (
    AnchorScene,
    Partial,
)
from splatwire.packets import Manifest, SceneStream, arrived_blocks
from splatwire.scene import Attribute

PLACE_BYTES = 128
"""Memory that the place of an anchor takes while it is read."""


def open_side_info(manifest: Manifest, side_info: bytes, num_bytes: int) -> SideInfo:
    """Reads the side information of a stream and compares it with the manifest.

    Args:
        manifest: The stream's manifest.
        side_info: The bytes.
        num_bytes: Bytes of the stream that are there (`splatwire.codec.memory`).

    Raises:
        MissingSideInfoError: If there are none.
        BitstreamError: If they are damaged, contradict the manifest, or have more anchors than so many bytes may take
            memory for.
    """
    if not side_info:
        raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
    num = manifest.num_anchors
    check_memory(num * PLACE_BYTES, num_bytes, f"reading the places of {num:,} anchors")
    info = read_side_info(side_info, num, manifest.packetization.order)
    layout = info.config.layout
    stated = (manifest.feature_dim, manifest.num_offsets, manifest.feature_groups)
    if stated != (layout.feature_dim, layout.num_offsets, layout.feature_groups):
        raise BitstreamError(f"manifest and side information disagree on the layout of an anchor: {stated}, {layout}")
    return info


def scene_bytes(info: SideInfo) -> int:
    """Memory of `DecodedArrays` and of the scene that `assemble_scene` makes of it."""
    config = info.config
    width = config.layout.feature_dim + 6 + 3 * config.layout.num_offsets
    return len(info.voxels) * (PLACE_BYTES + 4 * (3 * width + config.prior_dim + 2 * config.grid.context_dim))


def row_bytes(info: SideInfo) -> int:
    """Memory of an anchor that is being decoded: what networks read, hide and say in 64 bits, and its symbols."""
    layout, hidden = info.config.layout, [len(network.hidden.symbols) for network in (info.prior, *info.channel)]
    inputs = 2 * layout.feature_dim + info.config.grid.context_dim + info.config.prior_dim
    symbols = layout.feature_dim + 6 + 4 * layout.num_offsets
    return 8 * (sum(hidden) + max(hidden) + inputs) + 12 * symbols + 64


class HacppDecoder:
    """See `AnchorDecoder`.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        num_bytes: Bytes of the stream that are there (`splatwire.codec.memory`).

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it is damaged, contradicts the manifest, or has more anchors than so many bytes may take
            memory for.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        self._info = open_side_info(manifest, side_info, num_bytes)
        self._arrays: DecodedArrays | None = None
        self._context, self._layout = self._info.coding_context(), self._info.config.layout
        self.sections, self._models = self._info.sections, self._info.mask_models()
        self.num_symbols = self._layout.feature_dim + 6 + 4 * self._layout.num_offsets
        self.scene_bytes, self.row_bytes = scene_bytes(self._info), row_bytes(self._info)

    @property
    def _room(self) -> DecodedArrays:
        assert self._arrays is not None, "make_room comes first"
        return self._arrays

    def make_room(self) -> None:
        """See `AnchorDecoder.make_room`."""
        self._arrays = DecodedArrays.empty(self._info)

    def predict(self, ranks: np.ndarray) -> None:
        """See `AnchorDecoder.predict`."""
        features, outputs = self._context.predict(self._info.voxels[ranks])
        self._room.outputs[ranks], self._room.context[ranks] = outputs, features

    def decode(self, ranks: np.ndarray, counts: np.ndarray, payloads: Sequence[bytes]) -> np.ndarray:
        """See `AnchorDecoder.decode`."""
        if self._arrays is None:
            outputs = self._context.predict(self._info.voxels[ranks])[1]
        else:
            outputs = self._arrays.outputs[ranks]
        return decode_packets(self._context, outputs, counts, list(payloads), self._models)[0].rows()

    def store(self, ranks: np.ndarray, rows: np.ndarray) -> None:
        """See `AnchorDecoder.store`."""
        factors = factor_table()[step_indices(self._room.outputs[ranks], self._info.config)]
        store_symbols(self._room, ranks, Symbols.of_rows(rows, self._layout), factors, self._context)

    def scene(self) -> Partial[AnchorScene]:
        """See `AnchorDecoder.scene`."""
        return assemble_scene(self._info, self._room)


def decode_separated(
    stream: SceneStream, threads: int | None, progress: Callable[[float], None] | None
) -> tuple[Partial[AnchorScene], str]:
    """Decodes separated attributes, each group of anchors as far as its parts arrived.

    Returns:
        The scene, and the digest of all integers. Of a feature that arrived in part, the channels before the first
        missing group are there, though it counts as not received.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it is damaged or contradicts the manifest.
    """
    manifest = stream.manifest
    info = open_side_info(manifest, stream.side_info, stream.num_bytes)
    num, what = manifest.num_anchors, f"decoding {manifest.num_anchors:,} anchors"
    threads = threads_within(
        scene_bytes(info), most_at_once(stream.packets) * row_bytes(info), stream.num_bytes, what, threads
    )
    context, masks, arrays, digest = (
        info.coding_context(),
        decode_masks(info),
        DecodedArrays.empty(info),
        hashlib.sha256(),
    )
    arrays.mask[:], arrays.received[:, Attribute.MASK] = masks, True

    def predict(first: int) -> None:
        ranks = slice(first, first + CHUNK_ANCHORS)
        arrays.context[ranks], arrays.outputs[ranks] = context.predict(info.voxels[ranks])

    def decode_group(group: tuple[np.ndarray, dict[int, bytes]]) -> Symbols:
        ranks, payloads = group
        decoded = decode_parts(context, arrays.outputs[ranks], masks[ranks], payloads)
        store_symbols(arrays, ranks, decoded.symbols, decoded.factors, context, decoded.received)
        return decoded.symbols

    for _ in ordered_map(predict, range(0, num, CHUNK_ANCHORS), threads):
        pass
    done = 0
    for symbols in ordered_map(decode_group, _groups(stream), threads):
        update_digest(digest, symbols.rows())
        done += len(symbols.mask)
        if progress:
            progress(done / num)
    return assemble_scene(info, arrays), digest.hexdigest()


def _groups(stream: SceneStream) -> Iterator[tuple[np.ndarray, dict[int, bytes]]]:
    """Ranks of anchors that share packets, and what arrived of them, by `PacketId.part`."""
    for block in arrived_blocks(stream.manifest.plan, stream.packets):
        both = zip(block.packets, block.runs, strict=True)
        for _, same in itertools.groupby(both, key=lambda pair: pair[0].id.lane):
            pairs = list(same)
            yield block.ranks[pairs[0][1]], {packet.id.part: packet.payload for packet, _ in pairs}
