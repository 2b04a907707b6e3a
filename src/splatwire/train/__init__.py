"""The trainer: photos with poses in, a scene that the codec can send out.

A run is a recipe (`TrainConfig`, frozen), a state (`TrainState`, plain tensors) and a step (`TrainingStep`, which does
an iteration on the state); `train_scene` repeats the step and tells a listener what happens.
"""

from splatwire.train.checkpoint import load_checkpoint, save_checkpoint
from splatwire.train.config import TrainConfig
from splatwire.train.export import export_scene
from splatwire.train.presets import PRESETS, create_config
from splatwire.train.progress import Listener, Progress
from splatwire.train.quality import QualityReport
from splatwire.train.trainer import RunOptions, TrainResult, train_scene

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
