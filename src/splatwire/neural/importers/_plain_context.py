"""Constant context model, for scenes trained without one: it predicts the same distributions for every anchor."""

import torch
from torch import Tensor

from splatwire.neural.model.tensors import to_tensors
from splatwire.types import AnchorLayout, Anchors, HacppConfig, HacppContextModel, HashGrid, HashGridConfig, Linear, Mlp

GRID = HashGridConfig(1, (3,), (3,), 5, 5)
"""The smallest hash grid that the stream format allows; the predictions do not depend on its values."""
_STEPS_PER_SPREAD = 32
"""Number of quantisation steps per standard deviation of a channel; so fine that rounding hardly reduces quality."""
_MARGIN = 0.2
_MIN_SPREAD = 1e-6


def plain_context(anchors: Anchors, layout: AnchorLayout) -> tuple[HacppContextModel, HacppConfig]:
    """Builds a context model that predicts the same normal distribution of each attribute value for every anchor.

    The distributions have the mean and the standard deviation over all anchors.

    Args:
        anchors: The anchors.
        layout: Shapes of the anchors.
    """
    # With this model the scene can be encoded, with an independent Gaussian distribution per channel. The stream is
    # much larger than that of a scene trained with a context model.
    anchors = to_tensors(anchors)
    offsets = anchors.offsets.flatten(1)
    groups = [(t.mean(dim=0), t.std(dim=0, correction=0).clamp(min=_MIN_SPREAD))
              for t in (anchors.features, anchors.scalings, offsets)]  # fmt: skip
    (feature_mean, feature_spread), (scaling_mean, scaling_spread), (offset_mean, offset_spread) = groups
    steps = tuple(max(float(spread.mean()) / _STEPS_PER_SPREAD, _MIN_SPREAD) for _, spread in groups)
    config = HacppConfig(layout, GRID, (steps[0], steps[1], steps[2]))
    even = torch.zeros_like(feature_mean)
    prior = _constant(
        torch.cat([feature_mean, feature_spread, even, scaling_mean, scaling_spread, offset_mean, offset_spread,
                   torch.zeros(3)]),
        GRID.context_dim,
    )  # fmt: skip
    channel, before = [], 0
    for size in layout.feature_groups:
        part = slice(before, before + size)
        outputs = torch.cat([feature_mean[part], feature_spread[part], even[part]])
        channel.append(_constant(outputs, before + 3 * layout.feature_dim, 0.01))
        before += size
    depth = GRID.features_per_level
    low, high = anchors.positions.amin(dim=0), anchors.positions.amax(dim=0)
    room = _MARGIN * (high - low) + 0.5
    grid = HashGrid(
        torch.ones(sum(GRID.rows(3)), depth, dtype=torch.int8),
        torch.ones(3, sum(GRID.rows(2)), depth, dtype=torch.int8),
        low - room,
        high + room,
    )
    return HacppContextModel(grid, prior, tuple(channel)), config


def _constant(outputs: Tensor, num_inputs: int, negative_slope: float = 0.0) -> Mlp:
    """Builds a network with `num_inputs` inputs that returns the constants `outputs` for every input."""
    nothing = Linear(torch.zeros(1, num_inputs), torch.zeros(1))
    return Mlp(nothing, Linear(torch.zeros(len(outputs), 1), outputs.float()), negative_slope)
