"""Binary glTF with KHR_gaussian_splatting; axes of the file are LUF.

Attributes of a primitive of points: POSITION, and under the extension's name ROTATION (x, y, z, w), SCALE (standard
deviations), OPACITY and SH_DEGREE_l_COEF_n. Integers are normalised.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.errors import DatasetError
from splatwire.formats._axes import GLTF_FLIPS, harmonic_signs
from splatwire.formats._columns import build_splats, check_count
from splatwire.formats._files import mapped_file
from splatwire.ops.spherical_harmonics import MAX_DEGREE
from splatwire.scene.splats import Splats

MAGIC = b"glTF"
EXTENSION = "KHR_gaussian_splatting"
_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_MAX_JSON_BYTES = 4 << 20
_STILL = {
    "matrix": np.eye(4).ravel().tolist(),
    "translation": [0, 0, 0],
    "rotation": [0, 0, 0, 1],
    "scale": [1, 1, 1],
}
_TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}


def read_gltf(path: Path) -> Splats:
    """Reads the only primitive with Gaussians of a binary glTF file.

    Raises:
        DatasetError: If it is damaged, has no Gaussians, compressed ones or more than one set, or a node above them
            moves them.
        OSError: If it cannot be read.
    """
    document, binary = _chunks(path, mapped_file(path))
    try:
        return _Gltf(path, document, binary).splats()
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise DatasetError(f"{path}: the glTF document is damaged: {type(error).__name__} {error}") from error


def _chunks(path: Path, data: memoryview) -> tuple[dict[str, Any], memoryview]:
    if len(data) < _HEADER.size + _CHUNK.size or bytes(data[:4]) != MAGIC:
        raise DatasetError(f"{path}: not a binary glTF file, it starts with {bytes(data[:4])!r}")
    _, version, length = _HEADER.unpack_from(data)
    if version != 2 or length > len(data):
        raise DatasetError(f"{path}: glTF of version {version} and {length} bytes; version 2 and {len(data)} are there")
    found: dict[bytes, memoryview] = {}
    view, at = data[:length], _HEADER.size
    while at + _CHUNK.size <= length:
        size, kind = _CHUNK.unpack_from(data, at)
        at += _CHUNK.size
        if size > length - at:
            raise DatasetError(f"{path}: chunk {kind!r} of {size} bytes ends after the file")
        found.setdefault(kind, view[at : at + size])
        at += size
    document = found.get(b"JSON", view[:0])
    if len(document) > _MAX_JSON_BYTES:
        raise DatasetError(f"{path}: a JSON chunk of {len(document)} bytes is more than {_MAX_JSON_BYTES}")
    try:
        content = json.loads(bytes(document))
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: the JSON chunk is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: the JSON chunk is no object")
    return content, found.get(b"BIN\0", view[:0])


class _Gltf:
    """The document and its binary chunk."""

    def __init__(self, path: Path, document: dict[str, Any], binary: memoryview) -> None:
        self._path, self._document, self._binary = path, document, binary

    def splats(self) -> Splats:
        attributes = self._attributes()
        means = self._accessor(attributes, "POSITION", 3)
        check_count(self._path, len(means), len(self._binary))
        names = [
            f"{EXTENSION}:SH_DEGREE_{band}_COEF_{i}" for band in range(MAX_DEGREE + 1) for i in range(2 * band + 1)
        ]
        there = [name in attributes for name in names]
        functions = there.index(False) if False in there else len(there)
        if any(there[functions:]) or functions not in (1, 4, 9, 16):
            raise DatasetError(f"{self._path}: {sum(there)} attributes SH_DEGREE_* are not those of a degree of 0 to 3")
        quats = self._accessor(attributes, f"{EXTENSION}:ROTATION", 4)
        sh = np.empty((len(means), functions, 3), np.float32)
        signs = harmonic_signs(GLTF_FLIPS, int(functions**0.5) - 1)
        for place, name in enumerate(names[:functions]):
            rows = self._accessor(attributes, name, 3)
            if len(rows) != len(means):
                raise DatasetError(f"{self._path}: {len(rows)} Gaussians have {name}, {len(means)} a position")
            sh[:, place] = rows * signs[place]
        return build_splats(
            self._path,
            means=means * np.array(GLTF_FLIPS, np.float32),
            quats=np.roll(quats, 1, axis=1) * np.array((1, *GLTF_FLIPS), np.float32),
            scales=self._accessor(attributes, f"{EXTENSION}:SCALE", 3),
            opacities=self._accessor(attributes, f"{EXTENSION}:OPACITY", 1)[:, 0],
            sh=sh,
        )

    def _attributes(self) -> dict[str, int]:
        found = [
            (mesh, primitive)
            for mesh, content in enumerate(self._document.get("meshes", []))
            for primitive in content.get("primitives", [])
            if EXTENSION in primitive.get("extensions", {})
        ]
        if len(found) != 1:
            raise DatasetError(f"{self._path}: {len(found)} primitives with {EXTENSION}, exactly one is read")
        mesh, primitive = found[0]
        packed = primitive["extensions"][EXTENSION].get("extensions")
        if packed:
            raise DatasetError(f"{self._path}: Gaussians compressed by {', '.join(map(str, packed))[:80]} are not read")
        self._refuse_moved(mesh)
        attributes = dict(primitive["attributes"])
        if odd := [name for name, index in attributes.items() if type(index) is not int]:
            raise DatasetError(f"{self._path}: attribute {odd[0][:80]} names no accessor")
        return attributes

    def _refuse_moved(self, mesh: int) -> None:
        nodes = self._document.get("nodes", [])
        todo = [index for index, node in enumerate(nodes) if node.get("mesh") == mesh]
        if len(todo) > 1:
            raise DatasetError(f"{self._path}: {len(todo)} nodes show the Gaussians, one is read")
        parents: dict[int, list[int]] = {}
        for index, node in enumerate(nodes):
            for child in node.get("children", []):
                parents.setdefault(child, []).append(index)
        above: set[int] = set()
        while todo:
            if (index := todo.pop()) not in above:
                above.add(index)
                todo += parents.get(index, [])
        for index in sorted(above):
            for name, value in _STILL.items():
                if nodes[index].get(name, value) != value:
                    raise DatasetError(f"{self._path}: node {index} has a {name}: apply it to the Gaussians first")

    def _accessor(self, attributes: dict[str, int], name: str, width: int) -> np.ndarray:
        """An attribute as float32 (N, width)."""
        if name not in attributes:
            raise DatasetError(f"{self._path}: attribute {name} is missing")
        accessor = self._document["accessors"][attributes[name]]
        code, count = accessor["componentType"], accessor["count"]
        if code not in _COMPONENTS or _TYPES.get(accessor["type"]) != width or "sparse" in accessor:
            raise DatasetError(f"{self._path}: attribute {name} is no plain array of {width} numbers per Gaussian")
        dtype = np.dtype(_COMPONENTS[code])
        if dtype.kind != "f" and not accessor.get("normalized"):
            raise DatasetError(f"{self._path}: attribute {name} has integers that are not normalised")
        view = self._document["bufferViews"][accessor["bufferView"]]
        start, offset = view.get("byteOffset", 0), accessor.get("byteOffset", 0)
        stride = view.get("byteStride", dtype.itemsize * width)
        size, item = view["byteLength"], dtype.itemsize * width
        sizes = (start, offset, stride, size, count)
        if not all(isinstance(value, int) and 0 <= value < 1 << 40 for value in sizes) or view.get("buffer") != 0:
            raise DatasetError(f"{self._path}: attribute {name} has impossible sizes {sizes}")
        if start + size > len(self._binary) or offset + stride * max(count - 1, 0) + item > size or stride < item:
            raise DatasetError(f"{self._path}: attribute {name} of {count} rows ends after its buffer")
        rows = np.ndarray((count, width), dtype, self._binary, start + offset, (stride, dtype.itemsize))
        if dtype.kind == "f":
            return rows.astype(np.float32)
        return np.maximum(rows.astype(np.float32) / np.float32(np.iinfo(dtype).max), -1)
