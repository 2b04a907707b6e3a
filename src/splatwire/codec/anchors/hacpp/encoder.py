"""Encoder of HAC++ anchors (codec `hacpp`)."""

from dataclasses import replace

import numpy as np

from splatwire.anchors.voxels import voxel_indices
from splatwire.bitstream import HACPP_ANCHORS, Packetization
from splatwire.bitstream.sections import split_sections, write_sections
from splatwire.codec.anchors.hacpp.atomic import (
    Symbols,
    encode_packets,
    predict_mixture,
    predict_packets,
    split_into_packets,
)
from splatwire.codec.anchors.hacpp.coding_params import CodingContext, quantise
from splatwire.codec.anchors.hacpp.fit import fit_side_info
from splatwire.codec.anchors.hacpp.separated import SECTION as MASKS
from splatwire.codec.anchors.hacpp.separated import encode_masks, encode_parts
from splatwire.codec.anchors.hacpp.side_info import SideInfo, read_side_info, write_side_info
from splatwire.codec.schema import CodedPackets
from splatwire.errors import InvalidValueError
from splatwire.types import AnchorScene

MAX_SYMBOL = (1 << 31) - 1


def hacpp_encoder(
    scene: AnchorScene, packetization: Packetization, sections: dict[str, bytes], network_tolerance: float | None
) -> tuple["HacppEncoder", bytes]:
    """Returns the encoder of a scene's anchors, and the side information, which is fitted to the scene.

    Args:
        scene: The scene, with anchors in coding order.
        packetization: Parameters of the division into packets.
        sections: Named sections of the side information.
        network_tolerance: Tolerated error of the quantised networks' outputs, relative to the predicted standard
            deviation; None for the default.
    """
    source, voxels = SymbolSource(scene), voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    info = fit_side_info(scene, voxels, network_tolerance=network_tolerance)
    if packetization.separated:
        sections = {**sections, MASKS: encode_masks(scene.anchors.mask, info.mask_models())}
    side_info = write_side_info(replace(info, sections=sections))
    # Predict from the side information as a decoder reads it, after quantisation.
    read = read_side_info(side_info, scene.anchors.num_anchors, packetization.order)
    return HacppEncoder(source, read, packetization.separated), side_info


def hacpp_repack_encoder(
    scene: AnchorScene, packetization: Packetization, side_info: bytes
) -> tuple["HacppEncoder", bytes]:
    """Creates an encoder that divides the decoded anchors of an existing stream into new packets.

    Args:
        scene: The anchors decoded from the stream.
        packetization: Parameters of the new division into packets.
        side_info: Side information of the stream, serialised.

    Returns:
        The encoder, and the side information of the new stream.

    Raises:
        BitstreamError: If the side information is damaged.
    """
    # The side information contains the offset masks if the new stream has separate packets for each attribute.
    info = read_side_info(side_info, scene.anchors.num_anchors, packetization.order)
    fixed, sections = split_sections(side_info, HACPP_ANCHORS)
    sections.pop(MASKS, None)
    if packetization.separated:
        sections[MASKS] = encode_masks(scene.anchors.mask, info.mask_models())
    return HacppEncoder(SymbolSource(scene), info, packetization.separated), fixed + write_sections(sections)


class HacppEncoder:
    """Encodes the anchors of one scene with the context model of HAC++.

    Args:
        source: Source of the quantised attributes of the scene's anchors.
        info: Side information of the scene's stream.
        separated: True if each attribute is in a separate packet.
    """

    def __init__(self, source: "SymbolSource", info: SideInfo, separated: bool) -> None:
        self._source, self._info, self._separated = source, info, separated
        self._context = info.coding_context()

    def encode(self, ranks: np.ndarray, counts: np.ndarray, max_payload_bytes: int | None) -> CodedPackets:
        """Encodes groups of anchors; each group becomes one packet, or several packets of limited size.

        Args:
            ranks: Indices, in coding order, of the n anchors to encode: first the anchors of group 0, then those of
                group 1, and so on, int64 (n).
            counts: Number of anchors of each group, int64 (groups).
            max_payload_bytes: Maximum payload size; larger groups are divided. None to leave groups undivided.
        """
        context, models = self._context, self._info.mask_models()
        predicted = predict_packets(context, context.predict(self._info.voxels[ranks])[1])
        symbols = self._source.symbols(ranks, predicted.factors, context)
        mixture = predict_mixture(context, predicted, symbols.feature)
        if self._separated:
            coded = encode_parts(context, predicted, mixture, counts, symbols)
            return CodedPackets(np.repeat(counts, len(coded) // len(counts)), coded, (symbols.rows(),))
        if max_payload_bytes is not None:
            counts = split_into_packets(predicted, mixture, counts, symbols, models, max_payload_bytes)
        return CodedPackets(
            counts, encode_packets(context, predicted, counts, symbols, models, mixture), (symbols.rows(),)
        )


class SymbolSource:
    """Quantises attributes of a scene's anchors on demand.

    Args:
        scene: The scene, with anchors in coding order.
    """

    def __init__(self, scene: AnchorScene) -> None:
        anchors = scene.anchors
        self._mask = anchors.mask
        self._values = (
            anchors.features,
            anchors.scalings,
            anchors.present_offsets.reshape(len(anchors.mask), -1),
        )

    def symbols(self, ranks: np.ndarray, factors: np.ndarray, context: CodingContext) -> Symbols:
        """Quantises the attributes of the given anchors.

        Args:
            ranks: Indices of the n anchors in coding order, int64 (n).
            factors: Factors on the quantisation steps of feature, scaling and offset, int64 (n, 3).
            context: Coding context, which contains the base quantisation steps.
        """
        parts = []
        for a, values in enumerate(self._values):
            base = context.config.base_steps[a]
            if np.abs(values[ranks]).max(initial=0) / (base * factors[:, a].min() / 65536) > MAX_SYMBOL:
                raise InvalidValueError("an attribute is too large for its quantisation step")
            parts.append(quantise(values[ranks], factors[:, a], base))
        return Symbols(self._mask[ranks].astype(np.uint8), *parts)
