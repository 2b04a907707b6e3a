"""What is up in a scene of which nobody says it."""

from dataclasses import replace

import numpy as np

from splatwire.model import SplatScene
from splatwire.model.appearance import Scene, explicit_gaussians
from splatwire.ops.arrays import lower_median
from splatwire.render.render import render_scene
from splatwire.scene import Cameras

SIDE = 96
"""Width and height of the pictures, pixels."""
MOST = 300_000
"""Gaussians that are drawn."""
AWAY = 8.0
"""Distance of the cameras, in radii of the scene."""
CERTAIN = 1.25
"""How many times as bright the other side has to be before it is taken for the upper one."""
FLAT = 0.25
"""A scene whose spread along y is less than this share of that along x and z is a ground with things on it."""


def up_of(scene: Scene) -> str:
    """Tells whether the y axis points up (`y`) or down (`-y`, as in files of Gaussians and in scenes of photos).

    Light falls from above, and photos are seldom taken from below: the upper side of a scene is the brighter one. Two
    pictures along the axis, from far away, are compared where something is. A ground was never seen from below: there
    the side counts on which more stands out of it. Of what looks different from everywhere (neural anchors) nothing
    is told.

    Args:
        scene: The scene.
    """
    splats = explicit_gaussians(scene)
    if splats is None or splats.num_gaussians == 0:
        return "-y"
    step = -(-splats.num_gaussians // MOST)
    few = splats.select(np.arange(0, splats.num_gaussians, step))
    splats = replace(few, scales=few.scales * step**0.5)  # each stands for as many
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
    """Mean luminance of what is seen along the y axis; 0 where nothing is."""
    pose = np.eye(4, dtype=np.float32)
    pose[:3, :3] = [[1.0, 0.0, 0.0], [0.0, 0.0, -down], [0.0, down, 0.0]]
    pose[:3, 3] = -pose[:3, :3] @ middle
    pose[2, 3] += AWAY * radius
    focal, half = SIDE * AWAY / 2.1, SIDE / 2
    lens = np.array([[[focal, 0.0, half], [0.0, focal, half], [0.0, 0.0, 1.0]]], np.float32)
    cameras = Cameras(pose[None], lens, SIDE, SIDE, ("up",))
    grey = (np.full(3, level, np.float32) for level in (0, 1))
    dark, light = (render_scene(scene, cameras, background=behind)[0] for behind in grey)
    there = 1 - (light - dark).mean(axis=2)
    seen = there > 0.5
    luminance = dark @ np.array([0.3, 0.6, 0.1], np.float32)
    return float((luminance[seen] / there[seen]).mean()) if bool(seen.any()) else 0.0
