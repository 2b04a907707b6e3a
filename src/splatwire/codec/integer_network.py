"""Networks evaluated in integers: bit-identical on any machine, with any thread count and batch size."""

import functools
from dataclasses import dataclass

import numpy as np

from splatwire.codec.fixed_point import ACTIVATION_LIMIT, EXACT_LIMIT
from splatwire.errors import BitstreamError


@dataclass(frozen=True, eq=False)
class IntegerLinear:
    """An affine layer in integers.

    Attributes:
        weight: int64 (out, in), units of `2**-WEIGHT_EXPONENT`.
        bias: int64 (out), units of `2**-(ACTIVATION_BITS + WEIGHT_EXPONENT)`.
    """

    weight: np.ndarray
    bias: np.ndarray

    def __post_init__(self) -> None:
        largest = np.abs(self.weight).astype(np.float64).sum(axis=1) * ACTIVATION_LIMIT
        if self.weight.size and (largest + np.abs(self.bias).astype(np.float64)).max() >= EXACT_LIMIT / 2:
            raise BitstreamError("network weights are too large to be evaluated exactly")

    @functools.cached_property
    def matrix(self) -> np.ndarray:
        """The transposed weight as float64, ready for exact products."""
        return np.ascontiguousarray(self.weight.T.astype(np.float64))


@dataclass(frozen=True, eq=False)
class IntegerMlp:
    """Two integer layers with a (leaky) rectifier between them.

    Attributes:
        hidden: First layer.
        output: Second layer.
        leaky: Slope 0.01 below zero instead of 0.
    """

    hidden: IntegerLinear
    output: IntegerLinear
    leaky: bool

    def accumulate(self, inputs: np.ndarray, columns: slice) -> np.ndarray:
        """Adds up the first layer over some of its input columns.

        Args:
            inputs: Activations of these columns, (N, columns), whole numbers carried in float64.
            columns: Which columns of the layer they are.

        Returns:
            Partial sums (N, hidden), whole numbers in float64.
        """
        return inputs @ self.hidden.matrix[columns]

    def finish(self, sums: np.ndarray) -> np.ndarray:
        """Turns the first layer's complete sums (without bias) into outputs.

        Args:
            sums: (N, hidden) whole numbers in float64; overwritten.

        Returns:
            int32 (N, out), units of `2**-OUTPUT_BITS`, clipped to `OUTPUT_LIMIT` (1024 units).
        """
        from splatwire.codec import _network_kernels as kernels

        kernels.finish_hidden(sums, self.hidden.bias.astype(np.float64), self.leaky)
        products = sums @ self.output.matrix
        out = np.empty(products.shape, dtype=np.int32)
        kernels.finish_output(products, self.output.bias.astype(np.float64), out)
        return out

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Evaluates the network.

        Args:
            inputs: (N, in) whole numbers in float64, units of `2**-ACTIVATION_BITS`, within `ACTIVATION_LIMIT`.

        Returns:
            int32 (N, out), units of `2**-OUTPUT_BITS`.
        """
        return self.finish(self.accumulate(inputs, slice(None)))
