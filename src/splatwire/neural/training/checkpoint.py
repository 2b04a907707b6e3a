"""Checkpoints: the whole state of a training as one file of tensors (safetensors) with a JSON header.

On the same machine with the same number of threads, a resumed training gives bit for bit the result of an uninterrupted
training.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args, get_type_hints

import torch
from torch import Tensor

from splatwire.anchors.tensor_file import read_tensors, write_tensors
from splatwire.arguments import checked
from splatwire.errors import MALFORMED, BitstreamError, InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.initial import parameter_shapes
from splatwire.neural.training.state import GrowthStatistics, Moments, SizeController, TrainState
from splatwire.types.origin import NO_ORIGIN, check_origin

FORMAT = "splatwire-checkpoint"
VERSION = 5


@checked
def save_checkpoint(state: TrainState, config: TrainConfig, path: Path) -> None:
    """Writes the state and the configuration of a training to a checkpoint file, atomically.

    Args:
        state: State of the training.
        config: The configuration.
        path: Path of the file; its folder must exist.

    Raises:
        OSError: If the file cannot be written.
    """
    tensors = {
        "voxels": state.voxels,
        "bounds_min": state.bounds_min,
        "bounds_max": state.bounds_max,
        "generator": state.generator.get_state(),
        **{f"statistics.{name}": value for name, value in vars(state.statistics).items()},
        **{f"parameters.{name}": value for name, value in state.parameters.items()},
        **{f"first.{name}": moments.first for name, moments in state.moments.items()},
        **{f"second.{name}": moments.second for name, moments in state.moments.items()},
        **{f"mean.{name}": value for name, value in state.means.items()},
    }
    header = {
        "format": FORMAT,
        "version": VERSION,
        "iteration": state.iteration,
        "voxel_size": state.voxel_size.hex(),
        "camera_extent": state.camera_extent.hex(),
        "queue": state.queue,
        "origin": state.origin,
        "steering": _steering_to_list(state.steering),
        "steps": {name: moments.steps for name, moments in state.moments.items()},
        "means": sorted(state.means),
        "config": dataclasses.asdict(config),
    }
    write_tensors(tensors, header, path)


@checked
def load_checkpoint(path: Path) -> tuple[TrainState, TrainConfig]:
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


def read_moments(
    header: dict[str, Any], tensors: dict[str, Tensor], shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, Moments]:
    """Reads the state of the optimiser from the content of a checkpoint.

    Args:
        header: Header of the checkpoint.
        tensors: All tensors of the checkpoint, by name.
        shapes: Shape of each parameter, by name.

    Returns:
        Moments by name of the parameter.
    """
    moments = {}
    for name, steps in header["steps"].items():
        first, second = (checked_tensor(tensors, f"{part}.{name}", shapes[name]) for part in ("first", "second"))
        moments[name] = Moments(first, second, int(steps))
    return moments


def _state(header: dict[str, Any], tensors: dict[str, Tensor]) -> tuple[TrainState, TrainConfig]:
    config = config_from_json(header["config"])
    voxels = checked_tensor(tensors, "voxels", (tensors["voxels"].shape[0], 3), torch.int64)
    shapes = parameter_shapes(config, len(voxels))
    parameters = {name: checked_tensor(tensors, f"parameters.{name}", shape) for name, shape in shapes.items()}
    num_offsets = config.model.layout.num_offsets
    empty = GrowthStatistics.zeros(len(voxels), num_offsets, torch.device("cpu"))
    statistics = {
        name: checked_tensor(tensors, f"statistics.{name}", tuple(rows.shape)) for name, rows in vars(empty).items()
    }
    generator = torch.Generator()
    generator.set_state(tensors["generator"])
    state = TrainState(
        iteration=int(header["iteration"]),
        voxels=voxels,
        voxel_size=float.fromhex(header["voxel_size"]),
        parameters={name: value.requires_grad_() for name, value in parameters.items()},
        moments=read_moments(header, tensors, shapes),
        statistics=GrowthStatistics(**statistics),
        bounds_min=checked_tensor(tensors, "bounds_min", (3,)),
        bounds_max=checked_tensor(tensors, "bounds_max", (3,)),
        camera_extent=float.fromhex(header["camera_extent"]),
        generator=generator,
        queue=[int(view) for view in header["queue"]],
        origin=check_origin(header.get("origin", NO_ORIGIN)),  # earlier releases trained in world coordinates
        steering=_steering(header["steering"]),
        means={name: checked_tensor(tensors, f"mean.{name}", shapes[name]) for name in header["means"]},
    )
    return state, config


def _steering_to_list(steering: SizeController) -> list[float | None]:
    """Converts the state of the size controller (`SizeController`) to a list for a checkpoint.

    Returns:
        The fields `log_rate` and `log_error` of the state, followed by `ratio` unless it is None.
    """
    values = [steering.log_rate, steering.log_error]
    return values if steering.ratio is None else [*values, steering.ratio]


def _steering(value: list[float | None]) -> SizeController:
    log_rate, log_error, *rest = value
    (ratio,) = rest or [None]
    if log_rate is None or not all(part is None or math.isfinite(part) for part in value):
        raise ValueError("the steering of lambda is not finite")
    if ratio is not None and ratio <= 0:
        raise ValueError("the ratio of a stream's size to its estimate is not positive")
    return SizeController(*(None if part is None else float(part) for part in (log_rate, log_error, ratio)))  # type: ignore[arg-type]


def checked_tensor(
    tensors: dict[str, Tensor], name: str, shape: tuple[int, ...], dtype: torch.dtype = torch.float32
) -> Tensor:
    """Returns a tensor of a checkpoint, after checking its shape, its dtype, and that its values are finite.

    Raises:
        ValueError: If the shape or dtype of the tensor differs, or a value is not finite.
    """
    value = tensors[name]
    if tuple(value.shape) != shape or value.dtype != dtype:
        raise ValueError(f"'{name}' is {value.dtype} {tuple(value.shape)}, expected {dtype} {shape}")
    if dtype.is_floating_point and not bool(torch.isfinite(value).all()):
        raise ValueError(f"'{name}' is not finite")
    return value


def config_from_json(value: dict[str, Any]) -> TrainConfig:
    """Converts nested dictionaries to a training configuration; the inverse of `dataclasses.asdict`.

    Raises:
        InvalidValueError: If the dictionaries are not a valid configuration.
    """
    config: TrainConfig = record_from_json(TrainConfig, value)
    return config


def record_from_json(kind: Any, value: dict[str, Any]) -> Any:
    """Converts nested dictionaries to an instance of the dataclass `kind`; the inverse of `dataclasses.asdict`.

    Raises:
        InvalidValueError: If the dictionaries do not have the fields of the class.
    """
    try:
        return _record(kind, value)
    except MALFORMED as error:
        raise InvalidValueError(f"not the recipe of a training run: {error}") from error


def _record(kind: Any, value: dict[str, Any]) -> Any:
    """Converts a JSON object to an instance of the dataclass `kind`."""
    kinds = get_type_hints(kind)
    if set(value) != set(kinds):
        raise ValueError(f"{kind.__name__} has other fields than {', '.join(sorted(value))}")

    def field(name: str, item: Any) -> Any:
        records = [record for record in (kinds[name], *get_args(kinds[name])) if dataclasses.is_dataclass(record)]
        for record in records:  # of several types, choose the type with these fields
            if len(records) == 1 or set(item) == set(get_type_hints(record)):
                return _record(record, item)
        return tuple(item) if isinstance(item, list) else item

    return kind(**{name: field(name, item) for name, item in value.items()})
