"""Network weights as integers: how coarse each may be, and the dyadic numbers that both ends compute with.

A weight is `q * step`, where the step of row i and column j is `row_steps[i] << column_shifts[j]` units of 2**-16: rows
whose output tolerates more noise, and columns whose input is small, take fewer bits (reverse water-filling).
"""

from dataclasses import dataclass

import numpy as np

from splatwire.codec.fixed_point import ACTIVATION_BITS, WEIGHT_EXPONENT
from splatwire.codec.integer_network import IntegerLinear, IntegerMlp

BIAS_BITS = 12
"""Fractional bits of a bias."""

MAX_SHIFT = 12
MAX_STEP = 65535


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


def quantise_linear(weight: np.ndarray, bias: np.ndarray, input_rms: np.ndarray, noise: np.ndarray) -> QuantisedLinear:
    """Rounds a layer so that each output's rounding noise stays near a given level.

    Args:
        weight: float (out, in).
        bias: float (out).
        input_rms: (in), root mean square of each input.
        noise: (out), tolerated standard deviation of the error of each output.

    Returns:
        The layer in integers.
    """
    rms = np.maximum(input_rms, 1e-9)
    shifts = np.clip(np.floor(np.log2(rms.max() / rms)), 0, MAX_SHIFT).astype(np.int64)
    # rounding errors are uniform: each contributes (step * rms)**2 / 12
    spread = np.sqrt((((2.0**shifts) * rms) ** 2).sum() / 12)
    steps = np.clip(np.rint(noise / spread * 2.0**WEIGHT_EXPONENT), 1, MAX_STEP).astype(np.int64)
    unit = (steps[:, None] << shifts[None, :]) * 2.0**-WEIGHT_EXPONENT
    symbols = np.rint(weight / unit).astype(np.int32)
    return QuantisedLinear(symbols, steps, shifts, np.rint(bias * 2.0**BIAS_BITS).astype(np.int32))


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
    active = (pre > 0).mean(axis=0)
    post = np.where(pre > 0, pre, 0.01 * pre if leaky else 0.0)
    sensitivity = np.sqrt(((output[0] / tolerance[:, None]) ** 2).mean(axis=0) * np.maximum(active, 1e-3))
    noise = 1.0 / np.maximum(sensitivity * np.sqrt(len(active)), 1e-6)
    first = quantise_linear(hidden[0], hidden[1], np.sqrt((inputs**2).mean(axis=0)), noise)
    second = quantise_linear(output[0], output[1], np.sqrt((post**2).mean(axis=0)), tolerance)
    return QuantisedMlp(first, second, leaky)
