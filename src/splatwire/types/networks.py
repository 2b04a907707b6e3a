"""Small multi-layer perceptrons as frozen data: numpy arrays, or torch tensors while they are trained."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.arguments import CheckedFields
from splatwire.reprs import summary_repr


@dataclass(frozen=True, eq=False)
class Linear(CheckedFields):
    """An affine layer `x @ weight.T + bias`.

    Attributes:
        weight: One row per output.
        bias: One value per output.
    """

    weight: Float[Any, "out in"]
    bias: Float[Any, "out"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Mlp(CheckedFields):
    """Two affine layers with a (leaky) ReLU in between, the only network architecture in HAC++.

    Attributes:
        hidden: First layer.
        output: Second layer, without an activation.
        negative_slope: Slope of the ReLU for negative inputs: 0 for a plain ReLU.
    """

    hidden: Linear
    output: Linear
    negative_slope: float = 0.0

    __repr__ = summary_repr

    def __call__(self, x: Float[np.ndarray, "N in"]) -> Float[np.ndarray, "N out"]:
        """Evaluates the network on a batch of numpy arrays."""
        h = x @ self.hidden.weight.T + self.hidden.bias
        h = np.maximum(h, 0) + self.negative_slope * np.minimum(h, 0) if self.negative_slope else np.maximum(h, 0)
        return h @ self.output.weight.T + self.output.bias

    @property
    def num_parameters(self) -> int:
        """Number of weights and biases."""
        return sum(math.prod(t.shape) for layer in (self.hidden, self.output) for t in (layer.weight, layer.bias))
