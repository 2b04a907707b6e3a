"""Node hierarchy of a glTF: the meshes of its scene and their transforms."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.errors import DatasetError
from splatwire.ops.quaternions import rotation_matrices

LOG = logging.getLogger(__name__)
MAX_INSTANCES = 1 << 14
"""Maximum number of mesh instances of a scene."""
_PARTS = ("translation", "rotation", "scale")
"""Names of the parts of a transform that a node may state instead of a matrix."""
_INSTANCING = "EXT_mesh_gpu_instancing"
VISIBILITY = "KHR_node_visibility"


@dataclass(frozen=True, eq=False)
class Instance:
    """A mesh of a glTF document, placed in the scene by the transform of a node.

    Attributes:
        mesh: Index of the mesh.
        matrix: Transform from the mesh to the world in the axes of the file, float64 (4, 4).
        node: Index of the node; None if the document has no nodes.
    """

    mesh: int
    matrix: np.ndarray
    node: int | None


def shown_instances(path: Path, document: dict[str, Any]) -> list[Instance]:
    """Returns the mesh instances of the document's scene, in traversal order of the node tree.

    If the document has no nodes, each mesh is returned once, without a transform.

    Raises:
        DatasetError: If nodes are not a tree, or a transform is invalid.
    """
    nodes = document.get("nodes", [])
    if not nodes:
        return [Instance(mesh, np.eye(4), None) for mesh in range(len(document.get("meshes", [])))]
    waiting = [(root, np.eye(4)) for root in reversed(_roots(path, document, nodes))]
    seen: set[int] = set()
    hidden: list[int] = []
    mixed: dict[int, list[str]] = {}
    instances: list[Instance] = []
    while waiting:
        index, above = waiting.pop()
        node = entry(path, nodes, index, "node")
        if index in seen:
            raise DatasetError(f"{path}: node {index} has two parents, or is below itself")
        seen.add(index)
        if node.get("extensions", {}).get(VISIBILITY, {}).get("visible") is False:
            hidden.append(index)
            continue
        if "matrix" in node and (ignored := [name for name in _PARTS if name in node]):
            mixed[index] = ignored
        matrix = above @ _local(path, index, node)
        if "mesh" in node:
            if _INSTANCING in node.get("extensions", {}):
                raise DatasetError(f"{path}: node {index} repeats its mesh by {_INSTANCING}, which is not read")
            entry(path, document.get("meshes", []), node["mesh"], "mesh")
            instances.append(Instance(node["mesh"], matrix, index))
        waiting += [(child, matrix) for child in reversed(node.get("children", []))]
    if hidden:
        LOG.warning(
            "%s: %s and those below it are hidden by %s and left out", path, described_nodes(hidden), VISIBILITY
        )
    if mixed:
        LOG.warning(
            "%s: %s has a matrix and also %s, which glTF does not allow: only the matrix is applied",
            path, described_nodes(list(mixed)), ", ".join(next(iter(mixed.values()))),
        )  # fmt: skip
    if len(instances) > MAX_INSTANCES:
        raise DatasetError(f"{path}: its nodes show {len(instances):,} meshes, at most {MAX_INSTANCES:,} are read")
    return instances


def described_nodes(indices: Sequence[int | None]) -> str:
    """Returns the first of several nodes and the number of the others, for a message.

    Args:
        indices: Indices of at least one node.
    """
    others = f" (and {len(indices) - 1:,} more)" if len(indices) > 1 else ""
    return f"node {indices[0]}{others}"


def entry(path: Path, items: list[Any], index: Any, subject: str) -> Any:
    """Returns an entry of a list of the glTF document after checking its index.

    Args:
        path: The file, for messages.
        items: The list.
        index: Index according to the document; may have any type.
        subject: Name of the entries, such as `mesh`, for messages.

    Raises:
        DatasetError: If the entry does not exist.
    """
    if type(index) is not int or not 0 <= index < len(items):
        raise DatasetError(f"{path}: the glTF document is damaged: there is no {subject} {index!r:.40}")
    return items[index]


def _roots(path: Path, document: dict[str, Any], nodes: list[Any]) -> list[int]:
    """Returns the indices of the root nodes of the scene.

    If the document has no scene, these are all nodes without a parent.
    """
    scenes = document.get("scenes", [])
    if scenes:
        return list(entry(path, scenes, document.get("scene", 0), "scene").get("nodes", []))
    children = {child for node in nodes for child in node.get("children", [])}
    return [index for index in range(len(nodes)) if index not in children]


def _local(path: Path, index: int, node: dict[str, Any]) -> np.ndarray:
    """Returns the matrix of a node relative to its parent, float64 (4, 4)."""
    if "matrix" in node:
        matrix = _numbers(path, index, node, "matrix", 16, None).reshape(4, 4).T
        if not np.array_equal(matrix[3], (0, 0, 0, 1)):
            raise DatasetError(f"{path}: the matrix of node {index} is no affine map")
        return matrix
    matrix = np.eye(4)
    turn = np.roll(_numbers(path, index, node, "rotation", 4, (0.0, 0.0, 0.0, 1.0)), 1)
    length = np.linalg.norm(turn)
    if length < 1e-6:
        raise DatasetError(f"{path}: the rotation of node {index} has length 0")
    scale = _numbers(path, index, node, "scale", 3, (1.0, 1.0, 1.0))
    matrix[:3, :3] = rotation_matrices(turn[None] / length)[0] * scale
    matrix[:3, 3] = _numbers(path, index, node, "translation", 3, (0.0, 0.0, 0.0))
    return matrix


def _numbers(
    path: Path, index: int, node: dict[str, Any], name: str, count: int, absent: tuple[float, ...] | None
) -> np.ndarray:
    try:
        numbers = np.array(node.get(name, absent), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty(0)
    if numbers.shape != (count,) or not (np.abs(numbers) < 1e30).all():
        raise DatasetError(f"{path}: the {name} of node {index} is not {count} numbers")
    return numbers
