"""Generation of a view's Gaussians from neural anchors, in torch and differentiable."""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.anchors.compiled_heads import SpawnedGaussians
from splatwire.neural.model.tensor_projection import project_tensors
from splatwire.neural.model.tensors import run_network, to_tensors
from splatwire.types import Anchors, Cameras, Gaussians
from splatwire.types.anchor_scene import AnchorScene, GaussianHeads


def generate_gaussians(scene: AnchorScene, cameras: Cameras, view: int) -> Gaussians:
    """Generates the Gaussians that a camera sees from the anchors of a scene; differentiable.

    Args:
        scene: The scene.
        cameras: The cameras.
        view: Index of the camera.

    Returns:
        The Gaussians with positive opacity of all anchors in view, ordered by anchor.
    """
    # If losses were concealed, the concealer may have hidden anchors and changed sizes and opacities of Gaussians,
    # but not their positions.
    return generate_spawned(scene, cameras, view).gaussians


def generate_spawned(scene: AnchorScene, cameras: Cameras, view: int) -> SpawnedGaussians:
    """Generates the Gaussians that a camera sees, with the anchor and the offset to which each of them belongs.

    Args:
        scene: The scene.
        cameras: The cameras.
        view: Index of the camera.
    """
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
    """Returns the mask of the anchors whose Gaussians may be in the image of a camera, bool (N).

    Tests the projection of each anchor, not of its Gaussians. Source: the pre-filter of HAC++.

    Args:
        anchors: The N anchors.
        cameras: The cameras.
        view: Index of the camera.
    """
    # An anchor is projected as an unrotated Gaussian, with its first three scalings as sizes. It is kept if it is
    # beyond the near plane, and the square of three standard deviations around it intersects a tile of the
    # image.
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
    """Generates the Gaussians of the visible anchors with the head networks (HAC++); differentiable.

    Args:
        anchors: All anchors.
        heads: The networks that predict opacity, covariance and colour of Gaussians.
        camera_center: Camera position, world units.
        visible: Mask of the anchors to use. None of these anchors may coincide with the camera centre.
        size_gain: Factor per anchor on the scales of its Gaussians; None for 1.
        opacity_gain: Factor per anchor on the opacities of its Gaussians; None for 1.
        mask_weight: Factor per offset on opacity and scale; None for 1.

    Returns:
        The Gaussians with positive opacity.
    """
    index = visible.nonzero()[:, 0]
    num_offsets = anchors.mask.shape[1]
    inputs = _head_inputs(anchors.positions[index], anchors.features[index], camera_center)
    opacities = torch.tanh(run_network(heads.opacity, inputs))
    exists = (opacities > 0) & anchors.mask[index]
    drawn = exists.any(dim=1)  # saves the other two heads, most of the work, for anchors without a Gaussian
    index, inputs, opacities, exists = index[drawn], inputs[drawn], opacities[drawn], exists[drawn]
    row, offset_index = exists.nonzero().unbind(dim=1)
    anchor_index = index[row]

    shape = run_network(heads.covariance, inputs).view(-1, num_offsets, 7)[row, offset_index]
    color = torch.sigmoid(run_network(heads.color, inputs).view(-1, num_offsets, 3)[row, offset_index])
    # an anchor occurs once per offset: the gradient of index_select sums these in a fixed order, unlike that of
    # indexing with brackets
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
    """Returns the inputs of the networks that generate an anchor's Gaussians: feature, direction and distance."""
    ray = positions - camera_center
    distance = torch.linalg.vector_norm(ray, dim=1, keepdim=True)
    return torch.cat([features, ray / distance, distance], dim=1)
