"""Checkpoints: the whole state of a training as one file of tensors (safetensors) with a JSON header.

On the same machine with the same number of threads, a resumed training gives bit for bit the result of an uninterrupted
training.
"""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import torch
from torch import Tensor

from splatwire.anchors.tensor_file import read_tensors, write_tensors
from splatwire.arguments import checked
from splatwire.errors import MALFORMED, BitstreamError, DivergedError, InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training.config import STORED_NAME, TrainConfig
from splatwire.neural.training.initial import parameter_shapes
from splatwire.neural.training.state import GrowthStatistics, Moments, SizeController, TrainState
from splatwire.types.metadata import metadata_from_json, metadata_to_json
from splatwire.types.origin import NO_ORIGIN, check_origin

FORMAT = "splatwire-checkpoint"
VERSION = 5
_STORED_PARAMETERS = {"log_steps": "steps", "zero_points": "centres"}
"""Names in checkpoints of the parameters that have another name there."""
Value = TypeVar("Value")


@checked
def save_checkpoint(state: TrainState, config: TrainConfig, path: Path) -> None:
    """Writes the state and the configuration of a training to a checkpoint file, atomically.

    Args:
        state: State of the training.
        config: The configuration.
        path: Path of the file; its folder must exist.

    Raises:
        DivergedError: If a value is not finite, so that the checkpoint could not be loaded.
        OSError: If the file cannot be written.
    """
    steering = _controller_to_list(state.size_controller)
    tensors = {
        "voxels": state.voxels,
        "bounds_min": state.bounds_min,
        "bounds_max": state.bounds_max,
        "generator": state.generator.get_state(),
        **{f"statistics.{name}": value for name, value in vars(state.statistics).items()},
        **{f"parameters.{_stored(name)}": value for name, value in state.parameters.items()},
        **{f"first.{_stored(name)}": moments.first for name, moments in state.moments.items()},
        **{f"second.{_stored(name)}": moments.second for name, moments in state.moments.items()},
        **{f"mean.{_stored(name)}": value for name, value in state.parameter_means.items()},
    }
    header = {
        "format": FORMAT,
        "version": VERSION,
        "iteration": state.iteration,
        "voxel_size": state.voxel_size.hex(),
        "camera_extent": state.camera_extent.hex(),
        "queue": state.view_queue,
        "origin": state.origin,
        "photo_size": state.photo_size,
        "metadata": metadata_to_json(state.metadata),
        "steering": steering,
        "steps": {_stored(name): moments.steps for name, moments in state.moments.items()},
        "means": sorted(map(_stored, state.parameter_means)),
        "config": record_to_json(config),
    }
    numbers = torch.tensor([value for value in steering if value is not None])
    check_finite({**tensors, "steering": numbers}, state.iteration)
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


def read_photo_size(header: dict[str, Any]) -> tuple[int, int] | None:
    """Returns the size of the training photos in a checkpoint's header; None in checkpoints of earlier releases."""
    size = header.get("photo_size")
    if size is None:
        return None
    width, height = map(int, size)
    return width, height


def _state(header: dict[str, Any], tensors: dict[str, Tensor]) -> tuple[TrainState, TrainConfig]:
    config = config_from_json(header["config"])
    voxels = checked_tensor(tensors, "voxels", (tensors["voxels"].shape[0], 3), torch.int64)
    shapes = parameter_shapes(config, len(voxels))
    stored_shapes = {_stored(name): shape for name, shape in shapes.items()}
    parameters = {name: checked_tensor(tensors, f"parameters.{_stored(name)}", shape) for name, shape in shapes.items()}
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
        moments=_by_current_name(read_moments(header, tensors, stored_shapes)),
        statistics=GrowthStatistics(**statistics),
        bounds_min=checked_tensor(tensors, "bounds_min", (3,)),
        bounds_max=checked_tensor(tensors, "bounds_max", (3,)),
        camera_extent=float.fromhex(header["camera_extent"]),
        generator=generator,
        view_queue=[int(view) for view in header["queue"]],
        origin=check_origin(header.get("origin", NO_ORIGIN)),  # earlier releases trained in world coordinates
        photo_size=read_photo_size(header),
        metadata=metadata_from_json(header.get("metadata")),
        size_controller=_controller(header["steering"]),
        parameter_means=_by_current_name(
            {name: checked_tensor(tensors, f"mean.{name}", stored_shapes[name]) for name in header["means"]}
        ),
    )
    return state, config


def _stored(name: str) -> str:
    """Returns the name of a parameter in checkpoints."""
    return _STORED_PARAMETERS.get(name, name)


def _by_current_name(values: dict[str, Value]) -> dict[str, Value]:
    """Converts a mapping with the names in checkpoints as keys to one with the parameter names as keys."""
    current = {stored: name for name, stored in _STORED_PARAMETERS.items()}
    return {current.get(name, name): value for name, value in values.items()}


def _controller_to_list(controller: SizeController) -> list[float | None]:
    """Converts the state of the size controller (`SizeController`) to a list for a checkpoint.

    Returns:
        The fields `log_lambda_factor` and `log_error` of the state, followed by `ratio` unless it is None.
    """
    values = [controller.log_lambda_factor, controller.log_error]
    return values if controller.ratio is None else [*values, controller.ratio]


def _controller(value: list[float | None]) -> SizeController:
    log_lambda_factor, log_error, *rest = value
    (ratio,) = rest or [None]
    if log_lambda_factor is None or not all(part is None or math.isfinite(part) for part in value):
        raise ValueError("the steering of lambda is not finite")
    if ratio is not None and ratio <= 0:
        raise ValueError("the ratio of a stream's size to its estimate is not positive")
    return SizeController(
        float(log_lambda_factor),
        None if log_error is None else float(log_error),
        None if ratio is None else float(ratio),
    )


def check_finite(tensors: Mapping[str, Tensor], iteration: int) -> None:
    """Checks that all values of a training's state are finite.

    Args:
        tensors: Tensors of the state by name.
        iteration: The current iteration, for the message.

    Raises:
        DivergedError: If a value is not finite.
    """
    for name, value in tensors.items():
        if value.is_floating_point() and not bool(torch.isfinite(value).all()):
            raise DivergedError(iteration, f"'{name}' is not finite")


def checked_tensor(
    tensors: dict[str, Tensor], name: str, shape: tuple[int, ...], dtype: torch.dtype = torch.float32
) -> Tensor:
    """Returns a tensor of a checkpoint after checking that shape and dtype are correct and all values are finite.

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
    """Converts nested dictionaries to a training configuration; the inverse of `record_to_json`.

    Raises:
        InvalidValueError: If the dictionaries are not a valid configuration.
    """
    config: TrainConfig = record_from_json(TrainConfig, value)
    return config


def record_to_json(record: Any) -> dict[str, Any]:
    """Converts a configuration to nested dictionaries, as `dataclasses.asdict`, with the stored names of fields."""

    def converted(value: Any) -> Any:
        return record_to_json(value) if dataclasses.is_dataclass(value) else value

    return {stored: converted(getattr(record, name)) for stored, name in _field_names(type(record)).items()}


def record_from_json(kind: Any, value: dict[str, Any]) -> Any:
    """Converts nested dictionaries to an instance of the dataclass `kind`; the inverse of `record_to_json`.

    Raises:
        InvalidValueError: If the dictionaries do not have the fields of the class.
    """
    try:
        return _record(kind, value)
    except MALFORMED as error:
        raise InvalidValueError(f"not the recipe of a training run: {error}") from error


def _record(kind: Any, value: dict[str, Any]) -> Any:
    """Converts a JSON object to an instance of the dataclass `kind`."""
    kinds, names = get_type_hints(kind), _field_names(kind)
    if set(value) != set(names):
        raise ValueError(f"{kind.__name__} has other fields than {', '.join(sorted(value))}")

    def field(name: str, item: Any) -> Any:
        records = [record for record in (kinds[name], *get_args(kinds[name])) if dataclasses.is_dataclass(record)]
        for record in records:  # of several types, choose the type with these fields
            if len(records) == 1 or set(item) == set(_field_names(record)):
                return _record(record, item)
        return tuple(item) if isinstance(item, list) else item

    return kind(**{names[stored]: field(names[stored], item) for stored, item in value.items()})


def _field_names(kind: Any) -> dict[str, str]:
    """Returns the names of a dataclass's fields, by their names in checkpoints and JSON reports."""
    return {field.metadata.get(STORED_NAME, field.name): field.name for field in dataclasses.fields(kind)}
