"""Importance of anchors for the training views, and sorting of a training state by importance."""

import numpy as np
import torch

from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.state import TrainState, keep_anchors
from splatwire.render.importance import footprint_importance
from splatwire.types import Cameras
from splatwire.types.importance import Importance


@torch.no_grad()
def importance_of(state: TrainState, config: TrainConfig, cameras: Cameras) -> Importance:
    """Returns the importance of each anchor: opacity times projected area, summed over its Gaussians and all views.

    Args:
        state: State of the training; every anchor must have at least one offset.
        config: The configuration.
        cameras: The training cameras.
    """
    return footprint_importance(export_scene(state, config, state.device), cameras)


def sort_by_importance(state: TrainState, importance: Importance) -> None:
    """Sorts the anchors of a training state by importance, most important first, in place."""
    keep_anchors(state, torch.from_numpy(np.argsort(-importance.share, kind="stable")).to(state.device))
