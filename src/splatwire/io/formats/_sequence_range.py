"""Limits positions of the frames of a sequence to the range of a file format with one step for all positions."""

import logging
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.io.formats.outliers import pull_into_box
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
_MAX_STEPS = 1 << 28
"""Largest coordinate in position steps. The formats have 32-bit integers, of which differences of two coordinates need
some bits more than coordinates do."""
_USUAL_SHARE, _ROOM = 0.99, 4.0
"""Share of the Gaussians that choose the step, and ratio of the largest permitted coordinate to theirs."""
_MIN_NEAR_SHARE = 0.5
"""Minimum share of the Gaussians within the range, weighted by duration; if fewer are, no Gaussian is moved."""


class PositionRange:
    """Range of positions in a file format with one step for all positions.

    Args:
        path: The file, for the warning about Gaussians beyond the range.
        splats: Gaussians of the first frame, or of all frames.
        step: Step of the positions in the file, world units.
        durations: Time that each Gaussian exists, (N), in any unit; None if all exist equally long.
    """

    def __init__(self, path: Path, splats: Splats, step: float, durations: np.ndarray | None = None) -> None:
        self._path, self._limit, self._warned = path, _MAX_STEPS * step, False
        near = _distances(splats) <= self._limit
        is_usual = near.any() and np.average(near, weights=durations) >= _MIN_NEAR_SHARE
        self._middle = np.median(splats.means[near].astype(np.float64), axis=0) if is_usual else None

    def limited(self, splats: Splats, min_scale: float = 0.0) -> Splats:
        """Moves the Gaussians beyond the range into it, and logs one warning about them.

        A moved Gaussian becomes smaller, so that it looks the same from the centre of the scene.

        Args:
            splats: Gaussians of one frame, or of all frames.
            min_scale: Standard deviation below which moved Gaussians are not made smaller.
        """
        far = np.flatnonzero(_distances(splats) > self._limit)
        if self._middle is None or not len(far):
            return splats
        if not self._warned:
            self._warned = True
            LOG.warning(
                "%s: %s of %s Gaussians are up to %.3g from the origin, beyond the range of this format, %.3g: they "
                "are moved to its end", self._path, f"{len(far):,}", f"{splats.num_gaussians:,}",
                float(_distances(splats).max()), self._limit,
            )  # fmt: skip
        bound = np.full(3, self._limit)
        moved = pull_into_box(splats, far, self._middle, -bound, bound)
        return replace(moved, scales=np.maximum(moved.scales, np.minimum(splats.scales, np.float32(min_scale))))


def position_step(splats: Splats, share: float, max_step: float) -> float:
    """Returns the step of positions for a sequence: a share of the median size of the Gaussians.

    In large scenes the step is larger, so that 32-bit integers can represent the positions of nearly all Gaussians.

    Args:
        splats: The Gaussians of the first frame, at least one.
        share: Step divided by the median of the largest standard deviation of each Gaussian.
        max_step: Maximum step in scenes that are not large, world units.
    """
    step = min(share * float(np.median(splats.scales.max(axis=1))), max_step)
    usual = float(np.quantile(_distances(splats), _USUAL_SHARE, method="lower"))
    return max(step, _ROOM * usual / _MAX_STEPS, float(np.finfo(np.float32).tiny))


def warn_of_large_step(path: Path, splats: Splats, share: float, step: float) -> None:
    """Logs a warning if the step of positions is larger than a share of the median size of the Gaussians.

    Args:
        path: The file.
        splats: The Gaussians of the first frame, at least one.
        share: Step divided by the median size up to which rounding is invisible.
        step: The step, world units.
    """
    size = float(np.median(splats.scales.max(axis=1)))
    if step > share * size and not math.isclose(step, share * size):
        LOG.warning(
            "%s: positions are rounded to steps of %.3g, the median size of Gaussians is %.3g: some Gaussians are up "
            "to %.3g from the origin", path, step, size, float(_distances(splats).max()),
        )  # fmt: skip


def _distances(splats: Splats) -> np.ndarray:
    """Returns the largest absolute coordinate of each Gaussian, float64 (N)."""
    return np.asarray(np.abs(splats.means).max(axis=1, initial=0).astype(np.float64))
