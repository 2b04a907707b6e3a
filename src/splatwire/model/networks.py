"""Small multi-layer perceptrons as frozen data: numpy arrays, or torch tensors while they are trained."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from splatwire.reprs import summary_repr


@dataclass(frozen=True, eq=False)
class Linear:
    """An affine layer `x @ weight.T + bias`.

    Attributes:
        weight: One row per output.
        bias: One value per output.
    """

    weight: Float[Any, "out in"]
    bias: Float[Any, "out"]

    __repr__ = summary_repr


@dataclass(frozen=True, eq=False)
class Mlp:
    """Two affine layers with a (leaky) rectifier between them, the only network shape in HAC++.

    Attributes:
        hidden: First layer.
        output: Second layer, no activation behind it.
        negative_slope: 0 for a plain rectifier, 0.01 in the channel context.
    """

    hidden: Linear
    output: Linear
    negative_slope: float = 0.0

    __repr__ = summary_repr

    def __call__(self, x: Float[Any, "N in"]) -> Float[Any, "N out"]:
        """Evaluates the network on a batch; `x` is of the library of the weights."""
        if not isinstance(x, np.ndarray):
            from torch.nn import functional  # the caller has loaded it

            h = functional.linear(x, self.hidden.weight, self.hidden.bias)
            h = functional.leaky_relu(h, self.negative_slope) if self.negative_slope else functional.relu(h)
            return functional.linear(h, self.output.weight, self.output.bias)
        h = x @ self.hidden.weight.T + self.hidden.bias
        h = np.maximum(h, 0) + self.negative_slope * np.minimum(h, 0) if self.negative_slope else np.maximum(h, 0)
        return h @ self.output.weight.T + self.output.bias

    @property
    def num_parameters(self) -> int:
        """Number of weights and biases."""
        return sum(math.prod(t.shape) for layer in (self.hidden, self.output) for t in (layer.weight, layer.bias))
