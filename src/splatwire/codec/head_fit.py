"""Quantisation of the rendering networks, which all schemas of anchors send; needs torch."""

import numpy as np
import torch

from splatwire.codec.heads import quantised
from splatwire.codec.weights import QuantisedMlp
from splatwire.model import GaussianHeads
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
