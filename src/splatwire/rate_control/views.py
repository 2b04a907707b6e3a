"""Choice of views for an encoder with a target size or PSNR."""

import functools
import math
import statistics
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64

from splatwire.anchors.appearance import origin_of
from splatwire.evaluation.views import HELD_OUT_SIZE, held_out_cameras, spread
from splatwire.files.mmap_array import large_empty
from splatwire.metrics.psnr import psnr
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import MEASURED_VIEWS
from splatwire.types import Cameras
from splatwire.types.scene import Scene

SEARCH_VIEWS, SEARCH_SIZE = 6, 256
"""Number and size in pixels of views around a scene for comparing pruned and decoded scenes. The poses depend
on the number, and differ from those of `held_out_cameras` and `measure_gaussians`."""
MAX_VIEWS, MAX_SIZE = MEASURED_VIEWS, HELD_OUT_SIZE
"""Maximum number of given cameras in each set, and maximum width and height of their images in pixels."""
MIN_CAMERAS = 6
"""Minimum number of given cameras that are divided into the three sets."""
_HELD_OUT = 2
"""Index of the first held-out camera among given cameras. From there on, every third camera is held out."""


@dataclass(frozen=True, eq=False)
class ViewSets:
    """Three disjoint sets of views of a scene, used by an encoder that aims at a target size or PSNR.

    Attributes:
        measured: Views for measuring the effect of each Gaussian; None for views around the scene.
        search: Views for comparing encoded scenes with the source while the quantisation is chosen.
        held_out: Views for the reported PSNR.
    """

    measured: Cameras | None
    search: Cameras
    held_out: Cameras

    @staticmethod
    def of(scene: Scene, cameras: Cameras | None = None) -> "ViewSets":
        """Chooses views for measuring Gaussians, for comparing streams with different settings, and for the final PSNR.

        Args:
            scene: The scene.
            cameras: Cameras at typical viewing positions; None for views around the scene.
        """
        # Cameras are divided evenly among the three sets. If there are fewer than `MIN_CAMERAS`, they are
        # only used to measure Gaussians.
        if cameras is None or cameras.num_views < MIN_CAMERAS:
            return ViewSets(
                None if cameras is None else cameras.relative_to(origin_of(scene)),
                surrounding_cameras(scene, SEARCH_VIEWS, SEARCH_SIZE),
                held_out_cameras(scene),
            )
        cameras = cameras.relative_to(origin_of(scene))
        thirds = [list(range(first, cameras.num_views, 3)) for first in (0, 1, _HELD_OUT)]
        measured, search, held_out = (
            _subset(cameras, views, most)
            for views, most in zip(thirds, (MAX_VIEWS, SEARCH_VIEWS, MAX_VIEWS), strict=True)
        )
        return ViewSets(measured, search, held_out)


def not_held_out(cameras: Cameras, count: int) -> Cameras:
    """Selects evenly spread cameras for fine-tuning.

    Cameras that are reserved for the reported PSNR are not selected.

    Args:
        cameras: At least `MIN_CAMERAS` cameras.
        count: Maximum number of cameras to return.
    """
    # `ViewSets.of` reserves a third of the cameras.
    views = [view for view in range(cameras.num_views) if view % 3 != _HELD_OUT]
    return cameras.select([views[index] for index in spread(len(views), count)])


def _subset(cameras: Cameras, views: list[int], count: int) -> Cameras:
    """Selects at most `count` of the given views, evenly spread, and reduces the size of large images.

    Args:
        cameras: All cameras.
        views: Indices of the views to choose from.
        count: Maximum number of views.
    """
    # Images with a side of more than `MAX_SIZE` pixels are scaled down to this size.
    chosen = cameras.select([views[index] for index in spread(len(views), count)])
    return chosen.scaled(min(1.0, MAX_SIZE / max(chosen.width, chosen.height)))


@dataclass(frozen=True, eq=False)
class SourcePictures:
    """Renderings of the original scene, as references for the PSNR of encoded scenes.

    Attributes:
        scene: The original scene.
        cameras: The views.
    """

    scene: Scene
    cameras: Cameras

    @functools.cached_property
    def images(self) -> Float[np.ndarray, "V H W 3"]:
        """The renderings, RGB in [0, 1]."""
        images = large_empty((self.cameras.num_views, self.cameras.height, self.cameras.width, 3), np.float32)
        for image, drawn in zip(images, iterate_views(self.scene, self.cameras), strict=True):
            image[:] = drawn
        return images

    def mean_psnr(self, scene: Scene) -> float:
        """Returns the mean PSNR of a scene over all views, decibels; infinite if no view differs."""
        # Views without any difference are left out.
        finite = [value for value in self.psnr(scene).tolist() if math.isfinite(value)]
        return statistics.fmean(finite) if finite else math.inf

    def psnr(self, scene: Scene) -> Float64[np.ndarray, "V"]:
        """Returns the PSNR of a scene in each view, decibels; infinite for views without any difference."""
        pairs = zip(iterate_views(scene, self.cameras), self.images, strict=True)
        return np.array([psnr(ours[None], theirs[None])[0] for ours, theirs in pairs], np.float64)
