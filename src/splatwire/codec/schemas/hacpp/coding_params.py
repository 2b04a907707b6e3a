"""The determinism wall: from positions and side information to the table indices that the entropy coder sees.

Everything here is integer arithmetic (matrix products are carried in float64, whose mantissa holds every partial sum
exactly), and depends on nothing but the anchor's own position, its own decoded symbols and the side information.
`tests/reference/hacpp_params.py` says the same in plain torch.
"""

import functools
from dataclasses import dataclass

import numpy as np

from splatwire.codec.fixed_point import (
    FACTOR_BITS,
    INVERSE_STEP_BITS,
    OUTPUT_BITS,
    STEP_CELLS,
    STEP_LIMIT,
)
from splatwire.codec.integer_network import IntegerMlp
from splatwire.codec.schemas.hacpp.grid_lookup import lookup, unit_coordinates
from splatwire.entropy.tables import step_table
from splatwire.model.config import ModelConfig


@dataclass(frozen=True)
class PriorColumns:
    """Where each quantity stands among the outputs of the prior network (HAC++)."""

    feature_mean: int
    feature_scale: int
    feature_weight: int
    scaling_mean: int
    scaling_scale: int
    offset_mean: int
    offset_scale: int
    steps: int


def prior_columns(config: ModelConfig) -> PriorColumns:
    """Lays out the outputs of the prior network."""
    f, o = config.layout.feature_dim, 3 * config.layout.num_offsets
    return PriorColumns(0, f, 2 * f, 3 * f, 3 * f + 6, 3 * f + 12, 3 * f + 12 + o, 3 * f + 12 + 2 * o)


def factor_table() -> np.ndarray:
    """The factors `1 + tanh(q)` that a quantisation step can have, `FACTOR_BITS` fractional bits."""
    return step_table(STEP_CELLS, STEP_LIMIT, FACTOR_BITS)


@functools.cache
def inverse_step_table(base: float) -> np.ndarray:
    """Reciprocals of all quantisation steps of an attribute, `INVERSE_STEP_BITS` fractional bits.

    Args:
        base: The attribute's base step, world units.

    Returns:
        int64, one entry for each entry of `factor_table`.
    """
    # one correctly rounded division and one correctly rounded product for each entry
    numerator = float(1 << (INVERSE_STEP_BITS + FACTOR_BITS)) / base
    return np.array([round(numerator / int(f)) for f in factor_table()], dtype=np.int64)


def step_indices(outputs: np.ndarray, config: ModelConfig) -> np.ndarray:
    """Entries of the step table for feature, scaling and offset of each anchor.

    Args:
        outputs: int32 (N, prior outputs), `OUTPUT_BITS` fractional bits.
        config: Shape of the model.

    Returns:
        int64 (N, 3).
    """
    first = prior_columns(config).steps
    q = outputs[:, first : first + 3].astype(np.int64)
    half = STEP_LIMIT * STEP_CELLS
    shift = OUTPUT_BITS - (STEP_CELLS.bit_length() - 1)
    return np.clip(((q + (1 << (shift - 1))) >> shift) + half, 0, 2 * half)


def dequantise(symbols: np.ndarray, factors: np.ndarray, base: float) -> np.ndarray:
    """Value of symbols: `symbol * base * factor`, one rounding to float64 and one to float32.

    Args:
        symbols: int32 (N, D).
        factors: int64 (N), `FACTOR_BITS` fractional bits.
        base: The attribute's base step.

    Returns:
        float32 (N, D).
    """
    whole = symbols.astype(np.int64) * factors[:, None]
    return (whole.astype(np.float64) * (base / (1 << FACTOR_BITS))).astype(np.float32)


def quantise(values: np.ndarray, factors: np.ndarray, base: float) -> np.ndarray:
    """Symbols nearest to `values`; the inverse of `dequantise`.

    Args:
        values: float (N, D).
        factors: int64 (N), `FACTOR_BITS` fractional bits.
        base: The attribute's base step.

    Returns:
        int32 (N, D).
    """
    step = factors.astype(np.float64)[:, None] * (base / (1 << FACTOR_BITS))
    return np.rint(values.astype(np.float64) / step).astype(np.int32)


@dataclass(frozen=True, eq=False)
class CodingContext:
    """Everything that both ends of a stream predict from.

    Attributes:
        config: Shape of the model.
        voxel_size: World units per voxel.
        bounds_min: float32 (3), lower corner of the grid's box.
        bounds_max: float32 (3), upper corner.
        signs: int8 (rows, D), all grid levels.
        prior: Hash-grid feature to prior outputs.
        channel: One network per feature group.
    """

    config: ModelConfig
    voxel_size: float
    bounds_min: np.ndarray
    bounds_max: np.ndarray
    signs: np.ndarray
    prior: IntegerMlp
    channel: tuple[IntegerMlp, ...]

    def units(self, voxels: np.ndarray) -> np.ndarray:
        """Fixed-point positions, int64 (N, 3), of anchors at voxel indices int64 (N, 3)."""
        return unit_coordinates(voxels, self.voxel_size, self.bounds_min, self.bounds_max)

    def predict(self, voxels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluates grid and prior network.

        Args:
            voxels: int64 (N, 3).

        Returns:
            The context, float64 (N, H) whole numbers with `ACTIVATION_BITS` fractional bits, and the prior outputs,
            int32 with `OUTPUT_BITS` fractional bits.
        """
        context = lookup(self.units(voxels), self.signs, self.config.grid)
        return context, self.prior(context)

    @functools.cached_property
    def shared_matrix(self) -> np.ndarray:
        """First-layer columns of all channel networks that read the prior, side by side, float64 (3 F, hidden sum)."""
        before = np.cumsum([0, *self.config.layout.feature_groups])
        return np.concatenate(
            [mlp.hidden.matrix[size:] for mlp, size in zip(self.channel, before[:-1], strict=True)], axis=1
        )

    def shared_sums(self, outputs: np.ndarray) -> list[np.ndarray]:
        """First-layer sums of every channel network over the prior's mean, scale and weight.

        Args:
            outputs: int32 (N, prior outputs).

        Returns:
            One float64 (N, hidden) array of whole numbers for each feature group.
        """
        from splatwire.codec import _network_kernels as kernels

        inputs = np.empty((len(outputs), 3 * self.config.layout.feature_dim), dtype=np.float64)
        kernels.narrow(outputs, inputs)
        sums = inputs @ self.shared_matrix
        edges = np.cumsum([len(mlp.hidden.weight) for mlp in self.channel])[:-1]
        return np.split(sums, edges, axis=1)

    def channel_outputs(self, group: int, shared: np.ndarray, activations: np.ndarray) -> np.ndarray:
        """Evaluates the channel network of a group.

        Args:
            group: Which group.
            shared: The group's entry of `shared_sums`.
            activations: float64 (N, channels of the groups before) from `feature_activations`.

        Returns:
            int32 (N, 3 * size of the group): mean, scale and weight of the group's channels.
        """
        sums = shared.copy()
        if activations.shape[1]:
            sums += self.channel[group].accumulate(activations, slice(0, activations.shape[1]))
        return self.channel[group].finish(sums)

    def feature_activations(self, symbols: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """Decoded features as inputs of the channel networks.

        Args:
            symbols: int32 (N, channels).
            factors: int64 (N), step factors of the feature.

        Returns:
            float64 (N, channels) whole numbers, `ACTIVATION_BITS` fractional bits.
        """
        from splatwire.codec import _network_kernels as kernels

        activations = np.empty(symbols.shape, dtype=np.float64)
        columns = np.ascontiguousarray(symbols), np.ascontiguousarray(factors)  # one type, so one compiled version
        kernels.feature_activations(*columns, round(self.config.base_steps[0] * (1 << 16)), activations)
        return activations
