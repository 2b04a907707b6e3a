"""Antialiasing of Gaussians smaller than a pixel (Mip-Splatting, Yu et al. 2024)."""

from dataclasses import replace

import numpy as np

from splatwire.anchors.projection import DILATION, project
from splatwire.ops.quaternions import rotation_matrices
from splatwire.types import Cameras, Gaussians

MIN_OPACITY_FACTOR = 1e-3
"""Minimum factor on the opacity, for very thin Gaussians."""


def compensated(gaussians: Gaussians, cameras: Cameras, view: int) -> Gaussians:
    """Returns Gaussians with reduced opacities, as antialiased rendering of a view requires.

    The renderer adds 0.3 square pixels to the projected covariance of each Gaussian, which enlarges its area. The
    opacity is divided by the growth factor of the area.

    Args:
        gaussians: The Gaussians of the view.
        cameras: The cameras.
        view: Index of the camera.
    """
    seen = project(gaussians.means, gaussians.scales, rotation_matrices(gaussians.quats), cameras, view)
    xx, xy, yy = seen.covs2d.T
    before, after = (xx - DILATION) * (yy - DILATION) - xy * xy, xx * yy - xy * xy
    share = np.maximum(np.sqrt(np.maximum(before, 0) / after), MIN_OPACITY_FACTOR)
    return replace(gaussians, opacities=gaussians.opacities * share)
