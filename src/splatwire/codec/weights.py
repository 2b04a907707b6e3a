"""Network weights as integers: how coarse each may be, and the dyadic numbers that both ends compute with.

A weight is `q * step`, where the step of row i and column j is `row_steps[i] << column_shifts[j]` units of 2**-16: rows
whose output tolerates more noise, and columns whose input says little that others do not, take fewer bits.

Inputs of a layer are correlated, so the error of one rounded weight can be made up for by the weights that are not
rounded yet: successive rounding to the nearest plane (Babai, "On Lovasz' lattice reduction and the nearest lattice
point problem", 1986; for networks: Frantar et al., "GPTQ", 2023). With the inputs' covariance C = R R^T, R upper
triangular, an error d of a row costs |d R|**2, and component j of d R can be held below half a step times R_jj. So
R_jj, the spread of input j that the inputs rounded after it do not explain, takes the place of the input's own.
"""

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
"""Weights below this are whole multiples of `2**-WEIGHT_EXPONENT` in float32, too."""

RIDGE = 0.003
"""Added to the variance of each input, as a share of it: correlations of a sample are not relied upon beyond that.
With 0.001, 0.003 and 0.01 snowmiku_15k's networks took 53.5, 52.8 and 52.7 kB (with scales by row only); with 0.001 and
8,000 anchors one network's error on other anchors was half as large again as on these."""


@dataclass(frozen=True, eq=False)
class QuantisedLinear:
    """An affine layer as it is sent.

    Attributes:
        symbols: int32 (out, in).
        row_steps: int64 (out), 1 to `MAX_STEP`, units of `2**-WEIGHT_EXPONENT`.
        column_shifts: int64 (in), 0 to `MAX_SHIFT`.
        bias: int32 (out), units of `2**-BIAS_BITS`.
    """

    symbols: np.ndarray
    row_steps: np.ndarray
    column_shifts: np.ndarray
    bias: np.ndarray

    def integer(self) -> IntegerLinear:
        """The layer in the integers that the coding path computes with."""
        weight = self.symbols.astype(np.int64) * (self.row_steps[:, None] << self.column_shifts[None, :])
        bias = self.bias.astype(np.int64) << (ACTIVATION_BITS + WEIGHT_EXPONENT - BIAS_BITS)
        return IntegerLinear(weight, bias)

    def dequantised(self) -> tuple[np.ndarray, np.ndarray]:
        """Weight and bias as float32, exactly the numbers that `integer` stands for."""
        weight = self.symbols.astype(np.float64) * (self.row_steps[:, None] << self.column_shifts[None, :])
        return (weight * 2.0**-WEIGHT_EXPONENT).astype(np.float32), (self.bias * 2.0**-BIAS_BITS).astype(np.float32)


@dataclass(frozen=True, eq=False)
class QuantisedMlp:
    """Two quantised layers.

    Attributes:
        hidden: First layer.
        output: Second layer.
        leaky: Slope 0.01 below zero instead of 0.
    """

    hidden: QuantisedLinear
    output: QuantisedLinear
    leaky: bool

    def integer(self) -> IntegerMlp:
        """The network in integers."""
        return IntegerMlp(self.hidden.integer(), self.output.integer(), self.leaky)


def quantise_linear(weight: np.ndarray, bias: np.ndarray, inputs: np.ndarray, noise: np.ndarray) -> QuantisedLinear:
    """Rounds a layer so that each output's rounding noise stays near a given level.

    Args:
        weight: float (out, in).
        bias: float (out); takes up the mean of the rounding error.
        inputs: Sample of inputs, float (n, in).
        noise: (out), tolerated standard deviation of the error of each output.

    Returns:
        The layer in integers.
    """
    mean, order, factor = _explained(inputs)
    rest = np.diag(factor)
    shifts = np.clip(np.floor(np.log2(rest.max() / rest)), 0, MAX_SHIFT).astype(np.int64)
    # rounding errors are uniform: each contributes (step * rest)**2 / 12
    spread = np.sqrt((((2.0**shifts) * rest) ** 2).sum() / 12)
    # weights of 128 and more have coarser steps, so that a float32 holds what the integers stand for
    grain = 2.0 ** np.ceil(np.log2(np.maximum(np.abs(weight).max(axis=1, initial=0) / FINE_WEIGHT, 1)))
    steps = np.rint(noise / spread * 2.0**WEIGHT_EXPONENT / grain) * grain
    steps = np.clip(steps, grain, MAX_STEP // grain * grain).astype(np.int64)
    unit = (steps[:, None] << shifts[None, :]) * 2.0**-WEIGHT_EXPONENT
    symbols, error = _round_in_turn(weight[:, order], unit, factor / rest[None, :])
    back = np.argsort(order)
    whole = np.rint((bias + error[:, back] @ mean) * 2.0**BIAS_BITS).astype(np.int32)
    return QuantisedLinear(symbols[:, back], steps, shifts[back], whole)


def exact_mlp(
    hidden: tuple[np.ndarray, np.ndarray], output: tuple[np.ndarray, np.ndarray], *, leaky: bool
) -> QuantisedMlp | None:
    """A network whose weights are whole numbers of the format's units already, as those of a decoded scene: as it is.

    Args:
        hidden: Weight (hidden, in) and bias of the first layer.
        output: Weight (out, hidden) and bias of the second.
        leaky: Slope 0.01 below zero instead of 0.

    Returns:
        The integers that stand for exactly these numbers; None if there are none.
    """
    first, second = exact_linear(*hidden), exact_linear(*output)
    return None if first is None or second is None else QuantisedMlp(first, second, leaky)


def exact_linear(weight: np.ndarray, bias: np.ndarray) -> QuantisedLinear | None:
    """The layer of integers that stands for exactly these numbers; None if there is none.

    Steps are not unique: any that divide all weights give the same numbers.

    Args:
        weight: float (out, in).
        bias: float (out).
    """
    whole, base = weight * 2.0**WEIGHT_EXPONENT, bias * 2.0**BIAS_BITS
    if not (_whole(whole, 2.0**48) and _whole(base, float(MAX_SYMBOL))):
        return None
    units = whole.astype(np.int64)
    some, twos = units != 0, np.log2(np.maximum(units & -units, 1)).astype(np.int64)  # factors 2 of each weight
    found = []
    for rows_first in (True, False):
        shifts = np.zeros(units.shape[1], np.int64) if rows_first else _fewest(twos, some, axis=0)
        shifts = _fewest(twos - _fewest(twos - shifts, some, axis=1)[:, None], some, axis=0)
        steps = np.array([_divisor(int(step)) for step in np.gcd.reduce(units >> shifts, axis=1)], dtype=np.int64)
        found.append((units // (steps[:, None] << shifts), steps, shifts))
    symbols, steps, shifts = min(found, key=lambda parts: float(np.log2(1 + np.abs(parts[0])).sum()))
    if np.abs(symbols).max(initial=0) > MAX_SYMBOL:
        return None
    return QuantisedLinear(symbols.astype(np.int32), steps, shifts, base.astype(np.int32))


def _fewest(twos: np.ndarray, some: np.ndarray, axis: int) -> np.ndarray:
    """Factors 2 that all weights of a row or column have in common, those that are 0 apart."""
    least = np.where(some, twos, MAX_SHIFT).min(axis=axis, initial=MAX_SHIFT)
    return np.maximum(np.where(some.any(axis=axis), least, 0), 0)


def _whole(values: np.ndarray, most: float) -> bool:
    """Whether all are whole numbers and not too large."""
    return bool((np.abs(values) <= most).all() and (values == np.rint(values)).all())


def _divisor(number: int) -> int:
    """The largest divisor that a row's step can be."""
    if number <= MAX_STEP:
        return max(number, 1)
    smaller = np.arange(1, MAX_STEP + 1)
    return int(smaller[number % smaller == 0][-1])


def _explained(inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean of the inputs, an order (widest first) and the upper triangular R of their covariance in it."""
    mean = inputs.mean(axis=0)
    centred = inputs - mean
    covariance = centred.T @ centred / len(inputs)
    variance = np.diag(covariance)
    # an input that hardly varies must not get an endless step
    covariance = covariance + np.diag(RIDGE * variance + 1e-9 * variance.max() + 1e-18)
    order = np.argsort(-variance, kind="stable")
    reverse = np.linalg.cholesky(covariance[np.ix_(order[::-1], order[::-1])])
    return mean, order, reverse[::-1, ::-1]


def _round_in_turn(weight: np.ndarray, unit: np.ndarray, unit_factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rounds column by column, each after what the columns before it left over.

    Args:
        weight: float (out, in).
        unit: Steps, float (out, in).
        unit_factor: R with its columns divided by its diagonal, float (in, in).

    Returns:
        Symbols, int32 (out, in), and what they lack, float (out, in).
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
    """Rounds both layers of a network, sharing the tolerated noise between them.

    Args:
        hidden: Weight (hidden, in) and bias of the first layer.
        output: Weight (out, hidden) and bias of the second.
        inputs: Sample of inputs, float (n, in).
        tolerance: (out), tolerated standard deviation of the error of each output.
        leaky: Slope 0.01 below zero instead of 0.

    Returns:
        The network in integers.
    """
    pre = inputs @ hidden[0].T + hidden[1]
    active, post = (pre > 0).mean(axis=0), _activation(pre, leaky)
    sensitivity = np.sqrt(((output[0] / tolerance[:, None]) ** 2).mean(axis=0) * np.maximum(active, 1e-3))
    noise = 1.0 / np.maximum(sensitivity * np.sqrt(len(active)), 1e-6)
    first = quantise_linear(hidden[0], hidden[1], inputs, noise)
    weight, bias = (array.astype(np.float64) for array in first.dequantised())
    rounded = _activation(inputs @ weight.T + bias, leaky)
    second = quantise_linear(*_refitted(output, post, rounded), rounded, tolerance)
    return QuantisedMlp(first, second, leaky)


def _activation(pre: np.ndarray, leaky: bool) -> np.ndarray:
    return np.where(pre > 0, pre, 0.01 * pre if leaky else 0.0)


def _refitted(
    output: tuple[np.ndarray, np.ndarray], inputs: np.ndarray, rounded: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The second layer that makes of the rounded first one's outputs what it made of the exact ones: least squares."""
    weight, bias = output
    centred = rounded - rounded.mean(axis=0)
    lacking = (inputs - inputs.mean(axis=0) - centred) @ weight.T
    variance = (centred**2).sum(axis=0)
    gram = centred.T @ centred + np.diag(RIDGE * variance + 1e-9 * variance.max() + 1e-18)
    weight = weight + np.linalg.solve(gram, centred.T @ lacking).T
    return weight, bias + inputs.mean(axis=0) @ output[0].T - rounded.mean(axis=0) @ weight.T
