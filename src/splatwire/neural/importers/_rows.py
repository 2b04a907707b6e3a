"""Conversion of imported anchors: removes anchors that cannot be rendered and snaps positions to the voxel grid."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.anchors.voxels import voxel_indices, voxel_positions
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.io.formats.ply_file import PlyElement
from splatwire.neural.importers._hacpp_files import infer_voxel_size, load_voxel_size
from splatwire.types import Anchors
from splatwire.types.validity import validity_of_anchors


def offsets_of(vertices: PlyElement, num_offsets: int) -> np.ndarray:
    """Returns the offsets of the anchors of a PLY file, (N, K, 3)."""
    # The file stores the offsets of an anchor coordinate-major: all x, then all y, then all z.
    return vertices.columns("f_offset_", 3 * num_offsets).reshape(-1, 3, num_offsets).transpose(0, 2, 1)


def anchors_on_grid(
    vertices: PlyElement, feature_dim: int, scalings: np.ndarray, offsets: np.ndarray, mask: np.ndarray, model_dir: Path
) -> tuple[Anchors, float]:
    """Builds the renderable anchors of a PLY file, and rounds their positions to multiples of the voxel size.

    Args:
        vertices: The N vertices of the PLY file, one per anchor.
        feature_dim: Number of channels of an anchor feature.
        scalings: Linear scalings, (N, 6).
        offsets: Offsets, (N, K, 3).
        mask: Mask of the offsets that exist, bool (N, K).
        model_dir: Model folder; searched for the voxel size, which is otherwise inferred from the positions.

    Returns:
        The anchors, and the voxel size in world units.

    Raises:
        DatasetError: If no anchor can be rendered, the positions are not multiples of the voxel size, or they are too
            far from 0 for float32.
    """
    anchors = Anchors(
        positions=vertices.select(["x", "y", "z"]),
        features=vertices.columns("f_anchor_feat_", feature_dim),
        scalings=scalings,
        offsets=np.ascontiguousarray(offsets),
        mask=mask,
    )
    anchors = drawable_anchors(anchors, vertices.path)
    stored_size = load_voxel_size(model_dir)
    voxel_size, source = stored_size or (infer_voxel_size(anchors.positions), None)
    try:
        positions = voxel_positions(voxel_indices(anchors.positions, voxel_size), voxel_size)
    except InvalidValueError as error:
        _check_not_far(anchors.positions, voxel_size, vertices.path)
        origin = f"the voxel size comes from {source}" if source else "the voxel size was inferred"
        raise DatasetError(f"{vertices.path}: {error} ({origin})") from error
    return replace(anchors, positions=positions), voxel_size


def _check_not_far(positions: np.ndarray, voxel_size: float, path: Path) -> None:
    """Checks that float32 distinguishes neighbouring voxels at the positions of anchors.

    Args:
        positions: World coordinates, float32 (N, 3).
        voxel_size: World units per voxel.
        path: Path of the file, for messages.

    Raises:
        DatasetError: If the step of float32 at the median position exceeds a quarter of the voxel size, as in map
            coordinates (UTM, ECEF).
    """
    middle = np.median(positions, axis=0)
    step = float(np.spacing(np.abs(middle).max()))
    if step > voxel_size / 4:
        raise DatasetError(
            f"{path}: the anchors are around ({', '.join(f'{value:.6g}' for value in middle.tolist())}), where the "
            f"program that trained the model rounded positions to float32, here steps of {step:.2g} for voxels of "
            f"{voxel_size:.2g}: subtract a point near them from cameras and points and train again, or use `splatwire "
            "train`, which keeps an origin"
        )


def drawable_anchors(anchors: Anchors, path: Path) -> Anchors:
    """Removes anchors that cannot be rendered: those without offsets, and those with invalid values.

    Args:
        anchors: The anchors, in the order of the file.
        path: Path of the file, for messages.

    Raises:
        DatasetError: If no anchor is left.
    """
    validity = validity_of_anchors(anchors)
    validity.log_removed(path, "anchors")
    if not bool(validity.kept.any()):
        counts = f"{validity.num_invisible:,} have no offset, {validity.num_invalid:,} cannot be drawn"
        raise DatasetError(f"{path}: none of its {anchors.num_anchors:,} anchors is left: {counts}")
    return anchors if validity.all_drawable else anchors.select(validity.kept)
