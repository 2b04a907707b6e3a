"""Strict reader of the tensors and the header of a scene file; validates every shape, type and value."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.anchors.safetensors_file import TensorFile, open_tensor_file
from splatwire.anchors.tensor_file import parse_header
from splatwire.anchors.voxels import check_voxel_size, voxel_indices
from splatwire.errors import BitstreamError, InvalidValueError, UnsupportedVersionError
from splatwire.files.kinds import PARTIAL, SCENE, TENSORS, file_kind, format_error
from splatwire.types.background import BLACK, Background, check_background
from splatwire.types.networks import Linear, Mlp
from splatwire.types.origin import NO_ORIGIN, Origin, check_origin

_TYPES = {np.float32: "F32", np.bool_: "BOOL", np.uint8: "U8"}
MAX_WIDTH = 4096


class SceneReader:
    """An open scene file, from which tensors are read with strict checks.

    Args:
        path: Path of the file, for messages.
        file: The open safetensors file.
        header: JSON header of the file.
    """

    def __init__(self, path: Path, file: TensorFile, header: dict[str, Any]) -> None:
        self.path = path
        self.header = header
        self._file = file
        self._left = set(file.names)

    def error(self, reason: str) -> BitstreamError:
        """Returns an error for a damaged scene file, with file name and reason in the message."""
        return BitstreamError(f"{self.path}: {reason}")

    def shape(self, name: str) -> tuple[int, ...]:
        """Returns the shape of a tensor without reading it.

        Raises:
            BitstreamError: If the tensor is missing.
        """
        if name not in self._left:
            raise self.error(f"tensor '{name}' is missing")
        return self._file.shape(name)

    def has(self, name: str) -> bool:
        """True if the scene file has an unread tensor of the given name."""
        return name in self._left

    def length(self, name: str) -> int:
        """Returns the first dimension of a tensor.

        Raises:
            BitstreamError: If the tensor is missing or has no dimension.
        """
        shape = self.shape(name)
        if not shape:
            raise self.error(f"tensor '{name}' is a single number")
        return shape[0]

    def tensor(self, name: str, shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
        """Reads a tensor of the scene file after checking shape and dtype.

        Raises:
            BitstreamError: If the tensor is missing, has another shape or type, or contains values that are not finite.
        """
        actual_shape, kind = self.shape(name), self._file.type_name(name)
        if actual_shape != shape or kind != _TYPES[dtype]:
            raise self.error(f"tensor '{name}' is {kind} {actual_shape}, expected {_TYPES[dtype]} {shape}")
        value = self._file.tensor(name)
        if dtype is np.float32 and not bool(np.isfinite(value).all()):
            raise self.error(f"tensor '{name}' is not finite everywhere")
        if dtype is np.bool_ and bool((value.view(np.uint8) > 1).any()):
            raise self.error(f"tensor '{name}' holds a truth value that is neither 0 nor 1")
        self._left.discard(name)
        return value

    def network(self, name: str, num_inputs: int, num_outputs: int) -> Mlp:
        """Reads a network of two affine layers.

        Raises:
            BitstreamError: If a tensor has a wrong shape, or the header lacks the slope of the leaky ReLU.
        """
        slope = self.header["negative_slopes"].get(name) if isinstance(self.header["negative_slopes"], dict) else None
        if not isinstance(slope, (int, float)) or isinstance(slope, bool) or not 0 <= slope < 1:
            raise self.error(f"the header has no rectifier slope in [0, 1) for '{name}'")
        hidden = self.length(f"{name}.hidden.bias")
        if hidden > MAX_WIDTH:
            raise self.error(f"'{name}' has {hidden} hidden units, the limit is {MAX_WIDTH}")
        return Mlp(
            Linear(
                self.tensor(f"{name}.hidden.weight", (hidden, num_inputs)),
                self.tensor(f"{name}.hidden.bias", (hidden,)),
            ),
            Linear(
                self.tensor(f"{name}.output.weight", (num_outputs, hidden)),
                self.tensor(f"{name}.output.bias", (num_outputs,)),
            ),
            float(slope),
        )

    def voxel_size(self, positions: np.ndarray) -> float:
        """Reads the voxel size, and checks that all anchor positions are multiples of the voxel size.

        Raises:
            BitstreamError: If the voxel size is not a positive number, or a position is not a multiple of it.
        """
        try:
            value = float.fromhex(self.header["voxel_size"])
            check_voxel_size(value)
            voxel_indices(positions, value)
        except (TypeError, ValueError, OverflowError) as error:
            raise self.error(f"bad voxel size: {error}") from error
        return value

    def background(self) -> Background:
        """Reads the background colour; black if the file contains none.

        Raises:
            BitstreamError: If the value is not a colour.
        """
        try:
            return check_background(self.header.get("background", BLACK))
        except InvalidValueError as error:
            raise self.error(str(error)) from None

    def origin(self) -> Origin:
        """Reads the origin of a geo-referenced scene; (0, 0, 0) if the file contains none.

        Raises:
            BitstreamError: If the value is not an origin.
        """
        try:
            return check_origin(self.header.get("origin", NO_ORIGIN))
        except InvalidValueError as error:
            raise self.error(str(error)) from None

    def finish(self) -> None:
        """Checks that every tensor of the file was read.

        Raises:
            BitstreamError: If a tensor of the file was not read.
        """
        if self._left:
            raise self.error(f"unexpected tensor '{min(self._left)}'")


@contextmanager
def open_scene_file(path: Path, file_format: str, version: int, kind: str | None) -> Iterator[SceneReader]:
    """Opens a scene file and checks format, version and kind in the header.

    Args:
        path: Path of the file.
        file_format: Expected format in the header.
        version: Expected version in the header.
        kind: Expected kind, such as `scene` (complete) or `partial` (with losses); None to accept any kind.

    Raises:
        UnsupportedVersionError: If the file has a version that this release does not support.
        BitstreamError: If the file is not a scene file of this kind, or is damaged.
    """
    if file_kind(path) not in (SCENE, PARTIAL, TENSORS):
        raise BitstreamError(format_error(path, "a scene file"))
    with open_tensor_file(path) as file:
        header = _read_header(path, file.metadata, file_format, version)
        if kind is not None and header["kind"] != kind:
            raise BitstreamError(f"{path}: holds a {header['kind']!r}, not a {kind!r} scene")
        yield SceneReader(path, file, header)


def _read_header(path: Path, metadata: dict[str, str], file_format: str, version: int) -> dict[str, Any]:
    header = parse_header(metadata.get("splatwire"))
    if header.get("format") != file_format:
        raise BitstreamError(format_error(path, "a scene file"))
    if header.get("version") != version:
        raise UnsupportedVersionError(
            f"{path}: scene file version {header.get('version')!s:.20}, this release reads {version}"
        )
    missing = {"kind", "voxel_size", "config", "negative_slopes"} - set(header)
    if missing:
        raise BitstreamError(f"{path}: the header lacks '{min(missing)}'")
    return header
