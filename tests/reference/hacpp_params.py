"""The coding parameters in plain torch: the reference of `coding_params`, equal on any device.

Integers are int64. Matrix products use float64 and are exact, because every partial sum is below 2**53.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from splatwire.codec.anchors.hacpp.coding_params import CodingContext, factor_table, inverse_step_table, prior_columns
from splatwire.codec.anchors.hacpp.grid_lookup import grid_levels
from splatwire.codec.fixed_point import (
    ACTIVATION_BITS,
    ACTIVATION_LIMIT,
    CELL_BITS,
    FACTOR_BITS,
    OUTPUT_BITS,
    OUTPUT_LIMIT,
    STEP_CELLS,
    STEP_LIMIT,
    UNIT_BITS,
    WEIGHT_EXPONENT,
)
from splatwire.codec.integer_network import IntegerLinear, IntegerMlp

_PRIMES = (1, 2654435761, 805459861)


@dataclass(frozen=True, eq=False)
class ReferenceIndices:
    """Table indices of one normal per channel.

    Attributes:
        mean: In quantisation steps, 12 fractional bits.
        scale: Index into the scale table.
    """

    mean: Int64[Tensor, "N D"]
    scale: Int64[Tensor, "N D"]


def context_feature(context: CodingContext, units: Int64[Tensor, "N 3"]) -> Float64[Tensor, "N H"]:
    """Interpolates the grid; whole numbers with `ACTIVATION_BITS` fractional bits.

    Args:
        context: Side information in integers.
        units: Positions in the grid's box, `UNIT_BITS` fractional bits.
    """
    signs = torch.from_numpy(context.signs).to(units.device, torch.int64)
    levels, blocks = grid_levels(context.config.grid), []
    one = 1 << CELL_BITS
    for start, resolution, rows, axes in zip(
        levels.starts.tolist(), levels.resolutions.tolist(), levels.rows.tolist(), levels.axes.tolist(), strict=True
    ):
        at = units[:, [a for a in axes if a >= 0]]
        inside = ((at >= 0) & (at <= 1 << UNIT_BITS)).all(dim=1, keepdim=True)
        scaled = (at * inside * (resolution - 2) + (1 << (UNIT_BITS - 1))) >> (UNIT_BITS - CELL_BITS)
        cell, fraction = scaled >> CELL_BITS, scaled & (one - 1)
        total = torch.zeros(len(units), signs.shape[1], dtype=torch.int64, device=units.device)
        weight_sum = torch.zeros(len(units), 1, dtype=torch.int64, device=units.device)
        for corner in range(1 << at.shape[1]):
            bits = torch.tensor([(corner >> i) & 1 for i in range(at.shape[1])], device=units.device)
            where = cell + bits
            along = torch.where(bits == 1, fraction, one - fraction)
            weight = torch.where((where <= 0) | (where >= resolution - 1), 0, along).prod(dim=1, keepdim=True)
            total = total + weight * signs[start + _rows(where, resolution, rows)]
            weight_sum = weight_sum + weight
        value = torch.div(total << ACTIVATION_BITS, weight_sum.clamp(min=1), rounding_mode="floor")
        blocks.append(value * inside)
    return torch.cat(blocks, dim=1).double()


def _rows(corner: Int64[Tensor, "N A"], resolution: int, rows: int) -> Int64[Tensor, "N"]:
    dims = corner.shape[1]
    if resolution**dims <= rows:
        return sum(corner[:, a] * resolution**a for a in range(dims)) % rows
    hashed = torch.zeros_like(corner[:, 0])
    for axis in range(dims):
        hashed = hashed ^ ((corner[:, axis] * _PRIMES[axis]) & 0xFFFFFFFF)
    return hashed % rows


def evaluate(network: IntegerMlp, inputs: Float64[Tensor, "N I"]) -> Int64[Tensor, "N O"]:
    """Evaluates an integer network; inputs with `ACTIVATION_BITS`, outputs with `OUTPUT_BITS` fractional bits."""
    hidden = _affine(network.hidden, inputs) >> WEIGHT_EXPONENT
    below = (hidden * 655) >> 16 if network.leaky else torch.zeros_like(hidden)
    hidden = torch.where(hidden < 0, below, hidden).clamp(-ACTIVATION_LIMIT, ACTIVATION_LIMIT)
    shift = ACTIVATION_BITS + WEIGHT_EXPONENT - OUTPUT_BITS
    return (_affine(network.output, hidden.double()) >> shift).clamp(-OUTPUT_LIMIT, OUTPUT_LIMIT)


def _affine(layer: IntegerLinear, inputs: Float64[Tensor, "N I"]) -> Int64[Tensor, "N O"]:
    weight = torch.from_numpy(layer.weight).to(inputs.device)
    return (inputs @ weight.double().T).long() + torch.from_numpy(layer.bias).to(inputs.device)


def step_index(outputs: Int64[Tensor, "N P"], context: CodingContext) -> Int64[Tensor, "N 3"]:
    """Entries of the step table for feature, scaling and offset."""
    first = prior_columns(context.config).steps
    cell = (1 << OUTPUT_BITS) // STEP_CELLS
    index = torch.div(outputs[:, first : first + 3] + cell // 2, cell, rounding_mode="floor")
    return (index + STEP_LIMIT * STEP_CELLS).clamp(0, 2 * STEP_LIMIT * STEP_CELLS)


def normal_indices(
    mean: Int64[Tensor, "N D"], scale: Int64[Tensor, "N D"], step: Int64[Tensor, "N"], base: float
) -> ReferenceIndices:
    """Table indices of outputs that are a mean and a standard deviation.

    Args:
        mean: Outputs, `OUTPUT_BITS` fractional bits.
        scale: Outputs.
        step: Entry of the step table of each anchor.
        base: Base step of the attribute.
    """
    inverse = torch.from_numpy(inverse_step_table(base).copy()).to(mean.device)[step][:, None]
    steps = ((mean * inverse) >> 20).clamp(-(2**31 - 1), 2**31 - 1)
    value = ((scale.clamp(min=1) * inverse) >> 20).clamp(64, 2**26 - 1)
    exponent = sum((value >> e > 0).long() for e in range(7, 26)) + 6
    return ReferenceIndices(steps, (exponent - 6) * 16 + ((value >> (exponent - 4)) & 15))


def group_outputs(
    context: CodingContext,
    group: int,
    outputs: Int64[Tensor, "N P"],
    symbols: Int64[Tensor, "N D"],
    factors: Int64[Tensor, "N"],
) -> Int64[Tensor, "N O"]:
    """Outputs of a channel network.

    Args:
        context: Side information in integers.
        group: Feature group.
        outputs: Prior outputs.
        symbols: Feature symbols of the groups before.
        factors: Feature step factors.
    """
    base = round(context.config.base_steps[0] * (1 << 16))
    steps = (factors * base) >> (FACTOR_BITS - 4)
    values = ((symbols * steps[:, None]) >> (20 - ACTIVATION_BITS)).clamp(-ACTIVATION_LIMIT, ACTIVATION_LIMIT)
    prior = outputs[:, : 3 * context.config.layout.feature_dim] >> (OUTPUT_BITS - ACTIVATION_BITS)
    return evaluate(context.channel[group], torch.cat([values, prior], dim=1).double())


def weight_index(prior: Int64[Tensor, "N D"], group: Int64[Tensor, "N D"]) -> Int64[Tensor, "N D"]:
    """Index of the mixture weight from the two logits, `OUTPUT_BITS` fractional bits."""
    return (((prior - group + 2048) >> 12) + 128).clamp(0, 255)


def step_factors(step: Int64[Tensor, "N 3"]) -> Int64[Tensor, "N 3"]:
    """Step factors, `FACTOR_BITS` fractional bits, of entries of the step table."""
    return torch.from_numpy(factor_table().copy()).to(step.device)[step]
