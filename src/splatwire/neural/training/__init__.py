"""Training of neural anchors: from photos with camera poses to a scene that the codec can encode."""

from splatwire.neural.training.checkpoint import load_checkpoint, save_checkpoint
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.loop import RunOptions
from splatwire.neural.training.presets import PRESETS, create_config
from splatwire.neural.training.progress import Listener, Progress
from splatwire.neural.training.quality import QualityReport
from splatwire.neural.training.trainer import TrainResult, train_scene

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
