"""A run for losses ends as a finished scene that goes on for a while (`docs/training.md` has what that brings)."""

import torch

from splatwire.train.averaging import averaged
from splatwire.train.config import TrainConfig
from splatwire.train.state import TrainState, keep_anchors

MASK_LOGITS = (-8.0, 0.0)
"""Of offsets that do not exist and that do, in a finished scene."""


@torch.no_grad()
def settle(state: TrainState, config: TrainConfig) -> None:
    """Makes a state that of a finished scene, as `splatwire.train.finetune` does with one from a file.

    The mean of the last iterations takes the place of the parameters, what draws nothing is left out, and Adam forgets.

    Args:
        state: Changed in place.
        config: The recipe.
    """
    for name, mean in averaged(state).parameters.items():
        state.parameters[name].copy_(mean)
    mask = state.masks(config.mask_threshold)
    absent, present = MASK_LOGITS
    state.parameters["mask_logits"].copy_(torch.where(mask, present, absent))
    state.moments.clear()
    state.means.clear()
    if bool(mask.any()):
        keep_anchors(state, mask.any(dim=1))
