"""Integer evaluation of networks: bit-identical on any machine, for any number of threads and any batch size."""

import functools
from dataclasses import dataclass

import numpy as np

from splatwire.codec import _network_kernels as kernels
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
        """Transposed weights as float64, which represents all products exactly."""
        return np.ascontiguousarray(self.weight.T.astype(np.float64))


@dataclass(frozen=True, eq=False)
class IntegerMlp:
    """A network of two layers with a (leaky) ReLU in between, evaluated in integers.

    Attributes:
        hidden: First layer.
        output: Second layer.
        leaky: True for a leaky ReLU with slope 0.01.
    """

    hidden: IntegerLinear
    output: IntegerLinear
    leaky: bool

    def accumulate(self, inputs: np.ndarray, columns: slice) -> np.ndarray:
        """Computes the contribution of a part of the inputs to the first layer of the network.

        Args:
            inputs: Values of n inputs of the network, (N, n), whole numbers in float64.
            columns: Range of these n inputs among all inputs of the network.

        Returns:
            Partial sums (N, hidden), whole numbers in float64.
        """
        return inputs @ self.hidden.matrix[columns]

    def finish(self, sums: np.ndarray) -> np.ndarray:
        """Computes the outputs of the network from the sums of the first layer over all inputs.

        Args:
            sums: Sums of the first layer without its bias, (N, hidden), whole numbers in float64; overwritten.

        Returns:
            Outputs of the network, int32 (N, out), units of `2**-OUTPUT_BITS`.
        """
        kernels.finish_hidden(sums, self.hidden.bias.astype(np.float64), self.leaky)
        products = sums @ self.output.matrix
        out = np.empty(products.shape, dtype=np.int32)
        kernels.finish_output(products, self.output.bias.astype(np.float64), out)
        return out

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Evaluates the network for a batch of inputs, in integers.

        Args:
            inputs: Inputs of the network, (N, in), whole numbers in float64, units of `2**-ACTIVATION_BITS`, within
                `ACTIVATION_LIMIT`.

        Returns:
            Outputs of the network, int32 (N, out), units of `2**-OUTPUT_BITS`.
        """
        return self.finish(self.accumulate(inputs, slice(None)))
