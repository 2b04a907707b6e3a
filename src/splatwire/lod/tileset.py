"""Writer of 3D Tiles (OGC, version 1.1): `tileset.json`, and a binary glTF for each tile of each level."""

import json
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.bitstream.tiles import parents_of
from splatwire.errors import InvalidValueError
from splatwire.files.atomic_write import atomic_write
from splatwire.io.formats.dispatch import warn_of_antialiasing_in_extras, warn_of_background
from splatwire.io.formats.gltf import GLTF_FLIPS
from splatwire.io.formats.gltf_writer import write_gltf
from splatwire.lod.building import build_levels
from splatwire.lod.tiles import level_shapes
from splatwire.types import Scene, SplatScene
from splatwire.types.metadata import SceneMetadata, metadata_to_json
from splatwire.types.origin import NO_ORIGIN, Origin, describe_origin
from splatwire.types.splats import Splats
from splatwire.version import __version__

LOG = logging.getLogger(__name__)
TILE = 1 << 15
"""Maximum number of Gaussians per tile; a tile of degree 3 takes 7.9 MB."""
ERROR_SCALE = 32.0
"""Geometric error of 3D Tiles per root mean square distance of centres. Clients refine at an error of 16 pixels by
default; this scale makes this half a pixel between centres, as in the selection of levels of a stream."""
TILESET, CONTENTS = "tileset.json", "tiles"
_REACH = 3.0
"""Radius of a Gaussian for the bounding box of a tile, standard deviations."""
_EARTH_RADII = (6.3e6, 6.5e6)
"""Range of distances from the centre of the Earth, metres, in which an origin counts as geocentric (ECEF)."""
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Rotation from the axes of glTF (y up) to those of 3D Tiles (z up), which clients apply to the contents of tiles."""
_TO_TILES = _Z_UP @ np.diag(GLTF_FLIPS)
"""Rotation from the axes of a PLY to those of 3D Tiles."""


@dataclass(frozen=True)
class TilesetReport:
    """Size of a tileset that was written.

    Attributes:
        num_tiles: Number of tiles with content.
        num_levels: Number of levels of detail.
        num_gaussians: Number of Gaussians of the finest level.
        num_bytes: Bytes of all files.
        geocentric: True if the tileset is placed on the Earth.
    """

    num_tiles: int
    num_levels: int
    num_gaussians: int
    num_bytes: int
    geocentric: bool


def write_tileset(
    scene: Scene, folder: Path, *, tile: int = TILE, progress: Callable[[float], None] | None = None
) -> TilesetReport:
    """Builds the levels of detail of a scene and writes them as 3D Tiles.

    A scene whose origin is in geocentric coordinates (ECEF) is placed on the Earth.

    Args:
        scene: Explicit Gaussians; invisible and invalid ones are removed, which is logged.
        folder: Existing folder of the tileset.
        tile: Maximum number of Gaussians per tile.
        progress: Called with the completed fraction, 0 to 1.

    Raises:
        InvalidValueError: If there is no Gaussian, or the scene has anchors.
    """
    scene = explicit_scene(scene, "3D Tiles hold")
    warn_of_background(folder, scene.background)
    if scene.antialiased:
        warn_of_antialiasing_in_extras(folder)
    credit = SceneMetadata(author=scene.metadata.author, license=scene.metadata.license)
    report = progress or (lambda share: None)
    built = build_levels(scene, tile, lambda share: report(share / 2))
    shapes = level_shapes(scene.num_elements, tile)
    num_tiles = sum(shape.num_tiles for shape in shapes)
    written, num_bytes, below = 0, 0, list[dict[str, Any]]()
    end, first = sum(shape.count for shape in shapes), num_tiles
    for level, shape in enumerate(shapes):
        end, first = end - shape.count, first - shape.num_tiles
        nodes = []
        for number in range(shape.num_tiles):
            tile_splats = built.scene.splats.slice_range(
                end + int(shape.edges[number]), end + int(shape.edges[number + 1])
            )
            name = f"{CONTENTS}/{level}_{number}.glb"
            path = folder / name
            path.parent.mkdir(exist_ok=True)
            write_gltf([tile_splats], path, antialiased=scene.antialiased, metadata=credit)
            num_bytes += path.stat().st_size
            nodes.append(_node(tile_splats, ERROR_SCALE * float(built.errors[first + number]), name))
            written += 1
            report(0.5 + written / num_tiles / 2)
        _attach(nodes, below)
        below = nodes
    root = below[0] if len(below) == 1 else _root_of(below)
    geocentric = _EARTH_RADII[0] < math.hypot(*scene.origin) < _EARTH_RADII[1]
    if geocentric:
        root["transform"] = _placement(scene.origin)
    elif scene.origin != NO_ORIGIN:
        LOG.warning(
            "%s: the scene's origin (%s) has no known reference system; positions in the tileset are relative to it",
            folder, describe_origin(scene.origin).replace(" ", ", "),
        )  # fmt: skip
    document = _document(root, scene)
    data = json.dumps(document, separators=(",", ":")).encode()
    atomic_write(folder / TILESET, data)
    return TilesetReport(num_tiles, len(shapes), scene.num_elements, num_bytes + len(data), geocentric)


def explicit_scene(scene: Scene, holder: str) -> SplatScene:
    """Checks that a scene has explicit Gaussians, and removes invisible and invalid ones before the scene is written.

    Args:
        scene: The scene.
        holder: Subject and verb of the error message for scenes of anchors, such as "3D Tiles hold". The words
            "explicit Gaussians" follow.

    Raises:
        InvalidValueError: If there is no Gaussian, or the scene has anchors.
    """
    if not isinstance(scene, SplatScene):
        raise InvalidValueError(f"{holder} explicit Gaussians: `splatwire export ply` makes them of anchors")
    validity = scene.validity()
    validity.log_removed("writing levels", scene.ELEMENTS)
    if not validity.kept.any():
        raise InvalidValueError("there is no Gaussian that draws anything: there is nothing to write")
    if validity.all_drawable:
        return scene
    return SplatScene(
        scene.splats.gathered(validity.kept), background=scene.background, antialiased=scene.antialiased,
        origin=scene.origin, metadata=scene.metadata,
    )  # fmt: skip


def _document(root: dict[str, Any], scene: SplatScene) -> dict[str, Any]:
    box = np.array(root["boundingVolume"]["box"])
    size = 2 * float(np.linalg.norm(box[[3, 7, 11]]))
    return {
        "asset": {
            "version": "1.1",
            "generator": f"splatwire {__version__}",
            "extras": {
                **metadata_to_json(scene.metadata),
                **({} if scene.origin == NO_ORIGIN else {"origin": list(scene.origin)}),
            },
        },
        "geometricError": max(size, root["geometricError"]),
        "root": {"refine": "REPLACE", **root},
        "extensionsUsed": ["3DTILES_content_gltf"],
        "extensions": {"3DTILES_content_gltf": {"extensionsUsed": ["KHR_gaussian_splatting"]}},
    }


def _node(splats: Splats, error: float, name: str) -> dict[str, Any]:
    """Returns the JSON object of a tile of 3D Tiles.

    Args:
        splats: Gaussians of the tile.
        error: Geometric error of the tile, world units.
        name: File name of the tile's content.
    """
    reach = _REACH * splats.scales.max(axis=1, keepdims=True).astype(np.float64)
    centers = splats.means.astype(np.float64) @ _TO_TILES.T
    low, high = (centers - reach).min(axis=0), (centers + reach).max(axis=0)
    return {"boundingVolume": _box(low, high), "geometricError": error, "content": {"uri": name}}


def _attach(nodes: list[dict[str, Any]], finer: list[dict[str, Any]]) -> None:
    """Adds finer tiles of a 3D Tiles tileset as children of the coarser tiles that they replace in near views.

    Args:
        nodes: JSON objects of the coarser tiles, changed in place.
        finer: JSON objects of the finer tiles.
    """
    # 3D Tiles requires that a tile's box contains the boxes of its children, and that its geometric error is not
    # smaller than theirs.
    for node, parent_index in zip(finer, parents_of(len(finer), len(nodes)).tolist(), strict=True):
        parent = nodes[parent_index]
        parent.setdefault("children", []).append(node)
        parent["geometricError"] = max(parent["geometricError"], node["geometricError"])
        corners = [_corners(parent["boundingVolume"]["box"]), _corners(node["boundingVolume"]["box"])]
        parent["boundingVolume"] = _box(
            np.minimum(corners[0][0], corners[1][0]), np.maximum(corners[0][1], corners[1][1])
        )


def _root_of(nodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns a root tile without content that has the given tiles as children."""
    corners = [_corners(node["boundingVolume"]["box"]) for node in nodes]
    low, high = np.min([low for low, _ in corners], axis=0), np.max([high for _, high in corners], axis=0)
    error = max(float(np.linalg.norm(high - low)), *(node["geometricError"] for node in nodes))
    return {"boundingVolume": _box(low, high), "geometricError": error, "children": nodes}


def _box(low: np.ndarray, high: np.ndarray) -> dict[str, list[float]]:
    x, y, z = ((high - low) / 2).tolist()
    return {"box": [*((low + high) / 2).tolist(), x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z]}


def _corners(box: list[float]) -> tuple[np.ndarray, np.ndarray]:
    center, half = np.array(box[:3]), np.array([box[3], box[7], box[11]])
    return center - half, center + half


def _placement(origin: Origin) -> list[float]:
    """Returns the transform from the axes of the tiles to geocentric coordinates, 16 numbers, column by column."""
    matrix = np.eye(4)
    matrix[:3, :3] = _TO_TILES.T
    matrix[:3, 3] = origin
    return matrix.T.reshape(-1).tolist()
