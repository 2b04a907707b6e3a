"""Writes copies of some Gaussians of a stream as a section of its side information."""

from dataclasses import replace

import numpy as np

from splatwire.codec.schemas.gaussians.blocks import block_codes, make_boxes, to_lattice
from splatwire.codec.schemas.gaussians.copies import write_head, write_places
from splatwire.codec.schemas.gaussians.encoder import encode_block
from splatwire.codec.schemas.gaussians.layout import MAX_CLASSES
from splatwire.codec.schemas.gaussians.side_info import SideInfo, write_blocks
from splatwire.codec.schemas.gaussians.source_scene import SourceScene
from splatwire.errors import InvalidValueError
from splatwire.scene.splats import Splats


def write_copies(
    splats: Splats, places: np.ndarray, info: SideInfo, *, level: int, growth: tuple[float, float, float]
) -> bytes:
    """Writes the section of copies, all of one class of precision, in the steps and contexts of the stream.

    Args:
        splats: All Gaussians of the stream, by place.
        places: int64, of which there are to be copies.
        info: The stream's side information.
        level: Their class of precision, 0 for the least.
        growth: See `Copies`.

    Raises:
        InvalidValueError: If there is no such class.
    """
    if not 0 <= level < MAX_CLASSES:
        raise InvalidValueError(f"there is no class of precision {level}: classes are 0 to {MAX_CLASSES - 1}")
    lattice = to_lattice(splats.means[places].astype(np.float64), info.unit, info.size_log)
    boxes, count = make_boxes(lattice.min(axis=0)[None], lattice.max(axis=0)[None], max(info.coarsest, 0)), len(places)
    order = np.argsort(block_codes(lattice - boxes.corners[0], int(boxes.bits[0])), kind="stable")
    places, classes = places[order], np.broadcast_to(np.uint8(level), splats.num_gaussians)
    scene = SourceScene(
        splats, splats.means, places, np.array([0, count]), classes, info.size_log, info.unit, info.bases,
        info.coarsest, True,
    )  # fmt: skip
    here = replace(info, boxes=boxes, defaults=np.clip([scene.means(0)], -511, 511))
    payload = encode_block(scene.arranged(0, here), here, 0, np.array([count]), 0).payloads[0]
    head = write_head(growth, count, write_blocks(boxes, here.defaults))
    return head + write_places(places, splats.num_gaussians) + payload
