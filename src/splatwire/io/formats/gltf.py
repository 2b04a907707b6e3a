"""Reader of glTF with Gaussians (KHR_gaussian_splatting), binary or as a JSON document with its buffers.

Axes are LUF (left, up, forward). Gaussians are primitives of points. The attribute POSITION has the centres. The other
attributes have the prefix `KHR_gaussian_splatting:`. They are ROTATION (x, y, z, w), SCALE (standard deviations),
OPACITY and SH_DEGREE_l_COEF_n. Integers are normalised. Node transforms are applied.
"""

import base64
import binascii
import json
import logging
import re
import struct
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.kinds import EXT_SPLATWIRE
from splatwire.files.mmap_array import large_empty
from splatwire.files.read_limited import read_at_most, read_json
from splatwire.io.formats._asset import metadata_of_asset, metadata_of_xmp, warn_of_unused_extras
from splatwire.io.formats._axes import GLTF_FLIPS as GLTF_FLIPS
from splatwire.io.formats._axes import harmonic_signs, is_similarity, transform_splats
from splatwire.io.formats._columns import (
    MAX_GAUSSIANS,
    build_splats,
    check_count,
    concatenate,
    warn_of_logits,
)
from splatwire.io.formats._files import FileBytes, is_in_folder_of, warn_of_bytes_outside
from splatwire.io.formats._gltf_nodes import VISIBILITY, Instance, described_nodes, entry, shown_instances
from splatwire.io.formats.content import FileContent, origin_of_placed
from splatwire.io.formats.ply_comments import (
    fields_as_comments,
    is_antialiasing_unclear,
    states_antialiasing,
    warn_of_unclear_antialiasing,
)
from splatwire.ops.spherical_harmonics import MAX_DEGREE
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
MAGIC = b"glTF"
EXTENSION = "KHR_gaussian_splatting"
_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_MAX_JSON_BYTES = 4 << 20
_MAX_CHUNKS = 1 << 10
"""Largest number of chunks of a binary file; two have a meaning."""
_MAX_WARNED = 4
"""Maximum number of primitives with unclear fields that are logged."""
_MOST = 0.5
"""Share of negative scales above which scales are logarithms; sizes are not negative."""
_MAX_STRIDE = 252
"""Largest distance between rows, bytes (glTF 2.0, section 3.6.2.4)."""
_READ_BYTES = 1 << 20
"""Number of bytes that are read at a time where rows of several attributes alternate."""
_POINTS = 0
_TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
_INDICES = {5121: "u1", 5123: "<u2", 5125: "<u4"}
_KNOWN = {
    "kernel": ("ellipse",),
    "colorSpace": ("srgb_rec709_display",),
    "projection": ("perspective",),
    "sortingMethod": ("cameraDistance",),
}
"""Supported settings of the extension."""
_SUPPORTED = (EXTENSION, EXT_SPLATWIRE, "KHR_mesh_quantization")
"""Extensions that a document may require."""
_READ = (*_SUPPORTED, VISIBILITY)
"""Extensions of a document or node that are read."""
_UNKNOWN_ATTRIBUTE = re.compile(rf"{EXTENSION}:(?!(?:ROTATION|SCALE|OPACITY|SH_DEGREE_\d+_COEF_\d+)$)")
_HARMLESS = (
    *("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "KHR_xmp", "EXT_lights_", "KHR_audio"),
    *("KHR_node_selectability", "KHR_node_hoverability"),
    *("EXT_structural_metadata", "EXT_mesh_features", "EXT_instance_features"),
)
"""Name prefixes of extensions that do not affect Gaussians."""


def read_gltf(path: Path) -> FileContent:
    """Reads all Gaussians and the metadata of a glTF scene; node transforms are applied to the Gaussians.

    If the nodes place the scene far from 0, positions are relative to an origin near the Gaussians.

    Args:
        path: A binary glTF, or a document whose buffers are files in its folder or `data:` URIs.

    Raises:
        DatasetError: If the file is damaged, has no Gaussians, contains compressed Gaussians, or names a buffer outside
            its folder.
        OSError: If the file cannot be read.
    """
    if read_at_most(path, len(MAGIC), DatasetError) == MAGIC:
        document, binary = _chunks(path, FileBytes(path))
    else:
        document, binary = read_json(path, DatasetError), None
        if not isinstance(document, dict):
            raise DatasetError(f"{path}: the glTF document is no object")
    try:
        return _Gltf(path, document, binary).content()
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise DatasetError(f"{path}: the glTF document is damaged: {type(error).__name__} {error}") from error


def _chunks(path: Path, data: FileBytes) -> tuple[dict[str, Any], FileBytes]:
    if len(data) < _HEADER.size + _CHUNK.size or bytes(data[:4]) != MAGIC:
        raise DatasetError(f"{path}: not a binary glTF file, it starts with {bytes(data[:4])!r}")
    _, version, length = _HEADER.unpack_from(data[: _HEADER.size])
    if version == 2 and length > len(data):
        raise DatasetError(f"{path}: is cut: it has {len(data):,} of {length:,} bytes")
    if version != 2:
        raise DatasetError(f"{path}: glTF of version {version}; version 2 is read")
    chunks: dict[bytes, FileBytes] = {}
    offset, num_chunks = _HEADER.size, 0
    while offset + _CHUNK.size <= length:
        num_chunks += 1
        if num_chunks > _MAX_CHUNKS:
            raise DatasetError(f"{path}: has more than {_MAX_CHUNKS:,} chunks")
        size, kind = _CHUNK.unpack_from(data[offset : offset + _CHUNK.size])
        offset += _CHUNK.size
        if size > length - offset:
            raise DatasetError(f"{path}: chunk {kind!r} of {size} bytes ends after the file")
        chunks.setdefault(kind, data.part(offset, offset + size))
        offset += size
    warn_of_bytes_outside(path, len(data) - offset)
    document = chunks.get(b"JSON", data.part(0, 0))
    if len(document) > _MAX_JSON_BYTES:
        raise DatasetError(f"{path}: a JSON chunk of {len(document)} bytes is more than {_MAX_JSON_BYTES}")
    try:
        content = json.loads(bytes(document[:]))
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{path}: the JSON chunk is no JSON: {error}") from error
    if not isinstance(content, dict):
        raise DatasetError(f"{path}: the JSON chunk is no object")
    return content, chunks.get(b"BIN\0", data.part(0, 0))


def _placement(instance: Instance) -> tuple[np.ndarray, np.ndarray]:
    """Returns the transform of a mesh instance in the axes of a PLY: matrix (3, 3) and shift (3), float64."""
    flips = np.diag(GLTF_FLIPS)
    return flips @ instance.matrix[:3, :3] @ flips, flips @ instance.matrix[:3, 3]


def _extras(part: object) -> list[str]:
    """Returns the fields in the `extras` of a JSON object in the form of comments."""
    return fields_as_comments(part.get("extras") if isinstance(part, dict) else None)


class _Gltf:
    """A glTF document and the binary buffers that it refers to."""

    def __init__(self, path: Path, document: dict[str, Any], binary: FileBytes | None) -> None:
        self._path, self._document, self._binary = path, document, binary
        self._buffers: dict[int, memoryview | FileBytes] = {}
        self._resources: dict[str, memoryview | FileBytes] = {}

    def _check_version(self) -> None:
        """Checks that the document requires no unsupported version or extension.

        Raises:
            DatasetError: If it has another version, or requires an extension that may affect Gaussians.
        """
        asset = self._document.get("asset")
        for name in ("version", "minVersion"):
            version = asset.get(name, "2.0") if isinstance(asset, dict) else "2.0"
            if not isinstance(version, str) or not re.fullmatch(r"2\.[0-9]+", version):
                raise DatasetError(f"{self._path}: asset.{name} is {version!r:.40}; glTF of version 2 is read")
        required = self._document.get("extensionsRequired", [])
        unknown = [str(name) for name in required if name not in _SUPPORTED and not str(name).startswith(_HARMLESS)]
        if unknown:
            names = ", ".join(unknown)[:120]
            raise DatasetError(f"{self._path}: it requires {names}, which is not read: export it without")

    def content(self) -> FileContent:
        """Returns the Gaussians of all primitives, repeated for each node that shows them, and the scene's metadata."""
        self._check_version()
        meshes = self._document.get("meshes", [])
        primitives_by_mesh = {index: self._primitives(mesh) for index, mesh in enumerate(meshes)}
        primitives_by_mesh = {index: primitives for index, primitives in primitives_by_mesh.items() if primitives}
        if not primitives_by_mesh:
            raise DatasetError(f"{self._path}: no primitive with {EXTENSION}, which says that points are Gaussians")
        shown = [instance for instance in self._instances(primitives_by_mesh) if instance.mesh in primitives_by_mesh]
        counts = {
            index: sum(map(self._count, primitives_by_mesh[index])) for index in {instance.mesh for instance in shown}
        }
        # Count distinct buffers: two buffer entries may be the same file.
        held = sum({id(data): len(data) for data in self._buffers.values()}.values())
        check_count(self._path, sum(counts[instance.mesh] for instance in shown), held)
        read = {
            index: [self._primitive(primitive) for primitive in primitives_by_mesh[index]]
            for index in {s.mesh for s in shown}
        }
        origin = origin_of_placed([(part, *_placement(instance)) for instance in shown for part in read[instance.mesh]])
        moved = [self._transformed(part, instance, origin) for instance in shown for part in read[instance.mesh]]
        antialiased = self._is_antialiased({index: primitives_by_mesh[index] for index in read})
        warn_of_unused_extras(self._path, self._document.get("asset"))
        stretched = [
            instance.node
            for instance in shown
            if any(part.degree for part in read[instance.mesh]) and not is_similarity(_placement(instance)[0])
        ]
        if stretched:
            LOG.warning(
                "%s: %s stretches its Gaussians: their shape follows, and their harmonics only turn",
                self._path, described_nodes(stretched),
            )  # fmt: skip
        of_xmp = metadata_of_xmp(self._document, self._path)
        metadata = metadata_of_asset(self._document.get("asset"), self._path, of_xmp.license)
        metadata = metadata.over(of_xmp).moved_origin(NO_ORIGIN, origin)
        return FileContent(concatenate(moved), origin, antialiased, metadata)

    def _is_antialiased(self, primitives_by_mesh: dict[int, list[dict[str, Any]]]) -> bool:
        """True if `extras` of a primitive, or of what contains it, request antialiasing.

        Logs a warning if only some primitives request it, or if a field is unclear.

        Args:
            primitives_by_mesh: Primitives with Gaussians that the scene shows, by index of the mesh.
        """
        common = [comment for part in (self._document, self._document.get("asset")) for comment in _extras(part)]
        stated_fields = {
            (
                *common,
                *_extras(self._document["meshes"][index]),
                *_extras(primitive["extensions"][EXTENSION]),
                *_extras(primitive),
            )
            for index, primitives in primitives_by_mesh.items()
            for primitive in primitives
        }
        answers = {states_antialiasing(fields) for fields in stated_fields}
        for fields in sorted(filter(is_antialiasing_unclear, stated_fields))[:_MAX_WARNED]:
            warn_of_unclear_antialiasing(self._path, fields, "field", drawn_with_it=any(answers))
        if len(answers) > 1:
            LOG.warning(
                "%s: some primitives ask for antialiasing, others do not: the scene is drawn with it", self._path
            )
        return any(answers)

    def _instances(self, primitives: dict[int, list[dict[str, Any]]]) -> list[Instance]:
        """Returns all meshes with Gaussians, and the transform of each mesh.

        Logs the parts of the document that are ignored, such as animations.

        Args:
            primitives: For each mesh, its primitives with Gaussians, by index of the mesh.
        """
        shown = [instance for instance in shown_instances(self._path, self._document) if instance.mesh in primitives]
        if not shown:
            LOG.warning("%s: no node of its scene shows the Gaussians: they are read as they are", self._path)
            return [Instance(mesh, np.eye(4), None) for mesh in primitives]
        if hidden := len(primitives) - len({instance.mesh for instance in shown}):
            LOG.warning("%s: %d meshes of Gaussians that its scene does not show are left out", self._path, hidden)
        nodes = self._document.get("nodes", [])
        if any(instance.node is not None and "skin" in nodes[instance.node] for instance in shown):
            LOG.warning("%s: skins of nodes are left out: Gaussians stay where their attributes are", self._path)
        if self._document.get("animations"):
            LOG.warning("%s: its animations are left out", self._path)
        self._warn_of_extensions(nodes)
        vanished = [instance for instance in shown if not instance.matrix[:3, :3].any()]
        if vanished:
            LOG.warning("%s: %d nodes that are scaled to nothing are left out", self._path, len(vanished))
        return [instance for instance in shown if instance.matrix[:3, :3].any()]

    def _warn_of_extensions(self, nodes: list[dict[str, Any]]) -> None:
        """Logs unknown glTF extensions of the document, scenes and nodes, which may move or hide Gaussians."""
        objects = [self._document, *self._document.get("scenes", []), *nodes]
        names = {str(name) for one in objects for name in one.get("extensions", {})}
        unknown = sorted(name for name in names if name not in _READ and not name.startswith(_HARMLESS))
        if unknown:
            LOG.warning(
                "%s: extensions %s of the document or its nodes are not known: Gaussians may be elsewhere",
                self._path, ", ".join(unknown)[:120],
            )  # fmt: skip

    def _primitives(self, mesh: dict[str, Any]) -> list[dict[str, Any]]:
        """Returns the primitives of a mesh that are Gaussians.

        Raises:
            DatasetError: If a primitive is compressed.
        """
        gaussian_primitives = [one for one in mesh.get("primitives", []) if EXTENSION in one.get("extensions", {})]
        for primitive in gaussian_primitives:
            settings = primitive["extensions"][EXTENSION]
            if packed := settings.get("extensions"):
                names = ", ".join(map(str, packed))[:80]
                raise DatasetError(f"{self._path}: Gaussians compressed by {names} are not read")
            for name, values in _KNOWN.items():
                if settings.get(name, values[0]) not in values:
                    LOG.warning("%s: %s %.40r is read as %s", self._path, name, settings[name], values[0])
            unknown = settings.keys() - _KNOWN.keys() - {"extras"}
            unknown |= {name for name in primitive.get("attributes", {}) if _UNKNOWN_ATTRIBUTE.match(name)}
            others = primitive["extensions"].keys() - {EXTENSION, EXT_SPLATWIRE}
            unknown |= {name for name in others if not str(name).startswith(_HARMLESS)}
            if unknown:
                names = ", ".join(sorted(map(str, unknown)))[:120]
                LOG.warning("%s: %s of %s are not known: the scene may look different", self._path, names, EXTENSION)
            ignored = [name for name in ("indices", "targets") if name in primitive]
            ignored += ["mode"] if primitive.get("mode", _POINTS) != _POINTS else []
            if ignored:
                names = ", ".join(ignored)
                LOG.warning("%s: %s of a primitive of Gaussians are left out: all are points", self._path, names)
        return gaussian_primitives

    def _count(self, primitive: dict[str, Any]) -> int:
        """Returns the number of Gaussians of a primitive, and opens the buffers with the Gaussians' attributes.

        Args:
            primitive: The glTF primitive, a JSON object.

        Raises:
            DatasetError: If an attribute has no accessor, or the number is invalid.
        """
        counts = {}
        for name, index in primitive["attributes"].items():
            if type(index) is not int:
                raise DatasetError(f"{self._path}: attribute {name[:80]} names no accessor")
            accessor = entry(self._path, self._document["accessors"], index, "accessor")
            counts[name] = accessor["count"]
            if name == "POSITION" or name.startswith(EXTENSION):
                self._locate(accessor)
        count = counts.get("POSITION", 0)
        if type(count) is not int or count < 0:
            raise DatasetError(f"{self._path}: attribute POSITION has {count!r:.40} rows")
        return count

    def _locate(self, accessor: dict[str, Any]) -> None:
        """Opens the buffers that contain an accessor (one array of a glTF document)."""
        sparse = accessor.get("sparse", {})
        for source in (accessor, sparse.get("indices", {}), sparse.get("values", {})):
            if "bufferView" in source:
                view = entry(self._path, self._document["bufferViews"], source["bufferView"], "buffer view")
                self._buffer(view["buffer"])

    def _transformed(self, splats: Splats, instance: Instance, origin: Origin) -> Splats:
        """Applies the transform of a scene node to Gaussians, and makes their positions relative to `origin`.

        Raises:
            DatasetError: If the result is out of range.
        """
        matrix, shift = _placement(instance)
        shift = shift - np.array(origin)
        if np.array_equal(matrix, np.eye(3)) and not shift.any():
            return splats
        if not np.isfinite(matrix).all() or not np.isfinite(shift).all():
            raise DatasetError(f"{self._path}: node {instance.node} moves its Gaussians too far")
        return transform_splats(splats, matrix, shift)

    def _primitive(self, primitive: dict[str, Any]) -> Splats:
        attributes = primitive["attributes"]
        means = self._accessor(attributes, "POSITION", 3)
        names = [
            f"{EXTENSION}:SH_DEGREE_{band}_COEF_{i}" for band in range(MAX_DEGREE + 1) for i in range(2 * band + 1)
        ]
        is_present = [name in attributes for name in names]
        functions = is_present.index(False) if False in is_present else len(is_present)
        if any(is_present[functions:]) or functions not in (1, 4, 9, 16):
            raise DatasetError(
                f"{self._path}: {sum(is_present)} attributes SH_DEGREE_* are not those of a degree of 0 to 3"
            )
        if higher := sum(name.startswith(f"{EXTENSION}:SH_DEGREE_") for name in attributes) - functions:
            LOG.warning("%s: %d attributes of harmonics above degree %d are left out", self._path, higher, MAX_DEGREE)
        quats = self._accessor(attributes, f"{EXTENSION}:ROTATION", 4)
        sh = np.empty((len(means), functions, 3), np.float32)
        signs = harmonic_signs(GLTF_FLIPS, int(functions**0.5) - 1)
        for index, name in enumerate(names[:functions]):
            rows = self._accessor(attributes, name, 3)
            if len(rows) != len(means):
                raise DatasetError(f"{self._path}: {len(rows)} Gaussians have {name}, {len(means)} a position")
            sh[:, index] = rows * signs[index]
        opacities = self._accessor(attributes, f"{EXTENSION}:OPACITY", 1)[:, 0]
        warn_of_logits(self._path, opacities, "glTF")
        scales = self._accessor(attributes, f"{EXTENSION}:SCALE", 3)
        are_logs = float((scales < 0).mean()) > _MOST if scales.size else False
        if are_logs:
            LOG.warning(
                "%s: scales from %.3g to %.3g are read as logarithms, as in a draft of %s, because sizes are not "
                "negative", self._path, float(scales.min()), float(scales.max()), EXTENSION,
            )  # fmt: skip
        return build_splats(
            self._path,
            means=means * np.array(GLTF_FLIPS, np.float32),
            quats=np.roll(quats, 1, axis=1) * np.array((1, *GLTF_FLIPS), np.float32),
            scales=None if are_logs else scales,
            log_scales=scales if are_logs else None,
            opacities=opacities,
            sh=sh,
        )

    def _buffer(self, index: int) -> memoryview | FileBytes:
        """Returns the bytes of a glTF buffer.

        A buffer is the binary chunk of the file, a separate file, or a `data:` URI.

        Raises:
            DatasetError: If the buffer is missing, or not in the file, the folder of the file or a `data:` URI.
        """
        if index not in self._buffers:
            uri = entry(self._path, self._document["buffers"], index, "buffer").get("uri")
            if uri is not None:
                if not isinstance(uri, str):
                    raise DatasetError(f"{self._path}: {uri!r:.60} is no URI of a buffer")
                if uri not in self._resources:
                    self._resources[uri] = self._resource(uri)
                self._buffers[index] = self._resources[uri]
            elif self._binary is not None and index == 0:
                self._buffers[index] = self._binary
            else:
                raise DatasetError(f"{self._path}: buffer {index} has no URI")
        return self._buffers[index]

    def _resource(self, uri: str) -> memoryview | FileBytes:
        if uri.startswith("data:"):
            head, _, content = uri.partition(",")
            try:
                if not re.search(";base64$", head):
                    raise binascii.Error("it is not base64")
                return memoryview(base64.b64decode(content, validate=True))
            except (binascii.Error, ValueError) as error:
                raise DatasetError(f"{self._path}: a buffer's data: URI is damaged: {error}") from error
        parts, name = urlsplit(uri), PurePosixPath(unquote(urlsplit(uri).path))
        if parts.scheme or parts.netloc or name.is_absolute() or ".." in name.parts or "\\" in uri or "\0" in str(name):
            raise DatasetError(f"{self._path}: buffer {uri!r:.80} is no file in the folder of the document")
        if not name.name:
            raise DatasetError(f"{self._path}: a buffer's URI {uri!r:.80} names no file: its bytes are missing")
        file = self._path.parent / name
        if not is_in_folder_of(self._path, file):  # its bytes would become part of a scene
            raise DatasetError(
                f"{self._path}: buffer {uri!r:.80} is a link out of the folder of the document: replace it by a copy"
            )
        return FileBytes(file)

    def _accessor(self, attributes: dict[str, int], name: str, width: int) -> np.ndarray:
        """Returns the values of a glTF accessor (vertex attribute) as float32 (N, width).

        Args:
            attributes: Index of the accessor of each vertex attribute, by name.
            name: Name of the attribute.
            width: Numbers per Gaussian.

        Raises:
            DatasetError: If the attribute is missing, or has another form.
        """
        if name not in attributes:
            raise DatasetError(f"{self._path}: attribute {name} is missing")
        accessor = entry(self._path, self._document["accessors"], attributes[name], "accessor")
        code, count = accessor["componentType"], accessor["count"]
        if code not in _COMPONENTS or _TYPES.get(accessor["type"]) != width:
            raise DatasetError(f"{self._path}: attribute {name} is no plain array of {width} numbers per Gaussian")
        dtype = np.dtype(_COMPONENTS[code])
        # Integers that are not normalised: KHR_mesh_quantization permits them for positions, KHR_gaussian_splatting
        # for scales.
        whole = name in ("POSITION", f"{EXTENSION}:SCALE") and not accessor.get("normalized")
        if dtype.kind != "f" and not accessor.get("normalized") and not whole:
            raise DatasetError(f"{self._path}: attribute {name} has integers that are not normalised")
        rows = self._rows(name, accessor, dtype, (count, width))
        if "sparse" in accessor:
            rows = self._replaced(name, accessor["sparse"], rows)
        if dtype.kind == "f" or whole:
            return rows.astype(np.float32)
        return np.maximum(rows.astype(np.float32) / np.float32(np.iinfo(dtype).max), -1)

    def _replaced(self, name: str, sparse: dict[str, Any], rows: np.ndarray) -> np.ndarray:
        """Returns the rows of an array (accessor) after applying the changes in its `sparse` object.

        Args:
            name: Name of the attribute, for messages.
            sparse: The `sparse` object, which lists indices of rows and their new values.
            rows: Rows before the changes.
        """
        indices, values = sparse["indices"], sparse["values"]
        dtype = np.dtype(_INDICES[indices["componentType"]])
        changed = self._rows(name, indices, dtype, (sparse["count"], 1))[:, 0]
        new = self._rows(name, values, rows.dtype, (sparse["count"], rows.shape[1]))
        if (changed >= len(rows)).any():
            raise DatasetError(f"{self._path}: attribute {name} replaces a row that it does not have")
        replaced = rows.copy()
        replaced[changed] = new
        return replaced

    def _rows(self, name: str, source: dict[str, Any], dtype: np.dtype, shape: tuple[int, int]) -> np.ndarray:
        """Reads an array from a buffer of the document.

        The array is zero if the document names no buffer.

        Args:
            name: Name of the attribute, for messages.
            source: JSON object with the source of the array: `bufferView` and `byteOffset`.
            dtype: Type of the numbers.
            shape: Number of rows, and number of columns.
        """
        count, width = shape
        if "bufferView" not in source:
            if type(count) is not int or not 0 <= count <= MAX_GAUSSIANS:
                raise DatasetError(f"{self._path}: attribute {name} has an impossible number of rows, {count!r:.40}")
            return np.broadcast_to(np.zeros(width, dtype), shape)
        view = entry(self._path, self._document["bufferViews"], source["bufferView"], "buffer view")
        if packed := view.get("extensions"):
            names = ", ".join(map(str, packed))[:80]
            raise DatasetError(f"{self._path}: attribute {name} is compressed by {names}, which is not read")
        start, offset = view.get("byteOffset", 0), source.get("byteOffset", 0)
        stride = view.get("byteStride", dtype.itemsize * width)
        size, item = view["byteLength"], dtype.itemsize * width
        sizes = (start, offset, stride, size, count)
        if not all(isinstance(value, int) and 0 <= value < 1 << 40 for value in sizes):
            raise DatasetError(f"{self._path}: attribute {name} has impossible sizes {sizes}")
        binary = self._buffer(view.get("buffer"))
        if start + size > len(binary) or offset + stride * max(count - 1, 0) + item > size or stride < item:
            raise DatasetError(f"{self._path}: attribute {name} of {count} rows ends after its buffer")
        if stride > max(_MAX_STRIDE, item):
            raise DatasetError(f"{self._path}: rows of attribute {name} are {stride} bytes apart, above {_MAX_STRIDE}")
        if stride == item:
            first = start + offset
            return np.ndarray(shape, dtype, binary[first : first + item * count])
        # Rows of several attributes alternate: those of the others are read, too, but not kept.
        rows, block = large_empty(shape, dtype), _READ_BYTES // stride
        for begin in range(0, count, block):
            first, length = start + offset + begin * stride, min(block, count - begin)
            piece = binary[first : first + stride * (length - 1) + item]
            rows[begin : begin + length] = np.ndarray((length, width), dtype, piece, 0, (stride, dtype.itemsize))
        return rows
