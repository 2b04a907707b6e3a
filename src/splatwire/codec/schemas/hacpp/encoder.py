"""From a scene's anchors to symbols and packets of schema `hacpp`."""

from dataclasses import replace

import numpy as np

from splatwire.codec.schema import CodedPackets
from splatwire.codec.schemas.hacpp.atomic import Symbols, cut_packets, encode_packets, predict_mixture, predict_packets
from splatwire.codec.schemas.hacpp.coding_params import CodingContext, quantise
from splatwire.codec.schemas.hacpp.separated import SECTION as MASKS
from splatwire.codec.schemas.hacpp.separated import encode_masks, encode_parts
from splatwire.codec.schemas.hacpp.side_info import SideInfo, read_side_info, write_side_info
from splatwire.errors import InvalidValueError
from splatwire.model import AnchorScene
from splatwire.model.voxels import voxel_indices
from splatwire.packets import ANCHORS, Packetization
from splatwire.packets.sections import split_sections, write_sections

MAX_SYMBOL = (1 << 31) - 1


def hacpp_encoder(
    scene: AnchorScene, packetization: Packetization, sections: dict[str, bytes], noise: float | None
) -> tuple["HacppEncoder", bytes]:
    """Quantises what all packets share; returns what codes the anchors, and the side information.

    Args:
        scene: The scene, anchors by rank.
        packetization: How they are split.
        sections: Named sections of the side information.
        noise: Tolerated noise of the context networks; None for the measured rule.
    """
    source, voxels = SymbolSource(scene), voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    from splatwire.codec.schemas.hacpp.fit import fit_side_info  # needs torch

    info = fit_side_info(scene, voxels, noise=noise)
    if packetization.separated:
        sections = {**sections, MASKS: encode_masks(scene.anchors.mask, info.mask_models())}
    side_info = write_side_info(replace(info, sections=sections))
    # Predict from what a decoder will read, not from what was meant.
    read = read_side_info(side_info, scene.anchors.num_anchors, packetization.order)
    return HacppEncoder(source, read, packetization.separated), side_info


def hacpp_encoder_again(
    scene: AnchorScene, packetization: Packetization, side_info: bytes
) -> tuple["HacppEncoder", bytes]:
    """What codes the anchors of a decoded scene with the side information that it was decoded with.

    Returns:
        The encoder, and the side information, in which masks are where these packets need them.

    Raises:
        BitstreamError: If the side information is damaged.
    """
    info = read_side_info(side_info, scene.anchors.num_anchors, packetization.order)
    fixed, sections = split_sections(side_info, ANCHORS)
    sections.pop(MASKS, None)
    if packetization.separated:
        sections[MASKS] = encode_masks(scene.anchors.mask, info.mask_models())
    return HacppEncoder(SymbolSource(scene), info, packetization.separated), fixed + write_sections(sections)


class HacppEncoder:
    """See `AnchorCoder`.

    Args:
        source: The scene's symbols.
        info: Its side information.
        separated: Whether each attribute is a packet of its own.
    """

    def __init__(self, source: "SymbolSource", info: SideInfo, separated: bool) -> None:
        self._source, self._info, self._separated = source, info, separated
        self._context = info.coding_context()

    def encode(self, ranks: np.ndarray, counts: np.ndarray, packet_bytes: int | None) -> CodedPackets:
        """See `AnchorCoder.encode`."""
        context, models = self._context, self._info.mask_models()
        predicted = predict_packets(context, context.predict(self._info.voxels[ranks])[1])
        symbols = self._source.symbols(ranks, predicted.factors, context)
        mixture = predict_mixture(context, predicted, symbols.feature)
        if self._separated:
            coded = encode_parts(context, predicted, mixture, counts, symbols)
            return CodedPackets(np.repeat(counts, len(coded) // len(counts)), coded, (symbols.rows(),))
        if packet_bytes is not None:
            counts = cut_packets(predicted, mixture, counts, symbols, models, packet_bytes)
        return CodedPackets(
            counts, encode_packets(context, predicted, counts, symbols, models, mixture), (symbols.rows(),)
        )


class SymbolSource:
    """Quantises a scene's attributes with the steps that the coding context gives.

    Args:
        scene: The scene, anchors by rank.
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
        """Symbols of the anchors at `ranks` under step factors int64 (n, 3)."""
        parts = []
        for a, values in enumerate(self._values):
            base = context.config.base_steps[a]
            if np.abs(values[ranks]).max(initial=0) / (base * factors[:, a].min() / 65536) > MAX_SYMBOL:
                raise InvalidValueError("an attribute is too large for its quantisation step")
            parts.append(quantise(values[ranks], factors[:, a], base))
        return Symbols(self._mask[ranks].astype(np.uint8), *parts)
