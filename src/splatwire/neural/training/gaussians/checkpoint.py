"""Checkpoints of a training of explicit Gaussians: the whole state as one file of tensors with a JSON header."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatwire.anchors.tensor_file import read_tensors, write_tensors
from splatwire.arguments import checked
from splatwire.errors import MALFORMED, BitstreamError
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.checkpoint import (
    check_finite,
    checked_tensor,
    read_moments,
    read_photo_size,
    record_from_json,
    record_to_json,
)
from splatwire.neural.training.gaussians.config import GaussianConfig
from splatwire.neural.training.gaussians.state import GaussianState, parameter_shapes
from splatwire.types.origin import NO_ORIGIN, check_origin

FORMAT = "splatwire-gaussian-checkpoint"
VERSION = 1


@checked
def save_gaussian_checkpoint(state: GaussianState, config: GaussianConfig, path: Path) -> None:
    """Writes the state and the configuration of a training to a checkpoint file, atomically.

    Args:
        state: State of the training.
        config: The configuration.
        path: Path of the file; its folder must exist.

    Raises:
        DivergedError: If a value is not finite, so that the checkpoint could not be loaded.
        OSError: If the file cannot be written.
    """
    tensors = {
        "generator": state.generator.get_state(),
        **{f"parameters.{name}": value for name, value in state.parameters.items()},
        **{f"first.{name}": moments.first for name, moments in state.moments.items()},
        **{f"second.{name}": moments.second for name, moments in state.moments.items()},
    }
    header = {
        "format": FORMAT,
        "version": VERSION,
        "iteration": state.iteration,
        "camera_extent": state.camera_extent.hex(),
        "queue": state.view_queue,
        "origin": state.origin,
        "photo_size": state.photo_size,
        "steps": {name: moments.steps for name, moments in state.moments.items()},
        "config": record_to_json(config),
    }
    check_finite(tensors, state.iteration)
    write_tensors(tensors, header, path)


@checked
def load_gaussian_checkpoint(path: Path) -> tuple[GaussianState, GaussianConfig]:
    """Reads the state and the configuration of a training from a checkpoint file; tensors are on the CPU.

    Raises:
        UnsupportedVersionError: If this release does not support the file's version.
        BitstreamError: If the file is absent or not a checkpoint, or an entry is missing or does not fit.
    """
    arrays, header = read_tensors(path, FORMAT, VERSION)
    try:
        return _state(header, to_tensors(arrays))
    except MALFORMED as error:
        raise BitstreamError(f"{path}: the checkpoint is damaged: {error}") from error


def _state(header: dict[str, Any], tensors: dict[str, Tensor]) -> tuple[GaussianState, GaussianConfig]:
    config: GaussianConfig = record_from_json(GaussianConfig, header["config"])
    shapes = parameter_shapes(tensors["parameters.means"].shape[0], config.degree)
    parameters = {name: checked_tensor(tensors, f"parameters.{name}", shape) for name, shape in shapes.items()}
    generator = torch.Generator()
    generator.set_state(tensors["generator"])
    state = GaussianState(
        int(header["iteration"]),
        {name: value.requires_grad_() for name, value in parameters.items()},
        read_moments(header, tensors, shapes),
        float.fromhex(header["camera_extent"]),
        generator,
        [int(view) for view in header["queue"]],
        check_origin(header.get("origin", NO_ORIGIN)),  # earlier releases trained in world coordinates
        read_photo_size(header),
    )
    return state, config
