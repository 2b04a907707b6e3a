"""Causal model in integer arithmetic: predicts the distribution of each attribute of an anchor for entropy coding.

Groups of attributes are predicted one after another, from the anchor's position and the attributes decoded before.
"""
# Networks never use other anchors. Everything is integer arithmetic, so encoder and decoder agree on every machine;
# matrix products use float64, which represents every partial sum exactly. `tests/reference/causal_packets.py` is an
# equivalent implementation in plain Python.

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatwire.codec import _network_kernels
from splatwire.codec.anchors.causal import _kernels as kernels
from splatwire.codec.anchors.causal.side_info import LOG_BITS, SideInfo
from splatwire.codec.fixed_point import ACTIVATION_BITS
from splatwire.codec.integer_network import IntegerMlp
from splatwire.entropy.tables import exp2_table
from splatwire.types.causal_coding import MASK_AND_SCALE, OCTAVES, CausalConfig

ONE = 1 << ACTIVATION_BITS
VALUE_BITS = 16
"""Fractional bits of an anchor's attributes, in units of quantisation steps."""
EXP2_CELLS = 10
"""log2 of the number of cells per octave in the table of powers of two, which is interpolated linearly."""
EXP2_BITS = 40


@dataclass(frozen=True)
class Stage:
    """Group of an anchor's attributes that one network predicts at once, such as the offsets.

    Stages are coded one after another. The values of earlier stages are inputs of the network.

    Attributes:
        name: Name of the network.
        first: Index of the stage's first value among all attribute values of an anchor.
        size: Number of attribute values of the stage.
        num_mask_logits: Number of mask logits (one per offset), which are the first outputs of the network; 0 in stages
            without masks.
    """

    name: str
    first: int
    size: int
    num_mask_logits: int = 0


def stages(config: CausalConfig) -> tuple[Stage, ...]:
    """Returns the stages (groups of attributes that are predicted together) in coding order.

    The order is: feature groups, masks and scale of the offsets, base sizes, offsets.
    """
    feature_stages, first = [], 0
    for group, size in enumerate(config.layout.feature_groups):
        feature_stages.append(Stage(f"feature{group}", first, size))
        first += size
    return (
        *feature_stages,
        Stage(MASK_AND_SCALE, first, 1, config.layout.num_offsets),
        Stage("size", first + 1, 3),
        Stage("offset", first + 4, 3 * config.layout.num_offsets),
    )


@dataclass(frozen=True, eq=False)
class CodingContext:
    """Networks and constants of the causal context model, shared by encoder and decoder.

    Attributes:
        config: Layout of the anchors, and number of outputs of the network of positions.
        middle: int64 (3), `CausalCoding.middle`, voxels.
        spread: int64 (3), `CausalCoding.spread`, voxels.
        networks: Networks by name.
        low_bit_probabilities: Probabilities of position bits, int64, see `CoarsePositions`.
    """

    config: CausalConfig
    middle: np.ndarray
    spread: np.ndarray
    networks: dict[str, IntegerMlp]
    low_bit_probabilities: np.ndarray

    @staticmethod
    def of(info: SideInfo) -> "CodingContext":
        """Creates the context from side information, with networks converted to integers."""
        networks = {name: network.integer() for name, network in info.networks.items()}
        return CodingContext(info.config, info.middle, info.spread, networks, info.positions.low_bit_probabilities)

    @functools.cached_property
    def stages(self) -> tuple[Stage, ...]:
        """Groups of attributes that are predicted together, in coding order."""
        return stages(self.config)

    def start(self, voxels: np.ndarray) -> "AutoregressivePredictor":
        """Starts the prediction of the attributes of anchors.

        Args:
            voxels: Positions of the anchors, voxels, int64 (n, 3).

        Returns:
            Object that predicts the groups of attributes one after another.
        """
        inputs = integer_position_inputs(voxels, self.middle, self.spread)
        return AutoregressivePredictor(self, self.networks["position"](inputs))


class AutoregressivePredictor:
    """Predicts the attributes of n anchors for entropy coding, one stage (group of attributes) after another.

    Each prediction depends on the anchors' positions and on the stages before it.

    Args:
        context: The stream's networks and constants. Each stage has one network.
        position_outputs: Outputs of the position network for the n anchors, int32 (n, outputs). They are inputs of the
            networks of all stages.

    Attributes:
        position_outputs: The same outputs with `ACTIVATION_BITS` fractional bits, float64 (n, outputs).
    """

    def __init__(self, context: CodingContext, position_outputs: np.ndarray) -> None:
        config = context.config
        self._context = context
        self._known = np.empty((len(position_outputs), config.context_dim + config.layout.feature_dim + 4))
        self.position_outputs = np.empty((len(position_outputs), config.context_dim))
        _network_kernels.to_inputs(position_outputs, self.position_outputs)
        self._known[:, : config.context_dim] = self.position_outputs

    def outputs(self) -> Iterator[tuple[Stage, np.ndarray]]:
        """Yields each stage in coding order, with the int32 outputs of its network.

        The caller must pass the decoded attributes of the stage to `add_values` before it requests the next stage.
        """
        for stage in self._context.stages:
            network = self._context.networks[stage.name]
            yield stage, network(self._known[:, : self._context.config.context_dim + stage.first])

    def add_values(self, stage: Stage, values: np.ndarray) -> None:
        """Adds the decoded attributes of a stage, int32 (n, size), to the inputs of the networks of later stages."""
        # Offsets, the last stage, are not inputs.
        first = self._context.config.context_dim + stage.first
        if first < self._known.shape[1]:
            kernels.values_to_inputs(values, self._known[:, first : first + stage.size])


def integer_position_inputs(voxels: np.ndarray, middle: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Computes the inputs of the position network: contracted coordinates and their positional encoding.

    Args:
        voxels: Positions of the anchors, voxels, int64 (n, 3).
        middle: `CausalCoding.middle`, voxels, int64 (3).
        spread: `CausalCoding.spread`, voxels, above 0, int64 (3).

    Returns:
        Network inputs in fixed point: whole numbers in units of `2**-ACTIVATION_BITS`, float64 (n, 3 (1 + octaves)),
        where `octaves` is the number of octaves of the positional encoding.
    """
    # The contraction compresses coordinates far from the centre. The encoding consists of triangle waves with doubling
    # frequencies.
    away = np.clip(voxels - middle, -(1 << 40), 1 << 40)
    relative = (away << ACTIVATION_BITS) // spread
    contracted = (np.clip(relative, -(1 << 40), 1 << 40) << ACTIVATION_BITS) // (ONE + np.abs(relative))
    waves = [contracted]
    for octave in range(1, OCTAVES + 1):
        waves.append(np.abs((((contracted << octave) - ONE) & (4 * ONE - 1)) - 2 * ONE) - ONE)
    return np.concatenate(waves, axis=1).astype(np.float64)


def deviation_indices(log_deviations: np.ndarray) -> np.ndarray:
    """Converts binary logarithms of standard deviations to indices in the coder's table, int16.

    Args:
        log_deviations: Binary logarithms in quantisation steps, int32, `OUTPUT_BITS` fractional bits.
    """
    indices = np.empty(log_deviations.shape, dtype=np.int16)
    kernels.deviation_indices(log_deviations, exp2_table(8, 20), indices)
    return indices


def dequantise_linear(quantised: np.ndarray, step: float | np.ndarray) -> np.ndarray:
    """Dequantises features or offsets by multiplication with the quantisation step.

    Args:
        quantised: Features or offsets in quantisation steps, fixed point with `VALUE_BITS` fractional bits, int32 (n,
            D). Each value is the predicted mean, which may be fractional, plus a whole number of steps.
        step: Quantisation step of all columns, or one step for each column.

    Returns:
        The dequantised values, float32 (n, D).
    """
    # The product is rounded once to float64 and once to float32, so that it is identical on every machine.
    return (quantised.astype(np.float64) * (step * 2.0**-VALUE_BITS)).astype(np.float32)


def dequantise_log_scalings(quantised: np.ndarray, info: SideInfo) -> np.ndarray:
    """Dequantises the logarithms of the scalings of anchors.

    Column 0 is the scale of the offsets; columns 1 to 3 are the base sizes of the Gaussians, one per axis.

    Args:
        quantised: Quantised logarithms, int32 (n, 4), in quantisation steps with `VALUE_BITS` fractional bits.
        info: Side information, which contains the quantisation steps and zero points of the logarithms.

    Returns:
        Binary logarithms, int64 (n, 4), `LOG_BITS` fractional bits.
    """
    step = info.steps_of_logs[[0, 1, 1, 1]]
    return ((quantised.astype(np.int64) * step) >> VALUE_BITS) + info.zero_points


def exponential(logs: np.ndarray) -> np.ndarray:
    """Returns two to the power of fixed-point logarithms as float32. The result is identical on every machine.

    Args:
        logs: Base-2 logarithms, int64, `LOG_BITS` fractional bits.
    """
    logs = np.clip(logs, -60 << LOG_BITS, 60 << LOG_BITS)
    whole, rest = logs >> LOG_BITS, logs & ((1 << LOG_BITS) - 1)
    table, shift = exp2_table(EXP2_CELLS, EXP2_BITS), LOG_BITS - EXP2_CELLS
    cell, fraction = rest >> shift, rest & ((1 << shift) - 1)
    mantissa = table[cell] + (((table[cell + 1] - table[cell]) * fraction) >> shift)
    return np.ldexp(mantissa.astype(np.float64), (whole - EXP2_BITS).astype(np.int32)).astype(np.float32)
