"""Rarely used parts of `splatwire encode`: cameras, pruning, target sizes, sketch, refitting."""

# Imported on demand, because the libraries take a second to load.

from collections.abc import Callable
from functools import partial

from splatwire.anchors.appearance import origin_of
from splatwire.channel import parse_loss
from splatwire.cli._calibration import with_quick_sketch
from splatwire.cli._encoded_updates import encode_update_of
from splatwire.cli.encode import Encode
from splatwire.data import load_cameras, open_dataset
from splatwire.rate_control import Tuning, encode_controlled
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.render.pruning import prune
from splatwire.types import Cameras
from splatwire.types.scene import Scene

__all__ = [
    "Tuning",
    "cameras_of",
    "encode_controlled",
    "encode_update_of",
    "parse_loss",
    "prune",
    "refiner",
    "with_quick_sketch",
]


def cameras_of(command: Encode, scene: Scene) -> Cameras:
    """Returns the cameras of the camera file or dataset in the options, relative to the scene's origin."""
    if command.cameras is not None:
        cameras = load_cameras(command.cameras)
    else:
        assert command.data is not None
        cameras = open_dataset(command.data, split="train").cameras
    warn_of_near_plane(scene, cameras)
    return cameras.relative_to(origin_of(scene))


def refiner(steps: int) -> Callable[..., Scene]:
    """Returns a function that trains the context model of a scene further, so that the stream becomes smaller.

    The context model predicts the probabilities with which attributes are entropy-coded.

    Args:
        steps: Number of training steps.

    Raises:
        InvalidValueError: If the number of steps is negative.
    """
    from splatwire.neural.training import refine  # imports torch

    return partial(refine.refine_context, config=refine.RefineConfig(steps=steps))
