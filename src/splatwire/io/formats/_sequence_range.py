"""Limits positions of the frames of a sequence to the range of a file format with one step for all positions."""

import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.io.formats.content import FileContent
from splatwire.io.formats.outliers import pull_into_box
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
_MAX_STEPS = 1 << 28
"""Largest coordinate in position steps; formats with 32-bit integers keep some bits for differences."""
_USUAL_SHARE, _ROOM = 0.99, 4.0
"""Share of the Gaussians that are never moved, and ratio of the largest permitted coordinate to theirs."""


def frames_in_range(
    path: Path, frames: Iterable[FileContent], share: float, max_step: float = math.inf
) -> Iterator[FileContent]:
    """Yields frames in which Gaussians beyond the range of a format are moved into it, and logs a warning about them.

    A moved Gaussian becomes smaller, so that it looks the same from the centre of the scene.

    Args:
        path: The file, for the message.
        frames: Frames, all relative to the same origin.
        share: Step of the format's positions divided by the median size of the Gaussians.
        max_step: Upper limit of the step, world units.
    """
    limit, middle, has_warned = math.inf, np.zeros(3), False
    for frame in frames:
        splats = frame.splats
        if limit == math.inf and splats.num_gaussians:
            middle = np.median(splats.means.astype(np.float64), axis=0)
            limit = _MAX_STEPS * position_step(splats, share, max_step)
        far = np.flatnonzero(np.abs(splats.means).max(axis=1, initial=0) > limit)
        if not len(far):
            yield frame
            continue
        if not has_warned:
            has_warned = True
            LOG.warning(
                "%s: %s of %s Gaussians are up to %.3g from the origin, beyond the range of this format, %.3g: they "
                "are moved to its end", path, f"{len(far):,}", f"{splats.num_gaussians:,}",
                float(np.abs(splats.means[far]).max()), limit,
            )  # fmt: skip
        bound = np.full(3, limit)
        yield replace(frame, splats=pull_into_box(splats, far, middle, -bound, bound))


def position_step(splats: Splats, share: float, max_step: float) -> float:
    """Returns the step of positions for a sequence: a share of the median size of the Gaussians.

    The step is so large that 32-bit integers can represent the positions of nearly all Gaussians.

    Args:
        splats: The Gaussians of the first frame, at least one.
        share: Step divided by the median of the largest standard deviation of each Gaussian.
        max_step: Upper limit of the share's result, world units.
    """
    step = min(share * float(np.median(splats.scales.max(axis=1))), max_step)
    distances = np.abs(splats.means).max(axis=1).astype(np.float64)
    return max(step, _ROOM * float(np.quantile(distances, _USUAL_SHARE)) / _MAX_STEPS, float(np.finfo(np.float32).tiny))
