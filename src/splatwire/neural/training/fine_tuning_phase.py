"""Start of the fine-tuning at the end of a training, which adapts the finished scene's anchors to lost packets."""

import torch

from splatwire.neural.training.averaging import with_averaged_parameters
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.state import TrainState, keep_anchors

MASK_LOGITS = (-8.0, 0.0)
"""Mask logits of a finished scene: for offsets that do not exist, and for offsets that exist."""


@torch.no_grad()
def start_fine_tuning(state: TrainState, config: TrainConfig) -> None:
    """Converts the state of a training to the initial state of its fine-tuning.

    Args:
        state: Changed in place.
        config: The configuration.
    """
    # Replaces the parameters by their running means, removes anchors without offsets, and resets Adam's moments.
    for name, mean in with_averaged_parameters(state).parameters.items():
        state.parameters[name].copy_(mean)
    mask = state.masks(config.mask_threshold)
    absent, present = MASK_LOGITS
    state.parameters["mask_logits"].copy_(torch.where(mask, present, absent))
    state.moments.clear()
    state.parameter_means.clear()
    if bool(mask.any()):
        keep_anchors(state, mask.any(dim=1))
