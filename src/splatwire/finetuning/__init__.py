"""Fine-tuning of explicit Gaussians on pictures, with simulated rounding and packet loss."""

from splatwire.finetuning.options import FineTuning as FineTuning
from splatwire.finetuning.pictures import Pictures as Pictures
from splatwire.finetuning.pictures import fitting_cameras as fitting_cameras
from splatwire.finetuning.pictures import own_pictures as own_pictures
from splatwire.finetuning.tune import Progress as Progress
from splatwire.finetuning.tune import fine_tune as fine_tune
