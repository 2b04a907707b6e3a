"""What a view sees of a scene, whatever its elements are: the one place above the codec that asks for their kind."""

from typing import TypeAlias

import torch

from splatwire.model.anchor_scene import AnchorScene, PartialScene
from splatwire.model.compiled_heads import drawn_gaussians
from splatwire.model.gaussian_heads import SpawnedGaussians, spawn_gaussians, visible_anchors
from splatwire.model.splat_scene import PartialSplats, SplatScene
from splatwire.scene import Cameras, Gaussians
from splatwire.scene.splats import Splats

Scene: TypeAlias = AnchorScene | SplatScene
"""What can be drawn."""
Partial: TypeAlias = PartialScene | PartialSplats
"""What a decoder returns: a scene of which some elements may be lost."""


def scene_of(loaded: Scene | Partial) -> Scene:
    """The scene itself, whatever is known of its gaps."""
    return loaded.scene if isinstance(loaded, PartialScene | PartialSplats) else loaded


def gaussians_of_view(scene: Scene, cameras: Cameras, view: int) -> Gaussians:
    """What camera `view` sees of a scene, as its hints say; for drawing, without gradients."""
    if isinstance(scene, SplatScene):
        splats = scene.drawn()
        return splats.seen_from(cameras.centers[view].to(splats.means))
    return drawn_gaussians(scene, cameras, view)


def spawned_gaussians(scene: Scene, cameras: Cameras, view: int) -> SpawnedGaussians:
    """What camera `view` sees of a complete scene, each Gaussian with its element; differentiable, without hints."""
    center = cameras.centers[view].to(scene.positions)
    if isinstance(scene, SplatScene):
        own = torch.arange(scene.num_elements)
        return SpawnedGaussians(scene.splats.seen_from(center), own, torch.zeros_like(own))
    visible = visible_anchors(scene.anchors, cameras, view) & scene.anchors.mask.any(dim=1)
    return spawn_gaussians(scene.anchors, scene.heads, center, visible)


def explicit_gaussians(scene: Scene) -> Splats | None:
    """The Gaussians, as the hints say, if every view sees the same ones; None if they depend on the view."""
    return scene.drawn() if isinstance(scene, SplatScene) else None
