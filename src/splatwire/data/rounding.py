"""Conversion of cameras to world coordinates, which the training of anchors needs."""

import logging
from pathlib import Path

import numpy as np

from splatwire.types import Cameras
from splatwire.types.origin import NO_ORIGIN, describe_origin

LOG = logging.getLogger(__name__)


def without_origin(source: Path, cameras: Cameras) -> Cameras:
    """Converts cameras whose positions are relative to an origin to world coordinates.

    The training of anchors needs world coordinates. Logs a warning if the cameras had an origin, because float32 rounds
    world coordinates far from 0 noticeably.

    Args:
        source: Source folder or file, for the message.
        cameras: The cameras.
    """
    if cameras.origin != NO_ORIGIN:
        step = float(np.spacing(np.float32(np.abs(cameras.origin).max())))
        LOG.warning(
            "%s: cameras are around (%s), and scenes of anchors have no origin, so that positions are rounded to "
            "float32, here steps of %.2g: train explicit Gaussians (`--model gaussians`), or subtract this point from "
            "cameras and points, for example with COLMAP's `model_transformer`",
            source, describe_origin(cameras.origin), step,
        )  # fmt: skip
    return cameras.relative_to(NO_ORIGIN)
