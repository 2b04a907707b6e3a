"""Visible anchors of a view, their Gaussians and growth statistics, computed on a GPU."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.anchors.projection import DILATION, FRUSTUM_MARGIN, TILE
from splatwire.neural.training.packed import pack_networks
from splatwire.neural.training.state import TrainState
from splatwire.types import Anchors, Cameras, Gaussians
from splatwire.types.anchor_scene import GaussianHeads


@dataclass(frozen=True, eq=False)
class ViewConstants:
    """Parameters of C cameras, precomputed on the GPU.

    Attributes:
        rotations: Rotations from world to camera coordinates.
        translations: Translations from world to camera coordinates, world units.
        centers: Camera centres, world units.
        focals: Focal lengths, pixels.
        middles: Principal points, pixels; the centre of the top-left pixel is (0.5, 0.5).
        lowest: Lower limits to which x / depth and y / depth are clamped in the Jacobian of the projection.
        highest: Upper limits to which x / depth and y / depth are clamped in the Jacobian of the projection.
        size: Width and height of the image, pixels.
        tiled: Width and height of the image, rounded up to whole tiles, pixels.
        near_depth: Near plane, world units.
    """

    rotations: Float[Tensor, "C 3 3"]
    translations: Float[Tensor, "C 3"]
    centers: Float[Tensor, "C 3"]
    focals: Float[Tensor, "C 2"]
    middles: Float[Tensor, "C 2"]
    lowest: Float[Tensor, "C 2"]
    highest: Float[Tensor, "C 2"]
    size: Float[Tensor, "2"]
    tiled: Float[Tensor, "2"]
    near_depth: float

    @staticmethod
    def of(cameras: Cameras) -> "ViewConstants":
        """Computes the parameters of `cameras`, on the device of their tensors."""
        sides = (cameras.width, cameras.height)
        size, tiled = (cameras.Ks.new_tensor(values) for values in (sides, [-(-side // TILE) * TILE for side in sides]))
        focals, middles = cameras.Ks.diagonal(dim1=1, dim2=2)[:, :2].contiguous(), cameras.Ks[:, :2, 2].contiguous()
        margins = FRUSTUM_MARGIN * size / (2 * focals)
        return ViewConstants(
            cameras.viewmats[:, :3, :3].contiguous(), cameras.viewmats[:, :3, 3].contiguous(), cameras.centers,
            focals, middles, -middles / focals - margins, (size - middles) / focals + margins, size, tiled,
            cameras.near_depth,
        )  # fmt: skip

    def local(self, points: Float[Tensor, "N 3"], view: int) -> tuple[Float[Tensor, "N 2"], Tensor, Tensor]:
        """Projects points with a camera of focal length 1, and returns their depths.

        Args:
            points: World coordinates.
            view: Index of the camera.

        Returns:
            x / depth and y / depth; the depths, (N, 1), at least `near_depth`; and the mask of the points beyond the
            near plane, bool (N).
        """
        # Depths are clamped to the near plane.
        local = torch.addmm(self.translations[view], points, self.rotations[view].T)
        depth = local[:, 2:].clamp(min=self.near_depth)
        return local[:, :2] / depth, depth, local[:, 2] > self.near_depth


@dataclass(frozen=True, eq=False)
class AllGaussians:
    """Gaussians of all offsets of some anchors, including masked-out offsets.

    Attributes:
        gaussians: Gaussians in the order of anchors, then offsets; opacity 0 for those that are not drawn.
        drawn: Mask of the Gaussians that are drawn.
    """

    # Quaternions are not normalised, because GPU renderers normalise them.

    gaussians: Gaussians
    drawn: Bool[Tensor, "G"]

    @property
    def num_drawn(self) -> Int64[Tensor, ""]:
        """Number of Gaussians that are drawn."""
        return self.drawn.sum()


@torch.no_grad()
def visible_anchors(
    views: ViewConstants, view: int, positions: Float[Tensor, "N 3"], offset_scales: Float[Tensor, "N S"]
) -> Bool[Tensor, "N"]:
    """Returns the mask of the anchors that a view may see.

    Args:
        views: The cameras.
        view: Index of the camera.
        positions: World coordinates of the anchors.
        offset_scales: Scale of each anchor's offsets, one for all axes or one per axis, world units. The anchor is
            projected like an unrotated Gaussian with these standard deviations.
    """
    ratio, depth, beyond_near = views.local(positions, view)
    rotation = views.rotations[view]
    center = torch.addcmul(views.middles[view], ratio, views.focals[view]).sub_(0.5)
    ratio = ratio.clamp(views.lowest[view], views.highest[view])
    rows = torch.addcmul(rotation[:2], ratio[:, :, None], rotation[2], value=-1)
    rows = rows.mul_(views.focals[view][:, None] / depth[:, :, None]).mul_(offset_scales[:, None, :])
    spreads, cross = rows.square().sum(dim=2).add_(DILATION), (rows[:, 0] * rows[:, 1]).sum(dim=1)
    (xx, yy), half = spreads.unbind(dim=1), (spreads[:, 0] - spreads[:, 1]).mul_(0.5)
    longest = half.square_().addcmul_(cross, cross).clamp_(min=0.1).sqrt_().add_(xx, alpha=0.5).add_(yy, alpha=0.5)
    radius = longest.sqrt_().mul_(3).ceil_()[:, None]
    return ((center - radius < views.tiled) & (center + radius >= 1)).all(dim=1) & beyond_near


@torch.no_grad()
def on_image(views: ViewConstants, view: int, gaussians: Gaussians) -> Bool[Tensor, "G"]:
    """Returns the mask of the Gaussians that may intersect the image."""
    ratio, depth, beyond_near = views.local(gaussians.means, view)
    focal = views.focals[view]
    center = torch.addcmul(views.middles[view], ratio, focal)
    spread = gaussians.scales.amax(dim=1, keepdim=True) * focal.amax() / depth
    radius = spread.square_().add_(DILATION).sqrt_().mul_(3)
    return ((center + radius > 0) & (center - radius < views.size)).all(dim=1) & beyond_near


def spawn_all(
    anchors: Anchors,
    heads: GaussianHeads,
    camera_center: Float[Tensor, "3"],
    mask_weight: Float[Tensor, "M K"],
    size_gain: Float[Tensor, "M"] | None = None,
) -> AllGaussians:
    """Generates a Gaussian for every offset of every given anchor, including masked-out offsets.

    Args:
        anchors: Visible anchors.
        heads: The networks that predict opacity, covariance and colour of Gaussians.
        camera_center: Centre of the camera, world units.
        mask_weight: Factor on opacity and scale per offset; 0 for masked-out offsets.
        size_gain: Factor per anchor on the scales of its Gaussians; None for 1.
    """
    num, num_offsets = mask_weight.shape
    ray = anchors.positions - camera_center
    distance = torch.linalg.vector_norm(ray, dim=1, keepdim=True)
    inputs = torch.cat([anchors.features, ray / distance, distance], dim=1)
    packed = pack_networks((heads.opacity, heads.covariance, heads.color), tuple(range(11 * num_offsets)))
    opacity, shape, color = packed(inputs, 0.0).split([num_offsets, 7 * num_offsets, 3 * num_offsets], dim=1)
    strength = torch.tanh(opacity) * mask_weight
    sizes, quats = shape.view(num, num_offsets, 7).split([3, 4], dim=2)
    reach, base = anchors.scalings.split([3, 3], dim=1)
    if size_gain is not None:
        base = base * size_gain[:, None]
    scales = torch.sigmoid(sizes) * base[:, None] * mask_weight[:, :, None]
    means = torch.addcmul(anchors.positions[:, None], anchors.offsets, reach[:, None])
    gaussians = Gaussians(
        means.view(-1, 3), quats.reshape(-1, 4), scales.view(-1, 3), torch.relu(strength).view(-1),
        torch.sigmoid(color).view(-1, 3),
    )  # fmt: skip
    return AllGaussians(gaussians, (strength.detach() > 0).view(-1))


@torch.no_grad()
def gather_statistics(
    state: TrainState,
    visible: Int64[Tensor, "M"],
    spawned: AllGaussians,
    d_centers: Float[Tensor, "G 2"],
    views: ViewConstants,
    view: int,
) -> None:
    """Updates the statistics for adding and removing anchors with the opacities and gradients of one view.

    Args:
        state: State of the training; the statistics are changed in place.
        visible: Indices of the anchors that the view may see.
        spawned: The Gaussians of all offsets of these anchors.
        d_centers: Gradient of the loss with respect to the Gaussians' 2D centres, per pixel.
        views: Constants of all cameras.
        view: Index of the camera that rendered the view.
    """
    statistics = state.statistics
    shape = (len(visible), statistics.gradient_sum.shape[1])  # -1 would be ambiguous if no anchor is visible
    opacity = spawned.gaussians.opacities.view(shape).sum(dim=1)
    counted = (on_image(views, view, spawned.gaussians) & spawned.drawn).float()
    length = torch.linalg.vector_norm(d_centers * (views.size / 2), dim=1).mul_(counted)
    statistics.visits.index_add_(0, visible, torch.ones_like(opacity))
    statistics.opacity_sum.index_add_(0, visible, opacity)
    statistics.gradient_sum.index_add_(0, visible, length.view(shape))
    statistics.gradient_count.index_add_(0, visible, counted.view(shape))
