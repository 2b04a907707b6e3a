"""Anchors of other programs: those that can be drawn, on the grid that they stand on."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.formats.ply_file import PlyElement
from splatwire.importers._hacpp_files import infer_voxel_size, load_voxel_size
from splatwire.model.voxels import voxel_indices, voxel_positions
from splatwire.scene import Anchors
from splatwire.scene.rows import rows_of_anchors


def offsets_of(vertices: PlyElement, num_offsets: int) -> np.ndarray:
    """Offsets (N, K, 3), which files have coordinate-major: all x, all y, all z."""
    return vertices.columns("f_offset_", 3 * num_offsets).reshape(-1, 3, num_offsets).transpose(0, 2, 1)


def anchors_on_grid(
    vertices: PlyElement, feature_dim: int, scalings: np.ndarray, offsets: np.ndarray, mask: np.ndarray, model_dir: Path
) -> tuple[Anchors, float]:
    """The anchors of a file that can be drawn, and the size of the voxels on whose corners they stand.

    Args:
        vertices: Rows of the file, N of them.
        feature_dim: Numbers of a feature.
        scalings: (N, 6), decoded.
        offsets: (N, K, 3).
        mask: (N, K): which offsets draw something.
        model_dir: Where the model may say how large its voxels are.

    Raises:
        DatasetError: If none can be drawn, or they do not stand on a grid.
    """
    anchors = Anchors(
        positions=vertices.select(["x", "y", "z"]),
        features=vertices.columns("f_anchor_feat_", feature_dim),
        scalings=scalings,
        offsets=np.ascontiguousarray(offsets),
        mask=mask,
    )
    anchors = drawable_anchors(anchors, vertices.path)
    found = load_voxel_size(model_dir)
    voxel_size, source = found or (infer_voxel_size(anchors.positions), None)
    try:
        positions = voxel_positions(voxel_indices(anchors.positions, voxel_size), voxel_size)
    except InvalidValueError as error:
        origin = f"the voxel size comes from {source}" if source else "the voxel size was inferred"
        raise DatasetError(f"{vertices.path}: {error} ({origin})") from error
    return replace(anchors, positions=positions), voxel_size


def drawable_anchors(anchors: Anchors, path: Path) -> Anchors:
    """Leaves out anchors that draw nothing or cannot be drawn, which is logged (`splatwire.scene.rows`).

    Args:
        anchors: The anchors, a row for each of the file's.
        path: The file, for messages.

    Raises:
        DatasetError: If none is left.
    """
    rows = rows_of_anchors(anchors)
    rows.tell(path, "anchors")
    if not bool(rows.kept.any()):
        found = f"{rows.num_invisible:,} have no offset, {rows.num_invalid:,} cannot be drawn"
        raise DatasetError(f"{path}: none of its {anchors.num_anchors:,} anchors is left: {found}")
    return anchors if rows.complete else anchors.select(rows.kept)
