"""Writer of streamed SOG (PlayCanvas, version 1): `lod-meta.json`, and SOG folders for the levels of detail.

Specification: developer.playcanvas.com/user-manual/gaussian-splatting/formats/streamed-sog.
"""

import itertools
import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.files.atomic_write import atomic_write
from splatwire.files.kinds import SOG_LEVELS_NAME, SOG_META_NAME
from splatwire.io.formats.dispatch import warn_of_background
from splatwire.io.formats.outliers import DEFAULT, morton_order
from splatwire.io.formats.sog_writer import sog_files, treat_outliers
from splatwire.lod.merging import reduce_gaussians
from splatwire.lod.tileset import explicit_scene
from splatwire.ops.kd_order import kd_order
from splatwire.types import Scene
from splatwire.types.origin import NO_ORIGIN, describe_origin
from splatwire.types.splats import Splats
from splatwire.version import __version__

LOG = logging.getLogger(__name__)
LEAF = 1 << 14
"""Maximum number of Gaussians of the finest level per leaf of the tree."""
LEAVES_PER_CHUNK = 16
"""Number of leaves that share a SOG folder for the Gaussians of one level."""
FACTOR = 4
"""Reduction of the number of Gaussians from level to level."""
_MAX_LEVELS = 6
_REACH = 3.0
"""Radius of a Gaussian for the bounding box of a leaf, standard deviations."""


@dataclass(frozen=True)
class SogLevelsReport:
    """Size of a streamed SOG data set that was written.

    Attributes:
        num_levels: Number of levels of detail.
        num_chunks: Number of SOG folders.
        num_gaussians: Number of Gaussians of the finest level.
        num_bytes: Bytes of all files.
    """

    num_levels: int
    num_chunks: int
    num_gaussians: int
    num_bytes: int


def write_sog_levels(
    scene: Scene, folder: Path, *, leaf: int = LEAF, progress: Callable[[float], None] | None = None
) -> SogLevelsReport:
    """Builds levels of detail of a scene and writes them as streamed SOG.

    Args:
        scene: Explicit Gaussians. Invisible and invalid ones are removed, and outliers are moved nearer.
        folder: Existing folder of the files.
        leaf: Maximum number of Gaussians per leaf of the k-d tree.
        progress: Called with the completed fraction, 0 to 1.

    Raises:
        InvalidValueError: If there is no Gaussian, or the scene has anchors.
    """
    scene = explicit_scene(scene, "streamed SOG holds")
    warn_of_background(folder, scene.background)
    if scene.origin != NO_ORIGIN:
        LOG.warning(
            "%s: positions are relative to the scene's origin (%s), which only splatwire reads from SOG",
            folder, describe_origin(scene.origin).replace(" ", ", "),
        )  # fmt: skip
    splats = treat_outliers(scene.splats, folder, DEFAULT)
    count = splats.num_gaussians
    edges = np.arange(-(-count // leaf) + 1) * count // -(-count // leaf)
    order = kd_order(splats.means, [edges.astype(np.int64)])
    num_levels = _num_levels(count, leaf)
    nodes, names, counts, num_bytes = list[dict[str, Any]](), list[str](), [0] * num_levels, 0
    num_leaves = len(edges) - 1
    for number, begin in enumerate(range(0, num_leaves, LEAVES_PER_CHUNK)):
        bounds = edges[begin : begin + LEAVES_PER_CHUNK + 1].tolist()
        leaves = [
            _levels_of(splats.select(order[first:last]), num_levels) for first, last in itertools.pairwise(bounds)
        ]
        files = [len(names) + level for level in range(num_levels)]
        nodes += _leaf_nodes(leaves, files)
        for level in range(num_levels):
            name = f"{level}_{number}"
            chunk = _joined([levels[level] for levels in leaves])
            num_bytes += _write_chunk(
                folder / name,
                sog_files(chunk, antialiased=scene.antialiased, origin=scene.origin, metadata=scene.metadata),
            )
            names.append(f"{name}/{SOG_META_NAME}")
            counts[level] += chunk.num_gaussians
        if progress:
            progress(min(begin + LEAVES_PER_CHUNK, num_leaves) / num_leaves)
    document = {
        "version": 1,
        "asset": {"generator": f"splatwire {__version__}"},  # metadata is in the chunks
        "count": sum(counts),
        "counts": counts,
        "lodLevels": num_levels,
        "filenames": names,
        "tree": _tree(nodes),
    }
    index = json.dumps(document, separators=(",", ":")).encode()
    atomic_write(folder / SOG_LEVELS_NAME, index)
    return SogLevelsReport(num_levels, len(names), count, num_bytes + len(index))


def _num_levels(count: int, leaf: int) -> int:
    """Returns how many levels of detail a scene needs.

    Args:
        count: Number of Gaussians of the scene.
        leaf: Maximum number of Gaussians per leaf of the k-d tree.
    """
    levels = 1
    while levels < _MAX_LEVELS and count > FACTOR and count * FACTOR > leaf:
        count, levels = -(-count // FACTOR), levels + 1
    return levels


def _levels_of(finest: Splats, num_levels: int) -> list[Splats]:
    """Builds the levels of detail for one leaf of the k-d tree, finest first."""
    levels = [finest]
    for _ in range(num_levels - 1):
        last = levels[-1]
        fewer = -(-last.num_gaussians // FACTOR)
        levels.append(last if fewer == last.num_gaussians else reduce_gaussians(last, fewer)[0])
    return [level.select(morton_order(level.means.astype(np.float64))) for level in levels]


def _leaf_nodes(leaves: list[list[Splats]], files: list[int]) -> list[dict[str, Any]]:
    """Builds the JSON object of each leaf of the k-d tree: its bounding box, and the place of each level's Gaussians.

    Args:
        leaves: For each leaf, the Gaussians of each level.
        files: For each level, index of the file that contains the Gaussians of all `leaves`, one leaf after another.
    """
    offsets, nodes = [0] * len(files), []
    for levels in leaves:
        lods = {}
        for level, part in enumerate(levels):
            lods[str(level)] = {"file": files[level], "offset": offsets[level], "count": part.num_gaussians}
            offsets[level] += part.num_gaussians
        low, high = np.min([_low(part) for part in levels], axis=0), np.max([_high(part) for part in levels], axis=0)
        nodes.append({"bound": {"min": low.tolist(), "max": high.tolist()}, "lods": lods})
    return nodes


def _low(splats: Splats) -> np.ndarray:
    return np.asarray((splats.means - _extents(splats)).min(axis=0), np.float64)


def _high(splats: Splats) -> np.ndarray:
    return np.asarray((splats.means + _extents(splats)).max(axis=0), np.float64)


def _extents(splats: Splats) -> np.ndarray:
    return np.asarray(_REACH * splats.scales.max(axis=1, keepdims=True), np.float64)


def _joined(parts: list[Splats]) -> Splats:
    return Splats(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])})


def _write_chunk(folder: Path, files: dict[str, bytes]) -> int:
    """Writes the files of one SOG data set to a new folder, and returns their total size in bytes."""
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return sum(map(len, files.values()))


def _tree(nodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Builds the binary tree of a streamed SOG from the JSON objects of the leaves, and returns the root."""
    if len(nodes) == 1:
        return nodes[0]
    children = [_tree(half) for half in (nodes[: len(nodes) // 2], nodes[len(nodes) // 2 :])]
    corners = {
        end: combine([child["bound"][end] for child in children], axis=0).tolist()
        for end, combine in (("min", np.min), ("max", np.max))
    }
    return {"bound": corners, "children": children}
