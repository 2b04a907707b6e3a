"""Decoders of HAC++ anchors (codec `hacpp`)."""

import itertools
from collections.abc import Iterator

import numpy as np

from splatwire.bitstream import Manifest
from splatwire.codec.anchors.anchor_codec import AnchorDecoder
from splatwire.codec.anchors.hacpp.arrays import DecodedArrays, assemble_scene, store_symbols
from splatwire.codec.anchors.hacpp.atomic import Symbols, decode_packets
from splatwire.codec.anchors.hacpp.coding_params import factor_table, step_indices
from splatwire.codec.anchors.hacpp.separated import decode_masks, decode_parts
from splatwire.codec.anchors.hacpp.side_info import SideInfo, read_side_info
from splatwire.codec.memory import check_memory
from splatwire.codec.schema import DecodedRows, Decoder, PacketBatch
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.types import AnchorScene, Attribute, ReceivedScene

POSITION_BYTES = 128
"""Memory of an anchor's position while side information is read, bytes."""


def open_side_info(manifest: Manifest, side_info: bytes, num_bytes: int) -> SideInfo:
    """Reads the side information of a stream and checks it against the manifest.

    Args:
        manifest: The stream's manifest.
        side_info: The side information, serialised.
        num_bytes: Number of received bytes of the stream, which determines the memory limit.

    Raises:
        MissingSideInfoError: If `side_info` is empty.
        BitstreamError: If the side information is damaged, contradicts the manifest, or needs too much memory.
    """
    if not side_info:
        raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
    num = manifest.num_elements
    check_memory(num * POSITION_BYTES, num_bytes, f"reading the positions of {num:,} anchors")
    info = read_side_info(side_info, num, manifest.packetization.order)
    layout = info.config.layout
    stated = (manifest.feature_dim, manifest.num_offsets, manifest.feature_groups)
    if stated != (layout.feature_dim, layout.num_offsets, layout.feature_groups):
        raise BitstreamError(f"manifest and side information disagree on the layout of an anchor: {stated}, {layout}")
    return info


def scene_bytes(info: SideInfo) -> int:
    """Returns the memory of the decoded attributes of all anchors and of the resulting scene, bytes."""
    config = info.config
    width = config.layout.feature_dim + 6 + 3 * config.layout.num_offsets
    return len(info.voxels) * (POSITION_BYTES + 4 * (3 * width + config.prior_dim + 2 * config.grid.context_dim))


def working_bytes_per_anchor(info: SideInfo) -> int:
    """Returns the working memory for one anchor during decoding, bytes."""
    # Inputs, hidden units and outputs of the networks (64 bits each), and quantised attributes.
    layout, hidden = info.config.layout, [len(network.hidden.symbols) for network in (info.prior, *info.channel)]
    inputs = 2 * layout.feature_dim + info.config.grid.context_dim + info.config.prior_dim
    symbols = layout.feature_dim + 6 + 4 * layout.num_offsets
    return 8 * (sum(hidden) + max(hidden) + inputs) + 12 * symbols + 64


def open_decoder(manifest: Manifest, side_info: bytes, num_bytes: int) -> Decoder:
    """Reads the side information of a stream, and returns the decoder for its atomic or separated packets.

    Args:
        manifest: The stream's manifest.
        side_info: The side information, serialised.
        num_bytes: Number of received bytes of the stream, which determines the memory limit.

    Raises:
        MissingSideInfoError: If `side_info` is empty.
        BitstreamError: If the side information is damaged, contradicts the manifest, or needs too much memory.
    """
    info = open_side_info(manifest, side_info, num_bytes)
    return (SeparatedDecoder if manifest.packetization.separated else HacppDecoder)(manifest, info)


class HacppDecoder(AnchorDecoder):
    """Decoder of HAC++ anchors in atomic packets.

    An atomic packet contains all attributes of its anchors.

    Args:
        manifest: The stream's manifest.
        info: Its side information.

    Raises:
        BitstreamError: If manifest and side information contradict each other.
    """

    def __init__(self, manifest: Manifest, info: SideInfo) -> None:
        super().__init__(manifest, info.sections)
        self._info, self._arrays = info, None
        self._context, self._layout = info.coding_context(), info.config.layout
        self._models = info.mask_models()
        self.row_bytes = 4 * (self._layout.feature_dim + 6 + 4 * self._layout.num_offsets)
        self.scene_bytes, self.working_bytes_per_anchor = scene_bytes(info), working_bytes_per_anchor(info)

    _arrays: DecodedArrays | None

    @property
    def _allocated(self) -> DecodedArrays:
        assert self._arrays is not None, "allocate comes first"
        return self._arrays

    def _allocate_arrays(self) -> None:
        """Allocates arrays for the attributes of all anchors. Attributes are 0 until their packets are decoded."""
        self._arrays = DecodedArrays.empty(self._info)

    def predict(self, ranks: np.ndarray) -> None:
        """Predicts the attributes of n anchors from the hash grid, and stores the predictions in this object.

        Args:
            ranks: Indices of the n anchors in coding order, int64 (n).
        """
        features, outputs = self._context.predict(self._info.voxels[ranks])
        self._allocated.outputs[ranks], self._allocated.context_features[ranks] = outputs, features

    def decode(self, batch: PacketBatch) -> DecodedRows:
        """Decodes packets of anchors to integers: offset masks and quantised attributes.

        Args:
            batch: The received packets.

        Returns:
            One array with a row for each of the n anchors, packet by packet, int32 (n, symbols); columns as in
            `Symbols.rows`.
        """
        ranks = batch.indices
        if self._arrays is None:
            outputs = self._context.predict(self._info.voxels[ranks])[1]
        else:
            outputs = self._arrays.outputs[ranks]
        return (decode_packets(self._context, outputs, batch.counts, batch.payloads, self._models)[0].rows(),)

    def store(self, batch: PacketBatch, rows: DecodedRows) -> None:
        """Dequantises the attributes of decoded anchors, and writes them to the arrays of the scene.

        Args:
            batch: The decoded packets.
            rows: Result of `decode` for these packets.
        """
        ranks = batch.indices
        factors = factor_table()[step_indices(self._allocated.outputs[ranks], self._info.config)]
        store_symbols(self._allocated, ranks, Symbols.of_rows(rows[0], self._layout), factors, self._context)

    def scene(self) -> ReceivedScene[AnchorScene]:
        """Returns the scene decoded so far, with the mask of received attributes and the stream's metadata.

        The scene shares memory with the arrays that `store` fills.
        """
        return assemble_scene(self._info, self._allocated).with_records(*self._records)


class SeparatedDecoder(HacppDecoder):
    """Decoder of separated packets, each of which contains one attribute of a group of anchors.

    Args:
        manifest: The stream's manifest.
        info: Its side information.

    Raises:
        BitstreamError: If manifest and side information contradict each other.
    """

    # A feature is sent in several packets, one per group of channels. It counts as received only if all of them are.
    # Otherwise, the channels before the first missing packet are decoded.

    batches_are_blocks, packets_independent, redecode_on_demand = True, False, False

    def __init__(self, manifest: Manifest, info: SideInfo) -> None:
        super().__init__(manifest, info)
        self._masks = decode_masks(info)

    def _allocate_arrays(self) -> None:
        """Allocates arrays for all anchors, with the offset masks from the side information."""
        super()._allocate_arrays()
        self._allocated.mask[:], self._allocated.received[:, Attribute.MASK] = self._masks, True

    def decode(self, batch: PacketBatch) -> DecodedRows:
        """Decodes the received packets of one spatial block.

        Args:
            batch: The packets. Each contains one attribute, or some feature channels, of a group of anchors.

        Returns:
            Three arrays with a row for each of the n anchors that have a received packet, group by group:

            * Quantised attributes, int32 (n, symbols), columns as in `Symbols.rows`; 0 where not decoded.
            * Factors by which the base quantisation steps of feature, scaling and offset are multiplied, in fixed point
              with `FACTOR_BITS` fractional bits, int64 (n, 3).
            * Mask of the received attributes, bool (n, attributes).
        """
        empty = Symbols.of_rows(np.empty((0, self.row_bytes // 4), np.int32), self._layout).rows()
        rows: list[DecodedRows] = [(empty, np.empty((0, 3), np.int64), np.empty((0, len(Attribute)), np.bool_))]
        for ranks, payloads in _payloads_by_group(batch):
            decoded = decode_parts(self._context, self._allocated.outputs[ranks], self._masks[ranks], payloads)
            rows.append((decoded.symbols.rows(), decoded.factors, decoded.received))
        return tuple(np.concatenate(parts) for parts in zip(*rows, strict=True))

    def store(self, batch: PacketBatch, rows: DecodedRows) -> None:
        """Dequantises received attributes of anchors, and writes them and their mask to the arrays of the scene.

        Args:
            batch: The decoded packets.
            rows: Result of `decode` for these packets: quantised attributes, factors on the quantisation steps, and
                mask of received attributes.
        """
        symbols, factors, received = rows
        ranks = np.concatenate([np.empty(0, np.int64), *(ranks for ranks, _ in _payloads_by_group(batch))])
        store_symbols(self._allocated, ranks, Symbols.of_rows(symbols, self._layout), factors, self._context, received)


def _payloads_by_group(batch: PacketBatch) -> Iterator[tuple[np.ndarray, dict[int, bytes]]]:
    """Yields the received packets of a block, grouped by the anchors that they contain.

    Args:
        batch: Received packets of the block.

    Yields:
        For each group: indices of its anchors in coding order, int64; and payloads of its packets by attribute
        (`PacketId.part`).
    """
    both = zip(batch.packets, batch.members, strict=True)
    for _, same in itertools.groupby(both, key=lambda pair: pair[0].id.index_in_block):
        pairs = list(same)
        yield pairs[0][1], {packet.id.part: packet.payload for packet, _ in pairs}
