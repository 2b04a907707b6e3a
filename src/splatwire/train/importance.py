"""Which anchors of a run matter most, and those first."""

import numpy as np
import torch

from splatwire.render.importance import footprint_importance
from splatwire.scene import Cameras
from splatwire.scene.importance import Importance
from splatwire.train.config import TrainConfig
from splatwire.train.export import export_scene
from splatwire.train.state import TrainState, keep_anchors


@torch.no_grad()
def importance_of(state: TrainState, config: TrainConfig, cameras: Cameras) -> Importance:
    """Returns each anchor's share of the training views; every anchor of the state must draw something."""
    return footprint_importance(export_scene(state, config, state.device), cameras)


def order_anchors(state: TrainState, importance: Importance) -> None:
    """Sorts the rows of a state, most important first."""
    keep_anchors(state, torch.from_numpy(np.argsort(-importance.share, kind="stable")).to(state.device))
