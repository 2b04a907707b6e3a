"""From anchors to the Gaussians of one view (HAC++, decoding of a view), in torch and differentiable."""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.model.anchor_scene import AnchorScene, GaussianHeads
from splatwire.model.compiled_heads import SpawnedGaussians
from splatwire.model.tensor_projection import project_tensors
from splatwire.model.tensors import to_tensors
from splatwire.scene import Anchors, Cameras, Gaussians


def generate_gaussians(scene: AnchorScene, cameras: Cameras, view: int) -> Gaussians:
    """Generates what camera `view` sees of `scene`; a pure, differentiable function.

    Args:
        scene: The scene. Its hints, if any, leave anchors out and change size and opacity of Gaussians, never where
            they are.
        cameras: The cameras.
        view: Which of them.

    Returns:
        The Gaussians with positive opacity of all anchors in view, anchor by anchor.
    """
    return generate_spawned(scene, cameras, view).gaussians


def generate_spawned(scene: AnchorScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    """The same as `generate_gaussians`, each Gaussian with its anchor."""
    scene = to_tensors(scene)
    visible = visible_anchors(scene.anchors, cameras, view) & scene.anchors.mask.any(dim=1)
    size_gain: Any = None
    opacity_gain: Any = None
    hints: Any = scene.hints
    if hints is not None:
        visible, size_gain, opacity_gain = visible & ~hints.left_out, hints.size_gain, hints.opacity_gain
    center = torch.as_tensor(cameras.centers[view]).to(scene.anchors.positions)
    return spawn_gaussians(scene.anchors, scene.heads, center, visible, size_gain=size_gain, opacity_gain=opacity_gain)


@torch.no_grad()
def visible_anchors(anchors: Anchors, cameras: Cameras, view: int) -> Bool[Tensor, "N"]:
    """Tells which anchors camera `view` may see: HAC++'s pre-filter.

    An anchor is projected as a Gaussian of its first three scalings, unrotated; it is kept when it is deeper than 0.2
    and its square of three standard deviations meets a tile of the image.
    """
    projected = project_tensors(anchors.positions, anchors.scalings[:, :3], None, cameras, view)
    return projected.touches_image(cameras.width, cameras.height)


def spawn_gaussians(
    anchors: Anchors,
    heads: GaussianHeads,
    camera_center: Float[Tensor, "3"],
    visible: Bool[Tensor, "N"],
    *,
    size_gain: Float[Tensor, "N"] | None = None,
    opacity_gain: Float[Tensor, "N"] | None = None,
    mask_weight: Float[Tensor, "N K"] | None = None,
) -> SpawnedGaussians:
    """Runs the heads on the visible anchors (HAC++, decoding of a view); differentiable.

    Args:
        anchors: All anchors.
        heads: The networks.
        camera_center: Where the camera is, world units.
        visible: Which anchors to draw; must lie away from the camera centre.
        size_gain: Factor on the Gaussians' scales per anchor, 1 where absent.
        opacity_gain: Factor on the Gaussians' opacities per anchor, which stay at most 1; 1 where absent.
        mask_weight: Factor on opacity and scale per offset (a trainer's straight-through mask), 1 where absent.

    Returns:
        The Gaussians whose mask is True and whose opacity, before `mask_weight`, is positive.
    """
    index = visible.nonzero()[:, 0]
    num_offsets = anchors.mask.shape[1]
    inputs = _head_inputs(anchors.positions[index], anchors.features[index], camera_center)
    opacities = torch.tanh(heads.opacity(inputs))
    exists = (opacities > 0) & anchors.mask[index]
    drawn = exists.any(dim=1)  # the other two heads are most of the work: not for anchors without a Gaussian
    index, inputs, opacities, exists = index[drawn], inputs[drawn], opacities[drawn], exists[drawn]
    row, offset_index = exists.nonzero().unbind(dim=1)
    anchor_index = index[row]

    shape = heads.covariance(inputs).view(-1, num_offsets, 7)[row, offset_index]
    color = torch.sigmoid(heads.color(inputs).view(-1, num_offsets, 3)[row, offset_index])
    # an anchor stands here once for each of its offsets: the gradient of index_select adds them up in a fixed order,
    # that of an index in brackets does not
    scalings = anchors.scalings.index_select(0, anchor_index)
    means = anchors.positions[anchor_index] + anchors.offsets[anchor_index, offset_index] * scalings[:, :3]
    scales = scalings[:, 3:6] * torch.sigmoid(shape[:, :3])
    opacity = opacities[row, offset_index]
    if size_gain is not None:
        scales = scales * size_gain[anchor_index, None]
    if opacity_gain is not None:
        opacity = (opacity * opacity_gain[anchor_index]).clamp(max=1)
    if mask_weight is not None:
        weight = mask_weight[anchor_index, offset_index]
        scales, opacity = scales * weight[:, None], opacity * weight
    quats = torch.nn.functional.normalize(shape[:, 3:7], dim=1)
    return SpawnedGaussians(Gaussians(means, quats, scales, opacity, color), anchor_index, offset_index)


def _head_inputs(
    positions: Float[Tensor, "N 3"], features: Float[Tensor, "N F"], camera_center: Float[Tensor, "3"]
) -> Float[Tensor, "N D"]:
    """Feature, direction from the camera, distance from the camera."""
    ray = positions - camera_center
    distance = torch.linalg.vector_norm(ray, dim=1, keepdim=True)
    return torch.cat([features, ray / distance, distance], dim=1)
