"""Small multi-layer perceptrons as frozen data, evaluated by a pure function."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.reprs import summary_repr


@dataclass(frozen=True, eq=False)
class Linear:
    """An affine layer `x @ weight.T + bias`.

    Attributes:
        weight: One row per output.
        bias: One value per output.
    """

    weight: Float[Tensor, "out in"]
    bias: Float[Tensor, "out"]

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

    def __call__(self, x: Float[Tensor, "N in"]) -> Float[Tensor, "N out"]:
        """Evaluates the network on a batch."""
        h = torch.nn.functional.linear(x, self.hidden.weight, self.hidden.bias)
        h = torch.nn.functional.leaky_relu(h, self.negative_slope) if self.negative_slope else torch.relu(h)
        return torch.nn.functional.linear(h, self.output.weight, self.output.bias)

    @property
    def num_parameters(self) -> int:
        """Number of weights and biases."""
        return sum(t.numel() for layer in (self.hidden, self.output) for t in (layer.weight, layer.bias))
