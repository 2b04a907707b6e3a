"""Finds and safely loads the files of an official HAC++ model folder."""

import io
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatwire.errors import MALFORMED, DatasetError
from splatwire.files.archive import open_archive
from splatwire.files.kinds import HACPP, MODEL_3DGS, file_kind, format_error, last_iteration, model_nearby
from splatwire.files.read_limited import read_json
from splatwire.files.tensors import MAX_TENSOR_FILE_BYTES, check_tensor_file
from splatwire.io.model_arguments import ARGUMENTS, read_arguments

_MAX_NUMBER_BYTES = 4096


def newest_iteration(model_dir: Path) -> Path:
    """Returns the `point_cloud/iteration_*` folder with the highest number.

    Raises:
        DatasetError: If `model_dir` has no such folder.
    """
    if not model_dir.is_dir():
        raise DatasetError(format_error(model_dir, "a model folder") + model_nearby(model_dir, HACPP))
    if file_kind(model_dir) is MODEL_3DGS:
        raise DatasetError(format_error(model_dir, "a model folder of HAC++ or Scaffold-GS"))
    folder = last_iteration(model_dir)
    if folder is None:
        hint = model_nearby(model_dir, HACPP)
        raise DatasetError(format_error(model_dir, "a model folder", "it has no point_cloud/iteration_* folder") + hint)
    return folder


def anchor_ply(iteration: Path) -> Path:
    """Returns the path of the PLY file, possibly compressed (`.ply.xz`), in the folder of an iteration.

    Raises:
        DatasetError: If neither file exists.
    """
    for name in ("point_cloud.ply", "point_cloud.ply.xz"):
        if (iteration / name).is_file():
            return iteration / name
    raise DatasetError(f"{iteration}: has neither point_cloud.ply nor point_cloud.ply.xz")


def load_torch_file(path: Path) -> Any:
    """Loads tensors written by `torch.save`, on the CPU. Nothing in the file is executed.

    Raises:
        DatasetError: If the file is absent, too large, or contains anything but plain tensors.
    """
    check_tensor_file(path, DatasetError)
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises exceptions of many types for a damaged file
        reason = str(error).strip().split("\n")[0][:200]
        raise DatasetError(f"{path}: not a readable file of plain tensors: {reason}") from error


def is_plain(value: Any) -> bool:
    """Returns True if a value from a checkpoint is a dense CPU tensor with finite values and a permitted size."""
    if not isinstance(value, Tensor) or value.layout != torch.strided or value.device.type != "cpu":
        return False
    if value.is_complex() or value.is_quantized or 4 * value.numel() > MAX_TENSOR_FILE_BYTES:
        return False
    return bool(torch.isfinite(value).all())


def load_bounds(model_dir: Path) -> tuple[Tensor, Tensor]:
    """Loads the lower and the upper corner of the hash grid's bounding box, float32 (3) each.

    Raises:
        DatasetError: If a file is missing or does not contain three finite numbers, or if the box is empty.
    """
    # HAC++ fixes the box in the middle of training, so it cannot be computed from the final anchors.
    corners = []
    for name in ("x_bound_min.pkl", "x_bound_max.pkl"):
        path = model_dir / "bitstreams" / name
        value = load_torch_file(path)
        if not is_plain(value) or value.numel() != 3:
            raise DatasetError(f"{path}: the bounds are not 3 finite numbers")
        corners.append(value.detach().reshape(3).float())
    if not bool((corners[0] < corners[1]).all()):
        raise DatasetError(f"{model_dir / 'bitstreams'}: x_bound_min is not below x_bound_max on every axis")
    return corners[0], corners[1]


def load_voxel_size(model_dir: Path) -> tuple[float, Path] | None:
    """Reads the voxel size from the files of a model folder.

    Returns:
        The voxel size in world units and the path of the file that contains it, or None if no file has one.

    Raises:
        DatasetError: If one of these files is damaged, or its value is negative or not finite.
    """
    # A `voxel_size` of 0 on HAC++'s command line means that HAC++ estimates the voxel size from the data.
    for name, read in (
        ("bitstreams/xyz_gpcc.npz", _voxel_size_of_npz),
        ("metrics.json", _voxel_size_of_json),
        (ARGUMENTS, _voxel_size_of_arguments),
    ):
        path = model_dir / name
        if not path.is_file():
            continue
        try:
            value = read(path)
        except (DatasetError, OSError, EOFError, *MALFORMED) as error:
            raise DatasetError(f"{path}: no voxel size can be read from it: {error}") from error
        if value is not None and value != 0:
            if not (math.isfinite(value) and value > 0):
                raise DatasetError(f"{path}: the voxel size is {value}")
            return value, path
    return None


def infer_voxel_size(positions: np.ndarray) -> float:
    """Estimates the voxel size from the smallest gap between coordinates.

    Args:
        positions: Positions of the anchors, float32 (N, 3).

    Returns:
        The estimate in world units. The caller must check that the positions are multiples of the estimate.

    Raises:
        DatasetError: If all coordinates are equal, so that there is no gap.
    """
    values = np.unique(positions.astype(np.float64))
    gaps = np.diff(values)
    gaps = gaps[gaps > 16 * np.spacing(np.float32(np.abs(values).max(initial=0)))]
    if not len(gaps):
        raise DatasetError("the voxel size is in no file, and the anchor positions do not tell it")
    size = float(gaps.min())
    order = np.argsort(np.abs(values))
    for share in (1e-3, 1e-2, 0.1, 1.0):  # from the origin outwards: the fit needs each index
        near = values[order[: max(2, int(len(values) * share))]]
        index = np.round(near / size)
        if (index != 0).any():
            size = float((index * near).sum() / (index * index).sum())
    short = float(f"{size:.6g}")
    return short if abs(short / size - 1) < 1e-7 else size


def _voxel_size_of_npz(path: Path) -> float | None:
    # np.load would allocate an array of any shape that the file claims
    with open_archive(path, DatasetError) as archive:
        if "voxel_size.npy" not in archive.sizes:
            raise ValueError("it has no 'voxel_size'")
        content = io.BytesIO(archive.read("voxel_size.npy", _MAX_NUMBER_BYTES))
    if np.lib.format.read_magic(content) != (1, 0):
        raise ValueError("'voxel_size' has an unknown numpy version")
    shape, _, dtype = np.lib.format.read_array_header_1_0(content)
    if shape not in ((), (1,)) or dtype.kind not in "fi":
        raise ValueError(f"'voxel_size' is {dtype} {shape}, not a single number")
    return float(np.frombuffer(content.read(dtype.itemsize), dtype=dtype)[0])


def _voxel_size_of_json(path: Path) -> float | None:
    content = read_json(path, DatasetError)
    value = content.get("voxel_size") if isinstance(content, dict) else None
    return float(value) if isinstance(value, (int, float)) else None


def _voxel_size_of_arguments(path: Path) -> float | None:
    match = re.search(r"voxel_size=([0-9.eE+-]+)", read_arguments(path))
    return float(match[1]) if match else None
