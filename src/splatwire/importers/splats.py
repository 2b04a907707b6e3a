"""Reads explicit Gaussians: PLY files of 3DGS and `.splat` files."""

import struct
from pathlib import Path

import numpy as np
import torch

from splatwire.data import SparsePoints
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.importers._ply import MAX_VERTICES, read_ply
from splatwire.ops.spherical_harmonics import DC, degree_of
from splatwire.scene.splats import Splats

_MAX_LOG_SCALE = 60.0
_RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("rotation", "u1", 4)])
_PLY_MAGIC = b"ply"
_SAFETENSORS_BRACE = 8


def splats_kind(path: Path) -> str | None:
    """Tells by its bytes whether a file holds explicit Gaussians.

    A `.splat` file has no mark of its own: it is one when its name says so, its size is a multiple of 32 and it is not
    a scene file of ours.

    Returns:
        `ply`, `splat`, or None for anything else, also for what is not a file.
    """
    if not path.is_file():
        return None
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(16)
    if head.startswith(_PLY_MAGIC):
        return "ply"
    if path.suffix != ".splat" or size % _RECORD.itemsize or not size:
        return None
    header_bytes = struct.unpack_from("<Q", head)[0]
    is_scene = head[_SAFETENSORS_BRACE : _SAFETENSORS_BRACE + 1] == b"{" and header_bytes < size
    return None if is_scene else "splat"


def import_splats(path: Path) -> Splats:
    """Reads a PLY of 3DGS or a `.splat` file, whichever it is.

    Raises:
        DatasetError: If it is neither, or damaged.
    """
    kind = splats_kind(path)
    if kind is None:
        what = "neither a PLY nor a .splat file" if path.is_file() else "no such file"
        raise DatasetError(f"{path}: {what}")
    return import_ply(path) if kind == "ply" else import_splat(path)


def import_points(path: Path) -> SparsePoints:
    """Reads explicit Gaussians as points to start a training from: centres, and colours without view dependence.

    Gaussians under an opacity of 1/255 are left out: they show nothing.

    Raises:
        DatasetError: If the file is damaged, or shows nothing.
    """
    splats = import_splats(path)
    splats = splats.select(splats.opacities > 1 / 255)
    if not splats.num_gaussians:
        raise DatasetError(f"{path}: all of its Gaussians are transparent")
    return SparsePoints(splats.means, (0.5 + DC * splats.sh[:, 0]).clamp(0, 1))


def import_ply(path: Path) -> Splats:
    """Reads the Gaussians of a 3DGS PLY file (see `splatwire.exporters.ply` for the properties).

    Normals and properties of other names are ignored; quaternions are normalised.

    Raises:
        DatasetError: If the file is damaged, lacks a property, or holds numbers that are no Gaussian.
    """
    vertices = read_ply(path)
    if not len(vertices.values):
        raise DatasetError(f"{path}: has no Gaussians")
    if "scale_2" not in vertices.names or "scale_3" in vertices.names:
        count = sum(name.startswith("scale_") for name in vertices.names)
        hint = "; a PLY of anchors is read by `splatwire import scaffold` or `hacpp`" if count == 6 else ""
        raise DatasetError(f"{path}: has {count} properties scale_*, explicit Gaussians have 3{hint}")
    num_rest = sum(name.startswith("f_rest_") for name in vertices.names)
    try:
        degree_of(num_rest // 3 + 1 if num_rest % 3 == 0 else -1)
    except InvalidValueError as error:
        raise DatasetError(f"{path}: {num_rest} properties f_rest_* are not those of a degree from 0 to 3") from error
    constant = vertices.columns("f_dc_", 3)[:, None]
    rest = vertices.columns("f_rest_", num_rest).reshape(len(constant), 3, -1).transpose(0, 2, 1) if num_rest else None
    logs = vertices.columns("scale_", 3)
    if np.abs(logs).max() > _MAX_LOG_SCALE:
        raise DatasetError(f"{path}: the logarithm of a scale is {logs.flat[np.abs(logs).argmax()]:g}")
    return Splats(
        means=torch.from_numpy(vertices.select(["x", "y", "z"])),
        quats=_unit(path, vertices.columns("rot_", 4)),
        scales=torch.from_numpy(logs).exp(),
        opacities=torch.from_numpy(vertices.select(["opacity"])[:, 0]).sigmoid(),
        sh=torch.from_numpy(constant if rest is None else np.concatenate([constant, rest], axis=1)),
    )


def import_splat(path: Path) -> Splats:
    """Reads a `.splat` file: records of 32 bytes, spherical harmonics of degree 0 (see `splatwire.exporters.splat`).

    Raises:
        DatasetError: If the file is absent, of a size that is not a multiple of 32, or holds numbers that are no
            Gaussian.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not data or len(data) % _RECORD.itemsize or len(data) // _RECORD.itemsize > MAX_VERTICES:
        raise DatasetError(f"{path}: {len(data)} bytes are not records of {_RECORD.itemsize} bytes")
    records = np.frombuffer(data, dtype=_RECORD)
    for name in ("position", "scale"):
        bad = ~np.isfinite(records[name]).all(axis=1)
        if name == "scale":
            bad |= (records[name] < 0).any(axis=1)
        if bad.any():
            row = int(bad.argmax())
            raise DatasetError(f"{path}: Gaussian {row} has {records[name][row].tolist()} as {name}")
    color = records["color"].astype(np.float32) / 255
    return Splats(
        means=torch.from_numpy(records["position"].copy()),
        quats=_unit(path, records["rotation"].astype(np.float32) / 128 - 1),
        scales=torch.from_numpy(records["scale"].copy()),
        opacities=torch.from_numpy(color[:, 3].copy()),
        sh=torch.from_numpy((color[:, None, :3] - 0.5) / np.float32(DC)),
    )


def _unit(path: Path, quats: np.ndarray) -> torch.Tensor:
    lengths = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    if not (lengths > 1e-6).all():
        raise DatasetError(f"{path}: Gaussian {int((lengths[:, 0] <= 1e-6).argmax())} has a rotation of length 0")
    return torch.from_numpy((quats / lengths).astype(np.float32))
