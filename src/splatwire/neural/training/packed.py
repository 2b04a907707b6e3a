"""Packing of several small networks into one network, which a GPU evaluates faster.

The hidden layers are stacked, the output layers form a block-diagonal matrix.
"""

# A GPU spends more time on launching an operation than on a network of 32 hidden units.

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.nn.functional import linear

from splatwire.types import Mlp

Shape = tuple[int, int, int]
"""Numbers of inputs, hidden units and outputs of a network."""


@dataclass(frozen=True, eq=False)
class PackedNetworks:
    """Several two-layer networks combined into one network.

    Attributes:
        hidden_weight: Weights of all hidden layers.
        hidden_bias: Biases of all hidden layers.
        output_weight: Weights of all output layers.
        output_bias: Biases of all output layers.
    """

    hidden_weight: Float[Tensor, "H I"]
    hidden_bias: Float[Tensor, "H"]
    output_weight: Float[Tensor, "O H"]
    output_bias: Float[Tensor, "O"]

    def __call__(self, inputs: Float[Tensor, "M I"], negative_slope: float) -> Float[Tensor, "M O"]:
        """Evaluates all networks; a network with n inputs reads the first n columns."""
        hidden = linear(inputs, self.hidden_weight, self.hidden_bias)
        rectified = torch.nn.functional.leaky_relu(hidden, negative_slope)
        return linear(rectified, self.output_weight, self.output_bias)


def pack_networks(networks: Sequence[Mlp], order: tuple[int, ...]) -> PackedNetworks:
    """Combines several two-layer networks into one; differentiable in weights and biases.

    Args:
        networks: The networks, all with the same negative slope of their (leaky) ReLU.
        order: Order of the outputs: output i of the combined network is entry `order[i]` of the outputs of all
            networks, concatenated.
    """
    tensors = [
        tensor
        for mlp in networks
        for tensor in (mlp.hidden.weight, mlp.hidden.bias, mlp.output.weight, mlp.output.bias)
    ]
    shapes = tuple((mlp.hidden.weight.shape[1], *reversed(mlp.output.weight.shape)) for mlp in networks)
    source, copies, zero = _copy_indices(shapes, order, tensors[0].device)
    flat = _Packed.apply(source, copies, zero, *tensors)
    num_inputs = max(inputs for inputs, _, _ in shapes)
    num_hidden, num_outputs = sum(hidden for _, hidden, _ in shapes), len(order)
    sizes = [num_hidden * num_inputs, num_hidden, num_outputs * num_hidden, num_outputs]
    weight, bias, output_weight, output_bias = flat.split(sizes)
    return PackedNetworks(
        weight.view(num_hidden, num_inputs), bias, output_weight.view(num_outputs, num_hidden), output_bias
    )


@lru_cache(maxsize=16)
def _copy_indices(
    shapes: tuple[Shape, ...], order: tuple[int, ...], device: torch.device
) -> tuple[Int64[Tensor, "packed"], Int64[Tensor, "numbers"], Float[Tensor, "1"]]:
    """Returns the indices for copying weights from separate networks to one combined network and back.

    The combined network computes all separate networks at once. Its connections between parts of different networks
    have weight 0. The weights of the separate networks form one list, network after network, with a 0 at its end.

    Args:
        shapes: Numbers of inputs, hidden units and outputs of each separate network.
        order: Order of the outputs of the combined network, as for `pack_networks`.
        device: Device of the results.

    Returns:
        Three tensors:

        * For each weight of the combined network, its index in the list. For a connection between different networks,
          this is the index of the 0 at the end.
        * For each weight in the list except this 0, its index in the combined network.
        * The 0 itself.
    """
    numbers = sum(hidden * (inputs + 1 + outputs) + outputs for inputs, hidden, outputs in shapes)
    num_hidden, num_outputs = sum(shape[1] for shape in shapes), sum(shape[2] for shape in shapes)
    weight = torch.full((num_hidden, max(shape[0] for shape in shapes)), numbers)
    bias, output_weight = torch.empty(num_hidden, dtype=torch.int64), torch.full((num_outputs, num_hidden), numbers)
    output_bias = torch.empty(num_outputs, dtype=torch.int64)
    first, row, output = 0, 0, 0
    for inputs, hidden, outputs in shapes:
        ends = [0, hidden * inputs, hidden, outputs * hidden, outputs]
        for at, size in enumerate(ends):
            ends[at] = size + (ends[at - 1] if at else first)
        parts = [torch.arange(begin, end) for begin, end in pairwise(ends)]
        rows, outs = slice(row, row + hidden), slice(output, output + outputs)
        weight[rows, :inputs], bias[rows] = parts[0].view(hidden, inputs), parts[1]
        output_weight[outs, rows], output_bias[outs] = parts[2].view(outputs, hidden), parts[3]
        first, row, output = ends[-1], row + hidden, output + outputs
    chosen = torch.tensor(order)
    source = torch.cat([weight.flatten(), bias, output_weight[chosen].flatten(), output_bias[chosen]])
    copies = torch.empty(numbers + 1, dtype=torch.int64)
    copies[source] = torch.arange(len(source))
    return source.to(device), copies[:-1].to(device), torch.zeros(1, device=device)


class _Packed(torch.autograd.Function):
    """Autograd function that copies the weights of several networks into one combined tensor."""

    # Each weight is used once, so its gradient is copied back by index.

    @staticmethod
    def forward(ctx: Any, source: Tensor, copies: Tensor, zero: Tensor, *tensors: Tensor) -> Tensor:
        ctx.place, ctx.shapes = copies, [tensor.shape for tensor in tensors]
        return torch.cat([*(tensor.reshape(-1) for tensor in tensors), zero]).index_select(0, source)

    @staticmethod
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Any, ...]:
        parts = upstream[0].index_select(0, ctx.place).split([shape.numel() for shape in ctx.shapes])
        return None, None, None, *(part.view(shape) for part, shape in zip(parts, ctx.shapes, strict=True))
