"""Estimate of the up axis of a scene without metadata."""

from dataclasses import replace

import numpy as np

from splatwire.anchors.appearance import explicit_gaussians
from splatwire.ops.arrays import lower_median
from splatwire.render.render import render_scene
from splatwire.types import Cameras, SplatScene
from splatwire.types.cameras import NEAR_DEPTH
from splatwire.types.scene import Scene

SIDE = 96
"""Width and height of the rendered images, pixels."""
MAX_GAUSSIANS = 100_000
"""Maximum number of Gaussians that are rendered for the estimate."""
AWAY = 8.0
"""Distance of the cameras from the scene's centre, in multiples of the scene's radius."""
CERTAIN = 1.25
"""Minimum ratio of the brightness of both sides for which the y axis is taken as up."""
FLAT = 0.25
"""Maximum ratio of the scene's extent along y to that along x and z for the scene to count as a ground plane with
objects."""


def estimate_up_axis(scene: Scene) -> str:
    """Estimates the up axis of a scene: `y`, or `-y` as in 3DGS files and scenes from photos.

    Returns `-y` for neural anchors and for uncertain cases.

    Args:
        scene: The scene.
    """
    # Light comes from above, and photos are seldom taken from below, so the upper side of a scene is brighter. The
    # scene is rendered from far away along the y axis, from both sides, and the mean brightness of the two images
    # is compared. A flat scene (a ground with objects) is an exception, because no photo shows the ground from
    # below. There, up is the side on which Gaussians reach farther from the ground.
    splats = explicit_gaussians(scene)
    if splats is None or splats.num_gaussians == 0:
        return "-y"
    step = -(-splats.num_gaussians // MAX_GAUSSIANS)
    few = splats.select(np.arange(0, splats.num_gaussians, step))
    splats = replace(few, scales=few.scales * step**0.5)  # compensates for the reduced number
    middle = lower_median(splats.means)
    away = np.linalg.norm(splats.means - middle, axis=1)
    radius = min(float(np.sort(away)[-(-len(away) * 98 // 100) - 1]), 4 * float(lower_median(away)))
    if not radius > 0:
        return "-y"
    across, height, along = splats.means.std(axis=0).tolist()
    if height < FLAT * min(across, along):
        low, ground, high = np.quantile(splats.means[:, 1], [0.02, 0.5, 0.98]).tolist()
        return "y" if high - ground > CERTAIN * (ground - low) else "-y"
    above, below = (_brightness(SplatScene(splats), middle, radius, down) for down in (1.0, -1.0))
    return "y" if below > CERTAIN * above > 0 else "-y"


def _brightness(scene: Scene, middle: np.ndarray, radius: float, down: float) -> float:
    """Returns the mean luminance of a scene seen along the y axis.

    Args:
        scene: The scene.
        middle: Centre of the scene.
        radius: Radius of the scene, world units.
        down: Viewing direction along the y axis, 1 or -1.
    """
    pose = np.eye(4, dtype=np.float32)
    pose[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, -down], [0.0, down, 0.0]]
    pose[:3, 3] = -pose[:3, :3] @ middle
    pose[2, 3] += AWAY * radius
    focal, half = SIDE * AWAY / 2.1, SIDE / 2
    lens = np.array([[[focal, 0.0, half], [0.0, focal, half], [0.0, 0.0, 1.0]]], np.float32)
    cameras = Cameras(pose[None], lens, SIDE, SIDE, ("up",), near_depth=min(NEAR_DEPTH, radius))
    grey = (np.full(3, level, np.float32) for level in (0, 1))
    dark, light = (render_scene(scene, cameras, background=behind)[0] for behind in grey)
    coverage = 1 - (light - dark).mean(axis=2)
    seen = coverage > 0.5
    luminance = dark @ np.array([0.3, 0.6, 0.1], np.float32)
    return float((luminance[seen] / coverage[seen]).mean()) if bool(seen.any()) else 0.0
