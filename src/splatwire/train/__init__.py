"""The trainer: photos with poses in, a scene that the codec can send out.

A run is a recipe (`TrainConfig`, frozen), a state (`TrainState`, plain tensors) and a step (`train_step`, a function);
`train_scene` repeats the step and tells a listener what happens.
"""

from splatwire.train.checkpoint import load_checkpoint, save_checkpoint
from splatwire.train.config import PRESETS, TrainConfig, create_config
from splatwire.train.export import export_scene
from splatwire.train.trainer import Listener, Progress, QualityReport, RunOptions, TrainResult, train_scene

__all__ = [
    "PRESETS",
    "Listener",
    "Progress",
    "QualityReport",
    "RunOptions",
    "TrainConfig",
    "TrainResult",
    "create_config",
    "export_scene",
    "load_checkpoint",
    "save_checkpoint",
    "train_scene",
]
