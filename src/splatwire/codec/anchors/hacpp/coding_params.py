"""Predicts the distributions of HAC++ anchors' attributes for entropy coding, in integer arithmetic."""
# A prediction depends only on the anchor's position, its symbols decoded before, and the side information. Matrix
# products use float64, which represents every partial sum exactly. `tests/reference/hacpp_params.py` is an equivalent
# implementation in plain torch.

import functools
from dataclasses import dataclass

import numpy as np

from splatwire.codec import _network_kernels as kernels
from splatwire.codec.anchors.hacpp.grid_lookup import lookup, unit_coordinates
from splatwire.codec.fixed_point import FACTOR_BITS, INVERSE_STEP_BITS, OUTPUT_BITS, STEP_CELLS, STEP_LIMIT
from splatwire.codec.integer_network import IntegerMlp
from splatwire.entropy.tables import step_table
from splatwire.types.anchor_config import HacppConfig


@dataclass(frozen=True)
class PriorColumns:
    """Index of the first column of each kind of prediction in the outputs of the prior network (HAC++).

    Attributes:
        feature_mean: Means of the F feature channels.
        feature_scale: Standard deviations of the F feature channels.
        feature_weight: Logits of the mixture weights of the F feature channels.
        scaling_mean: Means of the six scalings.
        scaling_scale: Standard deviations of the six scalings.
        offset_mean: Means of the 3 K offset coordinates.
        offset_scale: Standard deviations of the 3 K offset coordinates.
        steps: Three columns that determine the quantisation steps of feature, scaling and offset.
    """

    feature_mean: int
    feature_scale: int
    feature_weight: int
    scaling_mean: int
    scaling_scale: int
    offset_mean: int
    offset_scale: int
    steps: int


def prior_columns(config: HacppConfig) -> PriorColumns:
    """Returns the first column of each kind of prediction in the outputs of the prior network."""
    f, o = config.layout.feature_dim, 3 * config.layout.num_offsets
    return PriorColumns(0, f, 2 * f, 3 * f, 3 * f + 6, 3 * f + 12, 3 * f + 12 + o, 3 * f + 12 + 2 * o)


def factor_table() -> np.ndarray:
    """Returns the factors `1 + tanh(q)` on quantisation steps, for all values q of the network's output.

    Returns:
        The factors, int64, in fixed point with `FACTOR_BITS` fractional bits.
    """
    return step_table(STEP_CELLS, STEP_LIMIT, FACTOR_BITS)


@functools.cache
def inverse_step_table(base: float) -> np.ndarray:
    """Returns the reciprocals of all possible quantisation steps of an attribute, `INVERSE_STEP_BITS` fractional bits.

    Args:
        base: Base step of the attribute; a quantisation step is the base step times an entry of `factor_table`.

    Returns:
        The reciprocals, int64, one for each entry of `factor_table`.
    """
    # one correctly rounded division and one correctly rounded product for each entry
    numerator = float(1 << (INVERSE_STEP_BITS + FACTOR_BITS)) / base
    return np.array([round(numerator / int(f)) for f in factor_table()], dtype=np.int64)


def step_indices(outputs: np.ndarray, config: HacppConfig) -> np.ndarray:
    """Returns the quantisation steps of feature, scaling and offset of each anchor, as indices into `factor_table`.

    Args:
        outputs: Outputs of the prior network for N anchors, int32 (N, prior outputs), `OUTPUT_BITS` fractional bits.
        config: Sizes of the model's networks and tables.

    Returns:
        The indices, int64 (N, 3).
    """
    first = prior_columns(config).steps
    q = outputs[:, first : first + 3].astype(np.int64)
    half = STEP_LIMIT * STEP_CELLS
    shift = OUTPUT_BITS - (STEP_CELLS.bit_length() - 1)
    return np.clip(((q + (1 << (shift - 1))) >> shift) + half, 0, 2 * half)


def dequantise(symbols: np.ndarray, factors: np.ndarray, base: float) -> np.ndarray:
    """Dequantises an attribute of anchors, identically on every machine.

    Args:
        symbols: The attribute in quantisation steps, int32 (N, D).
        factors: Factor on the quantisation step of each anchor, int64 (N), `FACTOR_BITS` fractional bits.
        base: Base quantisation step of the attribute. The quantisation step of an anchor is this step times the
            anchor's factor.

    Returns:
        The attribute, float32 (N, D).
    """
    # The product is rounded once to float64 and once to float32.
    whole = symbols.astype(np.int64) * factors[:, None]
    return (whole.astype(np.float64) * (base / (1 << FACTOR_BITS))).astype(np.float32)


def quantise(values: np.ndarray, factors: np.ndarray, base: float) -> np.ndarray:
    """Quantises an attribute of anchors to integers; `dequantise` is the inverse.

    Args:
        values: The attribute, float (N, D).
        factors: Factor on the quantisation step of each anchor, int64 (N), `FACTOR_BITS` fractional bits.
        base: Base quantisation step of the attribute. The quantisation step of an anchor is this step times the
            anchor's factor.

    Returns:
        The attribute in quantisation steps, int32 (N, D).
    """
    step = factors.astype(np.float64)[:, None] * (base / (1 << FACTOR_BITS))
    return np.rint(values.astype(np.float64) / step).astype(np.int32)


@dataclass(frozen=True, eq=False)
class CodingContext:
    """Networks and constants for prediction, shared by encoder and decoder.

    Attributes:
        config: Sizes of the model's networks and tables.
        voxel_size: World units per voxel.
        bounds_min: Lower corner of the hash grid's bounding box, world units, float32 (3).
        bounds_max: Upper corner of the bounding box, world units, float32 (3).
        signs: Binary hash tables of all grid levels, one after another, int8 (rows, D), entries -1 or +1.
        prior: Network that predicts the distributions of all attributes from the hash-grid feature of an anchor.
        channel: One network for each feature group, which predicts the group from the groups before it.
    """

    config: HacppConfig
    voxel_size: float
    bounds_min: np.ndarray
    bounds_max: np.ndarray
    signs: np.ndarray
    prior: IntegerMlp
    channel: tuple[IntegerMlp, ...]

    def units(self, voxels: np.ndarray) -> np.ndarray:
        """Converts voxels, int64 (N, 3), to fixed-point coordinates in the grid's bounding box, int64 (N, 3)."""
        return unit_coordinates(voxels, self.voxel_size, self.bounds_min, self.bounds_max)

    def predict(self, voxels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Predicts the attributes of anchors from their positions, with the hash grid and the prior network.

        Args:
            voxels: Positions of the anchors, voxels, int64 (N, 3).

        Returns:
            Hash-grid features, float64 (N, H), with `ACTIVATION_BITS` fractional bits; and outputs of the prior
            network, int32 (N, prior outputs) with `OUTPUT_BITS` fractional bits.
        """
        context = lookup(self.units(voxels), self.signs, self.config.grid)
        return context, self.prior(context)

    @functools.cached_property
    def shared_matrix(self) -> np.ndarray:
        """First-layer weights by which the channel networks multiply outputs of the prior network.

        float64 (3 F, hidden). Rows are the outputs of the prior network that predict features. Columns are the hidden
        units of all channel networks, one network after another.
        """
        group_starts = np.cumsum([0, *self.config.layout.feature_groups])
        return np.concatenate(
            [mlp.hidden.matrix[start:] for mlp, start in zip(self.channel, group_starts[:-1], strict=True)], axis=1
        )

    def shared_sums(self, outputs: np.ndarray) -> list[np.ndarray]:
        """Multiplies the outputs of the prior network by the first-layer weights of all channel networks.

        These outputs are inputs of every channel network, so one matrix product serves all.

        Args:
            outputs: Outputs of the prior network for N anchors, int32 (N, prior outputs).

        Returns:
            For each channel network, the partial sums of its hidden units, float64 (N, hidden).
        """
        # Each channel network predicts one feature group. All of them have the outputs of the prior network among their
        # inputs, so this part of their first layers is computed in one matrix product.
        inputs = np.empty((len(outputs), 3 * self.config.layout.feature_dim), dtype=np.float64)
        kernels.to_inputs(outputs, inputs)
        sums = inputs @ self.shared_matrix
        edges = np.cumsum([len(mlp.hidden.weight) for mlp in self.channel])[:-1]
        return np.split(sums, edges, axis=1)

    def channel_outputs(self, group: int, shared: np.ndarray, activations: np.ndarray) -> np.ndarray:
        """Predicts one group of feature channels from the groups before it, with the group's channel network.

        Args:
            group: Index of the group of feature channels.
            shared: Result of `shared_sums` for the group.
            activations: Features of the preceding groups, from `feature_activations`, float64 (N, channels of the
                preceding groups).

        Returns:
            int32 (N, 3 * size of the group): means, standard deviations and weight logits of the group's channels.
        """
        sums = shared.copy()
        if activations.shape[1]:
            sums += self.channel[group].accumulate(activations, slice(0, activations.shape[1]))
        return self.channel[group].finish(sums)

    def feature_activations(self, symbols: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """Converts decoded features to inputs of the channel networks, which predict later features.

        Args:
            symbols: Decoded features in quantisation steps, int32 (N, channels).
            factors: Factor on the quantisation step of each anchor's features, int64 (N).

        Returns:
            float64 (N, channels), whole numbers with `ACTIVATION_BITS` fractional bits.
        """
        activations = np.empty(symbols.shape, dtype=np.float64)
        columns = np.ascontiguousarray(symbols), np.ascontiguousarray(factors)  # one compiled version
        kernels.feature_activations(*columns, round(self.config.base_steps[0] * (1 << 16)), activations)
        return activations
