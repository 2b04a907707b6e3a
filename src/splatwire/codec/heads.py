"""Networks as they are sent, fitted to their inputs; the rendering networks, which all schemas of anchors send."""

import numpy as np
import torch

from splatwire.codec.weights import QuantisedMlp, exact_mlp, quantise_mlp
from splatwire.model import GaussianHeads, Linear, Mlp
from splatwire.scene import Anchors

SAMPLE_SEED = 0
HEAD_TOLERANCE = 0.004
"""Tolerated noise of a rendering network's output before its activation: a quarter of an 8-bit colour step."""


def fit_heads(
    heads: GaussianHeads, sample: Anchors, tolerance: float = HEAD_TOLERANCE
) -> tuple[QuantisedMlp, QuantisedMlp, QuantisedMlp]:
    """Quantises the rendering networks.

    Args:
        heads: The networks.
        sample: Some of the anchors that they draw.
        tolerance: Tolerated standard deviation of the error of an output before its activation.
    """
    # Views are not known here: directions are taken from the sphere, distances from the extent of the anchors, half to
    # twice as far, so that neither is taken for something that features say.
    features, positions = sample.features, sample.positions
    generator = torch.Generator().manual_seed(SAMPLE_SEED)
    direction = torch.nn.functional.normalize(torch.randn(len(features), 3, generator=generator), dim=1)
    extent = (positions - positions.median(dim=0).values).norm(dim=1, keepdim=True)
    distance = extent * 2 ** (2 * torch.rand(len(features), 1, generator=generator) - 1)
    inputs = torch.cat([features, direction, distance], dim=1)
    opacity, covariance, color = (
        quantised(head, inputs, np.full(head.output.weight.shape[0], tolerance))
        for head in (heads.opacity, heads.covariance, heads.color)
    )
    return opacity, covariance, color


def network_of(mlp: QuantisedMlp) -> Mlp:
    """The network in floats: exactly the numbers that its integers stand for."""
    layers = [Linear(*(torch.from_numpy(a) for a in layer.dequantised())) for layer in (mlp.hidden, mlp.output)]
    return Mlp(layers[0], layers[1], 0.01 if mlp.leaky else 0.0)


def quantised(network: Mlp, inputs: torch.Tensor, tolerance: np.ndarray) -> QuantisedMlp:
    """Quantises a network for some inputs; one that was quantised before, as those of a decoded scene, stays as it is.

    Args:
        network: The network.
        inputs: Sample of its inputs, (n, in).
        tolerance: Tolerated standard deviation of the error of each output.
    """
    hidden, output = (
        (layer.weight.detach().double().numpy(), layer.bias.detach().double().numpy())
        for layer in (network.hidden, network.output)
    )
    leaky = network.negative_slope > 0
    found = exact_mlp(hidden, output, leaky=leaky)
    return found or quantise_mlp(hidden, output, inputs.double().numpy(), tolerance, leaky=leaky)
