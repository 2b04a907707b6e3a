"""Decoder of the codec `causal` for neural anchors."""

import math

import numpy as np

from splatwire.bitstream import Manifest
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec.anchors.anchor_codec import AnchorDecoder
from splatwire.codec.anchors.causal.context import (
    VALUE_BITS,
    CodingContext,
    dequantise_linear,
    dequantise_log_scalings,
    exponential,
)
from splatwire.codec.anchors.causal.packet_coder import anchor_rows, decode_packets, predict_from_positions
from splatwire.codec.anchors.causal.side_info import LOG_BITS, SideInfo, read_side_info
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.fixed_point import ACTIVATION_BITS
from splatwire.codec.memory import check_memory
from splatwire.codec.metadata import read_metadata
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.quantised_networks import network_of
from splatwire.codec.schema import DecodedRows, PacketBatch
from splatwire.errors import BitstreamError, MissingSideInfoError
from splatwire.types import (
    Anchors,
    AnchorScene,
    Attribute,
    AttributePrior,
    CausalCoding,
    GaussianHeads,
    LossMask,
    PredictedPositions,
    Prior,
    ReceivedScene,
)
from splatwire.types.causal_coding import CausalConfig

_LOG_OF_SCALING = [0, 0, 0, 1, 2, 3]
"""For each of an anchor's six scalings, the index of its logarithm among the four coded logarithms."""
POSITION_BYTES = 32
"""Memory of an anchor's position in the side information, bytes; its decoded form takes four times that."""


def _num_values(config: CausalConfig) -> int:
    """Returns the number of decoded values of an anchor."""
    return config.layout.feature_dim + 6 + 3 * config.layout.num_offsets


def _working_bytes_per_anchor(info: SideInfo) -> int:
    """Returns the working memory that decoding needs for each anchor, bytes."""
    # The memory is for the activations of the largest network and the quantised attributes.
    hidden = max(len(network.hidden.symbols) for network in info.networks.values())
    outputs = max(len(network.output.symbols) for network in info.networks.values())
    inputs = 2 * info.config.context_dim + info.config.layout.feature_dim + 4
    return 8 * (inputs + hidden + outputs) + 8 * (outputs + _num_values(info.config)) + 128


class CausalDecoder(AnchorDecoder):
    """Decodes streams of anchors that were encoded with the causal model.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        num_bytes: Number of received bytes of the stream, which determines the memory limit.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If the side information is damaged, or has too many anchors for the memory limit.
    """

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        if not side_info:
            raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
        if manifest.packetization.order != "morton":
            raise BitstreamError("anchors of the causal model are in Morton order, and the manifest says otherwise")
        num = manifest.num_elements
        check_memory(num * POSITION_BYTES, num_bytes, f"reading the positions of {num:,} anchors")
        info = read_side_info(side_info, num)
        super().__init__(manifest, info.sections)
        layout = info.config.layout
        self._info, self._context = info, CodingContext.of(info)
        self._num_features, self._num_offsets = layout.feature_dim, layout.num_offsets
        self._feature_steps = np.repeat(info.linear_steps[:-1], layout.feature_groups)
        self.row_bytes = 4 * (3 + 4 * self._num_offsets + self._num_features + 4)
        self.scene_bytes = self._num * (
            4 * POSITION_BYTES + 4 * (3 * _num_values(info.config) + info.config.context_dim)
        )
        self.working_bytes_per_anchor = _working_bytes_per_anchor(info)

    def _allocate_arrays(self) -> None:
        """Allocates arrays for the attributes of all anchors. Attributes are 0 until their packets are decoded."""
        num, info = self._num, self._info
        self._received = np.zeros((num, len(Attribute)), dtype=np.bool_)
        self._mask = np.zeros((num, self._num_offsets), dtype=np.bool_)
        widths = {"feature": self._num_features, "scaling": 6, "offset": 3 * self._num_offsets}
        self._values = {name: np.zeros((num, width), dtype=np.float32) for name, width in widths.items()}
        self._means = {name: np.zeros((num, width), dtype=np.float32) for name, width in widths.items()}
        self._deviations = {name: np.zeros((num, width), dtype=np.float32) for name, width in widths.items()}
        self._position_outputs = np.zeros((num, info.config.context_dim), dtype=np.float32)
        self._predicted_positions = self._positions_of(info.positions.known.voxels)
        self._positions = self._predicted_positions.copy()

    def predict(self, ranks: np.ndarray) -> None:
        """Predicts the attributes of n anchors from their positions alone, and stores the predictions in this object.

        A prediction is a mean and a standard deviation for each value.

        Args:
            ranks: Indices of the n anchors in coding order, int64 (n).
        """
        voxels = self._info.positions.known.select(ranks).voxels
        position_outputs, means, log_deviations = predict_from_positions(self._context, voxels)
        self._position_outputs[ranks] = position_outputs * 2.0**-ACTIVATION_BITS
        deviations = np.exp2(np.clip(log_deviations * 2.0**-VALUE_BITS, -6, 13))
        for name, values in self._attributes(means).items():
            self._means[name][ranks] = values
        logs = deviations[:, self._num_features : self._num_features + 4] * self._info.steps_of_logs[[0, 1, 1, 1]]
        relative = logs[:, _LOG_OF_SCALING] * (math.log(2) * 2.0**-LOG_BITS)
        self._deviations["feature"][ranks] = deviations[:, : self._num_features] * self._feature_steps
        self._deviations["scaling"][ranks] = self._means["scaling"][ranks] * relative
        self._deviations["offset"][ranks] = deviations[:, self._num_features + 4 :] * self._info.linear_steps[-1]

    def decode(self, batch: PacketBatch) -> DecodedRows:
        """Decodes packets of anchors to integers.

        Args:
            batch: The received packets.

        Returns:
            One array with a row for each anchor, packet by packet: position, offset mask and quantised attributes.
        """
        positions = self._info.positions.known.select(batch.indices)
        return (anchor_rows(*decode_packets(self._context, positions, batch.counts, batch.payloads)),)

    def store(self, batch: PacketBatch, rows: DecodedRows) -> None:
        """Dequantises the attributes of decoded anchors, and writes them to the arrays of the scene.

        Args:
            batch: The decoded packets.
            rows: Result of `decode` for these packets.
        """
        ranks = batch.indices
        voxels, mask, quantised = np.split(rows[0], [3, 3 + self._num_offsets], axis=1)
        self._received[ranks], self._mask[ranks] = True, mask
        self._positions[ranks] = self._positions_of(voxels + self._info.positions.known.corner)
        for name, values in self._attributes(quantised).items():
            self._values[name][ranks] = values

    def _positions_of(self, voxels: np.ndarray) -> np.ndarray:
        """Positions of voxels, world units relative to the scene's origin, float32 (n, 3)."""
        return (voxels.astype(np.float64) * self._info.voxel_size).astype(np.float32)

    def _attributes(self, quantised: np.ndarray) -> dict[str, np.ndarray]:
        """Dequantises decoded anchors; returns the attribute arrays (feature, scaling, offset) by name."""
        feature, log_scalings, offset = np.split(quantised, [self._num_features, self._num_features + 4], axis=1)
        return {
            "feature": dequantise_linear(feature, self._feature_steps),
            "scaling": exponential(dequantise_log_scalings(log_scalings, self._info))[:, _LOG_OF_SCALING],
            "offset": dequantise_linear(offset, self._info.linear_steps[-1]),
        }

    def scene(self) -> ReceivedScene[AnchorScene]:
        """Returns the scene decoded so far, with the mask of received attributes and the stream's metadata.

        The scene shares memory with the arrays that `store` fills.
        """
        info, values = self._info, self._values
        offsets = values["offset"].reshape(len(self._positions), self._num_offsets, 3)
        positions, mask = self._positions, self._mask
        anchors = Anchors(positions, values["feature"], values["scaling"], offsets, mask)
        heads = GaussianHeads(*(network_of(head) for head in info.heads))
        scene = AnchorScene(
            anchors,
            heads,
            self._coding(),
            background=BACKGROUND_SECTION.read(info.sections),
            origin=ORIGIN_SECTION.read(info.sections),
            metadata=read_metadata(info.sections),
        )
        sections = concealer_sections(info.sections)
        predicted = PredictedPositions(self._predicted_positions)
        records = (self._prior(), info.config.layout, predicted, *self._records)
        return ReceivedScene(scene, LossMask(self._received), sections, records)

    def _coding(self) -> CausalCoding:
        info, unit = self._info, math.log(2) * 2.0**-LOG_BITS
        all_steps = np.concatenate([info.linear_steps[:-1], info.steps_of_logs * unit, info.linear_steps[-1:]])
        networks = {name: network_of(network) for name, network in info.networks.items()}
        steps, zero_points, middle, spread = (
            np.asarray(values, np.float32) for values in (all_steps, info.zero_points * unit, info.middle, info.spread)
        )
        return CausalCoding(networks, steps, zero_points, middle, spread, info.voxel_size, info.config)

    def _prior(self) -> Prior:
        """Returns the predicted distributions of all attributes, from which concealers estimate lost anchors."""
        # The quantisation step of a scaling is proportional to its mean.
        num, info = len(self._position_outputs), self._info
        relative = self._means["scaling"].mean(axis=1, keepdims=True)
        steps = {
            "feature": np.full((num, 1), self._feature_steps.mean(), np.float32),
            "scaling": relative * float(info.steps_of_logs[1] * math.log(2) * 2.0**-LOG_BITS),
            "offset": np.full((num, 1), info.linear_steps[-1], np.float32),
        }
        parts = {name: AttributePrior(self._means[name], self._deviations[name], step) for name, step in steps.items()}
        return Prior(**parts, context_features=self._position_outputs)
