"""Gaussians smaller than a pixel, of scenes that were trained for it (Mip-Splatting, Yu et al. 2024)."""

from dataclasses import replace

import numpy as np

from splatwire.model.projection import DILATION, project
from splatwire.ops.quaternions import rotation_matrices
from splatwire.scene import Cameras, Gaussians

LEAST = 1e-3
"""Share of its opacity that a Gaussian keeps, however thin it is."""


def compensated(gaussians: Gaussians, cameras: Cameras, view: int) -> Gaussians:
    """Makes Gaussians as much fainter as they become larger where the picture adds 0.3 square pixels to them.

    Args:
        gaussians: The Gaussians of the view.
        cameras: The cameras.
        view: Which of them.
    """
    seen = project(gaussians.means, gaussians.scales, rotation_matrices(gaussians.quats), cameras, view)
    xx, xy, yy = seen.covs2d.T
    before, after = (xx - DILATION) * (yy - DILATION) - xy * xy, xx * yy - xy * xy
    share = np.maximum(np.sqrt(np.maximum(before, 0) / after), LEAST)
    return replace(gaussians, opacities=gaussians.opacities * share)
