"""Converts networks between floats and their quantised form."""

from typing import Any

import numpy as np

from splatwire.codec.weights import QuantisedMlp, exact_mlp, quantise_mlp
from splatwire.ops.arrays import to_numpy
from splatwire.types import Linear, Mlp


def network_of(mlp: QuantisedMlp) -> Mlp:
    """Converts a quantised network to floats, exactly."""
    hidden, output = (Linear(*layer.dequantised()) for layer in (mlp.hidden, mlp.output))
    return Mlp(hidden, output, 0.01 if mlp.leaky else 0.0)


def quantise_network(network: Mlp, inputs: Any, tolerance: np.ndarray) -> QuantisedMlp:
    """Quantises a network as coarsely as the tolerated errors of its outputs allow.

    Args:
        network: The network.
        inputs: Sample of its inputs for measuring the errors, (n, in), a numpy array or a torch tensor.
        tolerance: Tolerated error of each output, as a standard deviation.
    """
    # A network of a decoded scene is already quantised and stays unchanged.
    hidden, output = (
        (to_numpy(layer.weight).astype(np.float64), to_numpy(layer.bias).astype(np.float64))
        for layer in (network.hidden, network.output)
    )
    leaky = network.negative_slope > 0
    exact = exact_mlp(hidden, output, leaky=leaky)
    return exact or quantise_mlp(hidden, output, to_numpy(inputs).astype(np.float64), tolerance, leaky=leaky)
