"""Encodes redundant copies of important Gaussians as a section of the side information."""

from dataclasses import replace

import numpy as np

from splatwire.codec.gaussians.blocks import block_codes, make_boxes, to_lattice
from splatwire.codec.gaussians.copies import write_copies_header, write_indices
from splatwire.codec.gaussians.encoder import encode_block
from splatwire.codec.gaussians.layout import MAX_CLASSES
from splatwire.codec.gaussians.side_info import MAX_MEAN, SideInfo, write_blocks
from splatwire.codec.gaussians.source_scene import SourceScene
from splatwire.errors import InvalidValueError
from splatwire.types.splats import Splats


def write_copies(
    splats: Splats, indices: np.ndarray, info: SideInfo, *, precision_class: int, growth: tuple[float, float, float]
) -> bytes:
    """Encodes redundant copies of Gaussians, with the stream's quantisation steps and probability tables.

    Args:
        splats: All Gaussians of the stream, in the order of the decoded scene.
        indices: int64, indices in `splats` of the Gaussians to copy.
        info: The stream's side information.
        precision_class: Precision class of all copies (their set of quantisation steps), 0 for the coarsest.
        growth: Parameters for enlarging received Gaussians next to lost ones, see `Copies.growth`.

    Returns:
        Content of the section `sketch` of the side information, which contains the copies.

    Raises:
        InvalidValueError: If the precision class does not exist.
    """
    if not 0 <= precision_class < MAX_CLASSES:
        raise InvalidValueError(f"there is no class of precision {precision_class}: classes are 0 to {MAX_CLASSES - 1}")
    lattice = to_lattice(splats.means[indices].astype(np.float64), info.lattice_bits, info.size_log)
    boxes, count = (
        make_boxes(lattice.min(axis=0)[None], lattice.max(axis=0)[None], max(info.max_position_shift, 0)),
        len(indices),
    )
    order = np.argsort(block_codes(lattice - boxes.corners[0], int(boxes.bits[0])), kind="stable")
    indices, precision_classes = indices[order], np.broadcast_to(np.uint8(precision_class), splats.num_gaussians)
    scene = SourceScene(
        splats, splats.means, indices.astype(np.uint32), np.array([0, count]), precision_classes, info.size_log,
        info.lattice_bits, info.base_exponents, info.max_position_shift, True,
    )  # fmt: skip
    copies_info = replace(info, boxes=boxes, block_means=np.clip([scene.summary(0)[1]], -MAX_MEAN, MAX_MEAN))
    payload = encode_block(scene.block_source(0, copies_info), copies_info, 0, np.array([count]), 0).payloads[0]
    header = write_copies_header(growth, count, write_blocks(boxes, copies_info.block_means))
    return header + write_indices(indices, splats.num_gaussians) + payload
