"""Writer of binary glTF files with Gaussians (extension KHR_gaussian_splatting).

A file may also contain a compressed stream of the same scene (extension EXT_splatwire).
"""

import json
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.files.atomic_write import atomic_output
from splatwire.files.kinds import EXT_SPLATWIRE
from splatwire.io.formats._asset import asset_of
from splatwire.io.formats._axes import GLTF_FLIPS, flip_axes
from splatwire.io.formats._columns import join
from splatwire.io.formats.gltf import EXTENSION, MAGIC
from splatwire.ops.spherical_harmonics import DC
from splatwire.types.metadata import NO_METADATA, SceneMetadata
from splatwire.types.origin import NO_ORIGIN, Origin
from splatwire.types.splats import Splats

_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_FLOAT, _BYTE, _VERTICES, _POINTS = 5126, 5121, 34962, 0
_WAY = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}
"""Settings of the extension for 3DGS scenes: their colours are display-referred (sRGB), like the training photos."""


def write_gltf(
    parts: Iterable[Splats],
    path: Path,
    *,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    metadata: SceneMetadata = NO_METADATA,
    stream: bytes | None = None,
) -> int:
    """Writes all Gaussians as one point primitive in float32; returns their number.

    Args:
        parts: Batches of Gaussians.
        path: Path of the file.
        antialiased: True if the scene was trained with antialiased rendering (Mip-Splatting), which lowers the opacity
            of Gaussians that it widens to a pixel. The primitive's extras store this flag.
        origin: World coordinates of the point that positions are relative to; stored as translation of the node.
        metadata: Metadata of the scene; the initial view is relative to `origin`.
        stream: Content of a `.swz` file of the same scene, to embed in the file; None to embed nothing. Programs that
            support the extension EXT_splatwire (docs/gltf.md) draw this stream instead of the Gaussians in `parts`.
    """
    splats = join(path, parts)
    columns = _columns(flip_axes(splats, GLTF_FLIPS))
    content = _document(columns)
    content["asset"] |= asset_of(metadata.moved_origin(origin, NO_ORIGIN))
    if origin != NO_ORIGIN:
        content["nodes"][0]["translation"] = [flip * value for flip, value in zip(GLTF_FLIPS, origin, strict=True)]
    if antialiased:
        content["meshes"][0]["primitives"][0]["extras"] = {"antialiased": True}
    packed = b"" if stream is None else stream + bytes(-len(stream) % 4)
    if stream is not None:
        _put_stream(content, len(stream), len(packed))
    document = json.dumps(content, separators=(",", ":")).encode()
    document += b" " * (-len(document) % 4)
    num_bytes = sum(values.nbytes for values in columns.values()) + len(packed)
    with atomic_output(path) as unfinished, unfinished.open("wb") as file:
        file.write(struct.pack("<4sII", MAGIC, 2, 12 + 8 + len(document) + 8 + num_bytes))
        file.write(struct.pack("<I4s", len(document), b"JSON") + document)
        file.write(struct.pack("<I4s", num_bytes, b"BIN\0"))
        for values in columns.values():
            file.write(values.tobytes())
        file.write(packed)
    return splats.num_gaussians


def _put_stream(document: dict[str, Any], num_bytes: int, num_padded: int) -> None:
    """Adds the JSON objects of an embedded stream to a glTF document: its buffer view and its extension.

    Args:
        document: The JSON document; changed in place.
        num_bytes: Size of the stream in bytes.
        num_padded: Size of the stream with padding, a multiple of 4.
    """
    [buffer], views = document["buffers"], document["bufferViews"]
    views.append({"buffer": 0, "byteOffset": buffer["byteLength"], "byteLength": num_bytes})
    buffer["byteLength"] += num_padded
    document["extensionsUsed"].append(EXT_SPLATWIRE)
    [primitive] = document["meshes"][0]["primitives"]
    packed = {"extensions": {EXT_SPLATWIRE: {"bufferView": len(views) - 1}}}
    primitive["extensions"][EXTENSION] = _WAY | packed


def _columns(splats: Splats) -> dict[str, np.ndarray]:
    """Returns the vertex attribute arrays of a glTF primitive, each padded to a multiple of four bytes."""
    sh, opacities = splats.sh, splats.opacities[:, None]
    seen = np.concatenate([_linear((0.5 + DC * sh[:, 0]).clip(0, 1)), opacities], axis=1)
    columns = {
        "POSITION": splats.means,
        "COLOR_0": np.rint(seen.clip(0, 1) * 255).astype(np.uint8),
        f"{EXTENSION}:ROTATION": np.roll(splats.quats, -1, axis=1),
        f"{EXTENSION}:SCALE": splats.scales,
        f"{EXTENSION}:OPACITY": opacities,
    }
    for band in range(splats.degree + 1):
        for i in range(2 * band + 1):
            columns[f"{EXTENSION}:SH_DEGREE_{band}_COEF_{i}"] = sh[:, band * band + i]
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def _linear(colours: np.ndarray) -> np.ndarray:
    """Converts colours from sRGB to linear, which glTF requires for vertex colours."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def _document(columns: dict[str, np.ndarray]) -> dict[str, Any]:
    views: list[dict[str, int]] = []
    accessors: list[dict[str, object]] = []
    offset = 0
    for index, values in enumerate(columns.values()):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes, "target": _VERTICES})
        whole = values.dtype == np.uint8
        about = {"bufferView": index, "componentType": _BYTE if whole else _FLOAT, "count": len(values)}
        accessors.append({**about, "type": _TYPES[values.shape[1]], **({"normalized": True} if whole else {})})
        offset += values.nbytes
    positions = columns["POSITION"]
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    attributes = {name: index for index, name in enumerate(columns)}
    primitive = {"attributes": attributes, "mode": _POINTS, "extensions": {EXTENSION: _WAY}}
    return {
        "asset": {"version": "2.0"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
