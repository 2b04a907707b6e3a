"""Quantises network weights to integers, with a separate step for each row and column.

Weights are rounded one after another. Each weight compensates for the rounding errors of earlier weights, which is
possible because the inputs of a layer are correlated (Babai, "On Lovasz' lattice reduction and the nearest lattice
point problem", 1986; Frantar et al., "GPTQ", 2023).
"""
# A weight is `q * step`, where the step of row i and column j is `row_steps[i] << column_shifts[j]` units of 2**-16.
# Rows with error-tolerant outputs, and columns of redundant inputs, take fewer bits.
# Let C = R R^T be the covariance of the inputs, with R upper triangular. R_jj is the part of the spread of input j that
# the inputs rounded later do not explain. The step of column j depends on R_jj.
# With rounding errors d of a row of weights, its output has the error variance |d R|**2. Successive rounding keeps
# component j of d R below half a step times R_jj.

from dataclasses import dataclass

import numpy as np

from splatwire.codec.fixed_point import ACTIVATION_BITS, WEIGHT_EXPONENT
from splatwire.codec.integer_network import IntegerLinear, IntegerMlp
from splatwire.entropy.integers import MAX_SYMBOL

BIAS_BITS = 12
"""Fractional bits of a bias."""

MAX_SHIFT = 12
MAX_STEP = 65535

FINE_WEIGHT = 128.0
"""Weights below this are integer multiples of `2**-WEIGHT_EXPONENT` in float32, too."""

RIDGE = 0.003
"""Ridge added to the variance of each input, as a fraction of the variance. It limits how much correlations in a sample
are used. With 0.001, 0.003 and 0.01 snowmiku_15k's networks took 53.5, 52.8 and 52.7 kB (with row scales only). With
0.001 and 8,000 anchors one network's error on other anchors was 1.5 times that on the sample.
"""


@dataclass(frozen=True, eq=False)
class QuantisedLinear:
    """Quantised layer of a network (affine map): integer weights with quantisation steps.

    Attributes:
        symbols: Quantised weights, int32 (out, in).
        row_steps: Quantisation step of each row, 1 to `MAX_STEP`, in units of `2**-WEIGHT_EXPONENT`, int64 (out).
        column_shifts: log2 of the factor on the step of each column, 0 to `MAX_SHIFT`, int64 (in).
        bias: Bias in units of `2**-BIAS_BITS`, int32 (out).
    """

    symbols: np.ndarray
    row_steps: np.ndarray
    column_shifts: np.ndarray
    bias: np.ndarray

    def integer(self) -> IntegerLinear:
        """Converts the layer to integers for bit-exact evaluation."""
        weight = self.symbols.astype(np.int64) * (self.row_steps[:, None] << self.column_shifts[None, :])
        bias = self.bias.astype(np.int64) << (ACTIVATION_BITS + WEIGHT_EXPONENT - BIAS_BITS)
        return IntegerLinear(weight, bias)

    def dequantised(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the weights (out, in) and the bias (out) as float32. The conversion is exact."""
        weight = self.symbols.astype(np.float64) * (self.row_steps[:, None] << self.column_shifts[None, :])
        return (weight * 2.0**-WEIGHT_EXPONENT).astype(np.float32), (self.bias * 2.0**-BIAS_BITS).astype(np.float32)


@dataclass(frozen=True, eq=False)
class QuantisedMlp:
    """A network of two quantised layers with a (leaky) ReLU in between.

    Attributes:
        hidden: First layer.
        output: Second layer.
        leaky: True for a leaky ReLU with slope 0.01.
    """

    hidden: QuantisedLinear
    output: QuantisedLinear
    leaky: bool

    def integer(self) -> IntegerMlp:
        """Converts the network to integers for bit-exact evaluation."""
        return IntegerMlp(self.hidden.integer(), self.output.integer(), self.leaky)


def quantise_linear(weight: np.ndarray, bias: np.ndarray, inputs: np.ndarray, tolerance: np.ndarray) -> QuantisedLinear:
    """Quantises the weights and bias of a layer as coarsely as the tolerated errors of its outputs allow.

    Args:
        weight: Weights of the layer, float (out, in).
        bias: Bias of the layer, float (out).
        inputs: Sample of the layer's inputs, float (n, in).
        tolerance: Tolerated error of each output, as a standard deviation, (out).

    Returns:
        The layer in integers.
    """
    mean, order, factor = _input_statistics(inputs)
    rest = np.diag(factor)
    shifts = np.clip(np.floor(np.log2(rest.max() / rest)), 0, MAX_SHIFT).astype(np.int64)
    # rounding errors are uniform: each contributes (step * rest)**2 / 12
    spread = np.sqrt((((2.0**shifts) * rest) ** 2).sum() / 12)
    # weights of 128 and more have coarser steps, so that the integers are exact in float32
    grain = 2.0 ** np.ceil(np.log2(np.maximum(np.abs(weight).max(axis=1, initial=0) / FINE_WEIGHT, 1)))
    steps = np.rint(tolerance / spread * 2.0**WEIGHT_EXPONENT / grain) * grain
    steps = np.clip(steps, grain, MAX_STEP // grain * grain).astype(np.int64)
    unit = (steps[:, None] << shifts[None, :]) * 2.0**-WEIGHT_EXPONENT
    symbols, error = _round_in_turn(weight[:, order], unit, factor / rest[None, :])
    back = np.argsort(order)
    whole = np.rint((bias + error[:, back] @ mean) * 2.0**BIAS_BITS).astype(np.int32)
    return QuantisedLinear(symbols[:, back], steps, shifts[back], whole)


def exact_mlp(
    hidden: tuple[np.ndarray, np.ndarray], output: tuple[np.ndarray, np.ndarray], *, leaky: bool
) -> QuantisedMlp | None:
    """Converts a network to quantised form without rounding, which is possible for decoded networks.

    Args:
        hidden: Weight (hidden, in) and bias of the first layer.
        output: Weight (out, hidden) and bias of the second.
        leaky: True for a leaky ReLU with slope 0.01 below zero, False for a ReLU.

    Returns:
        The quantised network; None if quantised integers cannot represent the given numbers exactly.
    """
    first, second = exact_linear(*hidden), exact_linear(*output)
    return None if first is None or second is None else QuantisedMlp(first, second, leaky)


def exact_linear(weight: np.ndarray, bias: np.ndarray) -> QuantisedLinear | None:
    """Converts a layer to quantised form without rounding, which is possible for decoded layers.

    Args:
        weight: Weights of the layer, float (out, in).
        bias: Bias of the layer, float (out).

    Returns:
        The layer; None if the format cannot represent its numbers exactly.
    """
    whole, base = weight * 2.0**WEIGHT_EXPONENT, bias * 2.0**BIAS_BITS
    if not (_is_whole(whole, 2.0**48) and _is_whole(base, float(MAX_SYMBOL))):
        return None
    units = whole.astype(np.int64)
    is_nonzero, twos = units != 0, np.log2(np.maximum(units & -units, 1)).astype(np.int64)  # powers of 2 in each weight
    # Several combinations of steps represent the same numbers. Two are tried, and the one with fewer bits is returned.
    candidates = []
    for rows_first in (True, False):
        shifts = np.zeros(units.shape[1], np.int64) if rows_first else _common_trailing_zeros(twos, is_nonzero, axis=0)
        shifts = _common_trailing_zeros(
            twos - _common_trailing_zeros(twos - shifts, is_nonzero, axis=1)[:, None], is_nonzero, axis=0
        )
        steps = np.array([_divisor(int(step)) for step in np.gcd.reduce(units >> shifts, axis=1)], dtype=np.int64)
        candidates.append((units // (steps[:, None] << shifts), steps, shifts))
    symbols, steps, shifts = min(candidates, key=lambda parts: float(np.log2(1 + np.abs(parts[0])).sum()))
    if np.abs(symbols).max(initial=0) > MAX_SYMBOL:
        return None
    return QuantisedLinear(symbols.astype(np.int32), steps, shifts, base.astype(np.int32))


def _common_trailing_zeros(exponents: np.ndarray, nonzero: np.ndarray, axis: int) -> np.ndarray:
    """Returns, for each row or each column of a matrix, log2 of the largest power of two that divides all its weights.

    Args:
        exponents: log2 of the largest power of two that divides each weight.
        nonzero: Mask of non-zero weights; the others are ignored.
        axis: 0 for one result per column, 1 for one result per row.
    """
    least = np.where(nonzero, exponents, MAX_SHIFT).min(axis=axis, initial=MAX_SHIFT)
    return np.maximum(np.where(nonzero.any(axis=axis), least, 0), 0)


def _is_whole(values: np.ndarray, max_magnitude: float) -> bool:
    """True if all values are integers whose magnitude is at most `max_magnitude`."""
    return bool((np.abs(values) <= max_magnitude).all() and (values == np.rint(values)).all())


def _divisor(number: int) -> int:
    """Returns the largest permitted quantisation step, 1 to `MAX_STEP`, that divides a number; 1 for the number 0."""
    if number <= MAX_STEP:
        return max(number, 1)
    smaller = np.arange(1, MAX_STEP + 1)
    return int(smaller[number % smaller == 0][-1])


def _input_statistics(inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns statistics of a layer's inputs, used to round its weights with a small output error.

    Returns:
        Mean of each input, (in); indices of the inputs by decreasing variance, (in); and triangular factor of the
        covariance matrix of the inputs in this order, (in, in).
    """
    mean = inputs.mean(axis=0)
    centred = inputs - mean
    covariance = centred.T @ centred / len(inputs)
    variance = np.diag(covariance)
    # keeps the step of a nearly constant input finite
    covariance = covariance + np.diag(RIDGE * variance + 1e-9 * variance.max() + 1e-18)
    order = np.argsort(-variance, kind="stable")
    reverse = np.linalg.cholesky(covariance[np.ix_(order[::-1], order[::-1])])
    return mean, order, reverse[::-1, ::-1]


def _round_in_turn(weight: np.ndarray, unit: np.ndarray, unit_factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rounds a weight matrix column by column; each column compensates the rounding errors of earlier columns.

    Args:
        weight: Weights before quantisation, float (out, in).
        unit: Quantisation step of each weight, float (out, in).
        unit_factor: Upper triangular factor of the inputs' covariance, each column divided by its diagonal entry, float
            (in, in).

    Returns:
        Quantised weights in steps, int32 (out, in), and rounding errors, float (out, in).
    """
    symbols, error = np.zeros(weight.shape, dtype=np.int32), np.zeros_like(weight)
    for j in range(weight.shape[1]):
        wanted = weight[:, j] + error[:, :j] @ unit_factor[:j, j]
        symbols[:, j] = np.rint(wanted / unit[:, j])
        error[:, j] = weight[:, j] - symbols[:, j] * unit[:, j]
    return symbols, error


def quantise_mlp(
    hidden: tuple[np.ndarray, np.ndarray],
    output: tuple[np.ndarray, np.ndarray],
    inputs: np.ndarray,
    tolerance: np.ndarray,
    *,
    leaky: bool,
) -> QuantisedMlp:
    """Quantises a network as coarsely as the tolerated errors of its outputs allow.

    Args:
        hidden: Weight (hidden, in) and bias of the first layer.
        output: Weight (out, hidden) and bias of the second layer.
        inputs: Sample of inputs, float (n, in).
        tolerance: Tolerated error of each output, as a standard deviation, (out).
        leaky: True for a leaky ReLU with slope 0.01 below zero, False for a ReLU.

    Returns:
        The network in integers.
    """
    pre = inputs @ hidden[0].T + hidden[1]
    active, post = (pre > 0).mean(axis=0), _activation(pre, leaky)
    sensitivity = np.sqrt(((output[0] / tolerance[:, None]) ** 2).mean(axis=0) * np.maximum(active, 1e-3))
    first_tolerance = 1.0 / np.maximum(sensitivity * np.sqrt(len(active)), 1e-6)
    first = quantise_linear(hidden[0], hidden[1], inputs, first_tolerance)
    weight, bias = (array.astype(np.float64) for array in first.dequantised())
    rounded = _activation(inputs @ weight.T + bias, leaky)
    second = quantise_linear(*_refitted(output, post, rounded), rounded, tolerance)
    return QuantisedMlp(first, second, leaky)


def _activation(pre: np.ndarray, leaky: bool) -> np.ndarray:
    return np.where(pre > 0, pre, 0.01 * pre if leaky else 0.0)


def _refitted(
    output: tuple[np.ndarray, np.ndarray], inputs: np.ndarray, rounded: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Refits the second layer of a network by least squares, to compensate for the quantisation of its first layer.

    Args:
        output: Weight (out, hidden) and bias (out) of the second layer.
        inputs: Outputs of the exact first layer for a sample, (n, hidden).
        rounded: Outputs of the quantised first layer for the same sample, (n, hidden).

    Returns:
        Weight and bias of the refitted layer.
    """
    weight, bias = output
    centred = rounded - rounded.mean(axis=0)
    lacking = (inputs - inputs.mean(axis=0) - centred) @ weight.T
    variance = (centred**2).sum(axis=0)
    gram = centred.T @ centred + np.diag(RIDGE * variance + 1e-9 * variance.max() + 1e-18)
    weight = weight + np.linalg.solve(gram, centred.T @ lacking).T
    return weight, bias + inputs.mean(axis=0) @ output[0].T - rounded.mean(axis=0) @ weight.T
