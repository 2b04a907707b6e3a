"""Writes binary glTF with KHR_gaussian_splatting (see `splatwire.formats.gltf`)."""

import json
import struct
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from splatwire.files.whole import written_whole
from splatwire.formats._axes import GLTF_FLIPS, flip_axes
from splatwire.formats._columns import join
from splatwire.formats.gltf import EXTENSION, MAGIC
from splatwire.ops.spherical_harmonics import DC
from splatwire.scene.splats import Splats
from splatwire.version import __version__

_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_FLOAT, _BYTE, _VERTICES, _POINTS = 5126, 5121, 34962, 0
_WAY = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance",
    "projection": "perspective",
}
"""As the Gaussians of this field are drawn: trained against photos as they are displayed."""


def write_gltf(parts: Iterable[Splats], path: Path) -> int:
    """Writes one primitive of points in float32, and colours of a byte for programs that draw points only.

    See `splatwire.formats.write_splats`.
    """
    splats = flip_axes(join(path, parts), GLTF_FLIPS)
    columns = _columns(splats)
    document = json.dumps(_document(columns), separators=(",", ":")).encode()
    document += b" " * (-len(document) % 4)
    num_bytes = sum(values.nbytes for values in columns.values())
    with written_whole(path) as unfinished, unfinished.open("wb") as file:
        file.write(struct.pack("<4sII", MAGIC, 2, 12 + 8 + len(document) + 8 + num_bytes))
        file.write(struct.pack("<I4s", len(document), b"JSON") + document)
        file.write(struct.pack("<I4s", num_bytes, b"BIN\0"))
        for values in columns.values():
            file.write(values.tobytes())
    return splats.num_gaussians


def _columns(splats: Splats) -> dict[str, np.ndarray]:
    """What the attributes hold, all of whole words of four bytes."""
    sh, opacities = splats.sh.numpy(), splats.opacities.numpy()[:, None]
    seen = np.concatenate([0.5 + DC * sh[:, 0], opacities], axis=1)
    columns = {
        "POSITION": splats.means.numpy(),
        "COLOR_0": np.rint(seen.clip(0, 1) * 255).astype(np.uint8),
        f"{EXTENSION}:ROTATION": np.roll(splats.quats.numpy(), -1, axis=1),
        f"{EXTENSION}:SCALE": splats.scales.numpy(),
        f"{EXTENSION}:OPACITY": opacities,
    }
    for band in range(splats.degree + 1):
        for i in range(2 * band + 1):
            columns[f"{EXTENSION}:SH_DEGREE_{band}_COEF_{i}"] = sh[:, band * band + i]
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def _document(columns: dict[str, np.ndarray]) -> dict[str, object]:
    views: list[dict[str, int]] = []
    accessors: list[dict[str, object]] = []
    at = 0
    for index, values in enumerate(columns.values()):
        views.append({"buffer": 0, "byteOffset": at, "byteLength": values.nbytes, "target": _VERTICES})
        whole = values.dtype == np.uint8
        about = {"bufferView": index, "componentType": _BYTE if whole else _FLOAT, "count": len(values)}
        accessors.append({**about, "type": _TYPES[values.shape[1]], **({"normalized": True} if whole else {})})
        at += values.nbytes
    positions = columns["POSITION"]
    accessors[0] |= {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    attributes = {name: index for index, name in enumerate(columns)}
    primitive = {"attributes": attributes, "mode": _POINTS, "extensions": {EXTENSION: _WAY}}
    return {
        "asset": {"version": "2.0", "generator": f"splatwire {__version__}"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": at}],
        "bufferViews": views,
        "accessors": accessors,
    }
