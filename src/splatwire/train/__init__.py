"""The trainer: photos with poses in, a scene that the codec can send out.

A run is a recipe (`TrainConfig`, frozen), a state (`TrainState`, plain tensors) and a step (`train_step`, a function);
`train_scene` repeats the step and tells a listener what happens.
"""

from splatwire.train.checkpoint import load_checkpoint as load_checkpoint
from splatwire.train.checkpoint import save_checkpoint as save_checkpoint
from splatwire.train.config import PRESETS as PRESETS
from splatwire.train.config import TrainConfig as TrainConfig
from splatwire.train.config import create_config as create_config
from splatwire.train.export import export_scene as export_scene
from splatwire.train.trainer import Listener as Listener
from splatwire.train.trainer import Progress as Progress
from splatwire.train.trainer import QualityReport as QualityReport
from splatwire.train.trainer import RunOptions as RunOptions
from splatwire.train.trainer import TrainResult as TrainResult
from splatwire.train.trainer import train_scene as train_scene
