"""From packets of schema `hacpp` to attributes: takes bytes and nothing else."""

import itertools
from collections.abc import Iterator

import numpy as np

from splatwire.codec.anchors import AnchorDecoder
from splatwire.codec.memory import check_memory
from splatwire.codec.schema import Decoder, Rows, Run
from splatwire.codec.schemas.hacpp.arrays import DecodedArrays, assemble_scene, store_symbols
from splatwire.codec.schemas.hacpp.atomic import Symbols, decode_packets
from splatwire.codec.schemas.hacpp.coding_params import (
    factor_table,
    step_indices,
)
from splatwire.codec.schemas.hacpp.separated import decode_masks, decode_parts
from splatwire.codec.schemas.hacpp.side_info import SideInfo, read_side_info
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.model import (
    AnchorScene,
    Partial,
)
from splatwire.packets import Manifest
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
    num = manifest.num_elements
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


def open_decoder(manifest: Manifest, side_info: bytes, num_bytes: int) -> Decoder:
    """What reads a stream, whole anchors or single attributes; arguments and errors as of `open_side_info`."""
    info = open_side_info(manifest, side_info, num_bytes)
    return (SeparatedDecoder if manifest.packetization.separated else HacppDecoder)(manifest, info)


class HacppDecoder(AnchorDecoder):
    """See `splatwire.codec.schema.Decoder`.

    Args:
        manifest: The stream's manifest.
        info: Its side information.

    Raises:
        BitstreamError: If they contradict each other.
    """

    def __init__(self, manifest: Manifest, info: SideInfo) -> None:
        super().__init__(manifest, info.sections)
        self._info, self._arrays = info, None
        self._context, self._layout = info.coding_context(), info.config.layout
        self._models = info.mask_models()
        self.row_bytes = 4 * (self._layout.feature_dim + 6 + 4 * self._layout.num_offsets)
        self.scene_bytes, self.chunk_bytes = scene_bytes(info), row_bytes(info)

    _arrays: DecodedArrays | None

    @property
    def _room(self) -> DecodedArrays:
        assert self._arrays is not None, "expect comes first"
        return self._arrays

    def make_room(self) -> None:
        """See `AnchorDecoder.make_room`."""
        self._arrays = DecodedArrays.empty(self._info)

    def predict(self, ranks: np.ndarray) -> None:
        """See `AnchorDecoder.predict`."""
        features, outputs = self._context.predict(self._info.voxels[ranks])
        self._room.outputs[ranks], self._room.context[ranks] = outputs, features

    def decode(self, run: Run) -> Rows:
        """See `Decoder.decode`."""
        ranks = run.ranks
        if self._arrays is None:
            outputs = self._context.predict(self._info.voxels[ranks])[1]
        else:
            outputs = self._arrays.outputs[ranks]
        return (decode_packets(self._context, outputs, run.counts, run.payloads, self._models)[0].rows(),)

    def store(self, run: Run, rows: Rows) -> None:
        """See `Decoder.store`."""
        ranks = run.ranks
        factors = factor_table()[step_indices(self._room.outputs[ranks], self._info.config)]
        store_symbols(self._room, ranks, Symbols.of_rows(rows[0], self._layout), factors, self._context)

    def scene(self) -> Partial[AnchorScene]:
        """See `Decoder.scene`."""
        return assemble_scene(self._info, self._room).saying(*self._said)


class SeparatedDecoder(HacppDecoder):
    """The same of separated attributes, each group of anchors as far as its parts arrived; arguments as there.

    Of a feature that arrived in part, the channels before the first missing group are there, though it counts as not
    received.
    """

    whole_blocks, alone, again = True, False, False

    def __init__(self, manifest: Manifest, info: SideInfo) -> None:
        super().__init__(manifest, info)
        self._masks = decode_masks(info)

    def make_room(self) -> None:
        """See `AnchorDecoder.make_room`."""
        super().make_room()
        self._room.mask[:], self._room.received[:, Attribute.MASK] = self._masks, True

    def decode(self, run: Run) -> Rows:
        """See `Decoder.decode`: integers, step factors and what was received of each group of anchors."""
        empty = Symbols.of_rows(np.empty((0, self.row_bytes // 4), np.int32), self._layout).rows()
        found: list[Rows] = [(empty, np.empty((0, 3), np.int64), np.empty((0, len(Attribute)), np.bool_))]
        for ranks, payloads in _groups(run):
            decoded = decode_parts(self._context, self._room.outputs[ranks], self._masks[ranks], payloads)
            found.append((decoded.symbols.rows(), decoded.factors, decoded.received))
        return tuple(np.concatenate(parts) for parts in zip(*found, strict=True))

    def store(self, run: Run, rows: Rows) -> None:
        """See `Decoder.store`."""
        symbols, factors, received = rows
        ranks = np.concatenate([np.empty(0, np.int64), *(ranks for ranks, _ in _groups(run))])
        store_symbols(self._room, ranks, Symbols.of_rows(symbols, self._layout), factors, self._context, received)


def _groups(run: Run) -> Iterator[tuple[np.ndarray, dict[int, bytes]]]:
    """Ranks of anchors that share packets, and what arrived of them, by `PacketId.part`."""
    both = zip(run.packets, run.members, strict=True)
    for _, same in itertools.groupby(both, key=lambda pair: pair[0].id.lane):
        pairs = list(same)
        yield pairs[0][1], {packet.id.part: packet.payload for packet, _ in pairs}
