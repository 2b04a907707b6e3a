"""Quantises the networks with which neural anchors are rendered."""

import numpy as np

from splatwire.codec.quantised_networks import quantise_network
from splatwire.codec.weights import QuantisedMlp
from splatwire.ops.arrays import lower_median
from splatwire.ops.twister import Twister
from splatwire.types import Anchors, GaussianHeads

SAMPLE_SEED = 0
DEFAULT_HEAD_TOLERANCE = 0.004
"""Tolerated error (standard deviation) of a rendering network's output before its activation. After the sigmoid of a
colour, the error is about a quarter of an 8-bit step or less.
"""


def quantise_heads(
    heads: GaussianHeads, sample: Anchors, tolerance: float = DEFAULT_HEAD_TOLERANCE
) -> tuple[QuantisedMlp, QuantisedMlp, QuantisedMlp]:
    """Quantises the rendering networks of a scene.

    Args:
        heads: The networks.
        sample: Sample of the scene's anchors.
        tolerance: Tolerated error of each output before its activation, as a standard deviation.
    """
    # Views are unknown: directions are sampled on the sphere, and distances from half to twice the distance from the
    # scene's centre. Both are independent of features, as real views are.
    features, positions = sample.features, sample.positions
    count, rng = len(features), Twister(SAMPLE_SEED)
    direction = rng.normal(3 * count).reshape(count, 3)
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
    from_middle = np.linalg.norm(positions - lower_median(positions), axis=1, keepdims=True)
    distance = from_middle * 2 ** (2 * rng.uniform(count)[:, None] - 1)
    inputs = np.concatenate([features, direction, distance], axis=1)
    opacity, covariance, color = (
        quantise_network(head, inputs, np.full(head.output.weight.shape[0], tolerance))
        for head in (heads.opacity, heads.covariance, heads.color)
    )
    return opacity, covariance, color
