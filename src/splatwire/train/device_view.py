"""A view's anchors and Gaussians on a device, in few operations and without counting any.

Each count that the host reads makes it wait for the device. So only the visible anchors are counted; all their offsets
become Gaussians, and those that do not exist have no opacity and are skipped by the renderer.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.model.anchor_scene import GaussianHeads
from splatwire.model.projection import DILATION, FRUSTUM_MARGIN, NEAR_DEPTH, TILE
from splatwire.scene import Anchors, Cameras, Gaussians
from splatwire.train.packed import pack_networks
from splatwire.train.state import TrainState


@dataclass(frozen=True, eq=False)
class ViewConstants:
    """Numbers of C cameras as an iteration needs them, on the device from the start.

    Attributes:
        rotations: World to camera.
        translations: World to camera.
        centers: Camera centres, world units.
        focals: Focal lengths, pixels.
        middles: Principal points, pixels; the centre of the top-left pixel is (0.5, 0.5).
        lowest: Smallest ratios of x and y to depth that the linearisation follows.
        highest: Largest ratios.
        size: Width and height, pixels.
        tiled: Width and height of the whole tiles, pixels.
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

    @staticmethod
    def of(cameras: Cameras) -> "ViewConstants":
        """Returns the constants of cameras, whose fields are tensors, on their device."""
        sides = (cameras.width, cameras.height)
        size, tiled = (cameras.Ks.new_tensor(values) for values in (sides, [-(-side // TILE) * TILE for side in sides]))
        focals, middles = cameras.Ks.diagonal(dim1=1, dim2=2)[:, :2].contiguous(), cameras.Ks[:, :2, 2].contiguous()
        margins = FRUSTUM_MARGIN * size / (2 * focals)
        return ViewConstants(
            cameras.viewmats[:, :3, :3].contiguous(), cameras.viewmats[:, :3, 3].contiguous(), cameras.centers,
            focals, middles, -middles / focals - margins, (size - middles) / focals + margins, size, tiled,
        )  # fmt: skip

    def local(self, points: Float[Tensor, "N 3"], view: int) -> tuple[Float[Tensor, "N 2"], Tensor, Tensor]:
        """Returns ratios of x and y to depth, depths that are at least the nearest drawn one, and a mask of those."""
        local = torch.addmm(self.translations[view], points, self.rotations[view].T)
        depth = local[:, 2:].clamp(min=NEAR_DEPTH)
        return local[:, :2] / depth, depth, local[:, 2] > NEAR_DEPTH


@dataclass(frozen=True, eq=False)
class AllGaussians:
    """Gaussians of all offsets of some anchors.

    Attributes:
        gaussians: Anchor by anchor, offsets ascending; opacity 0 where there is none. Quaternions have any length:
            renderers of a device normalise them.
        exists: Mask of the Gaussians that are drawn.
    """

    gaussians: Gaussians
    exists: Bool[Tensor, "G"]

    @property
    def num_existing(self) -> Int64[Tensor, ""]:
        """Number of Gaussians that are drawn."""
        return self.exists.sum()


@torch.no_grad()
def visible_anchors(
    views: ViewConstants, view: int, positions: Float[Tensor, "N 3"], sizes: Float[Tensor, "N S"]
) -> Bool[Tensor, "N"]:
    """Mask of the anchors that a view may see, as of `splatwire.model.gaussian_heads.visible_anchors`.

    Args:
        views: The cameras.
        view: Which of them.
        positions: World coordinates.
        sizes: One size for all axes or one for each, world units.
    """
    ratio, depth, is_far = views.local(positions, view)
    rotation = views.rotations[view]
    center = torch.addcmul(views.middles[view], ratio, views.focals[view]).sub_(0.5)
    ratio = ratio.clamp(views.lowest[view], views.highest[view])
    rows = torch.addcmul(rotation[:2], ratio[:, :, None], rotation[2], value=-1)
    rows = rows.mul_(views.focals[view][:, None] / depth[:, :, None]).mul_(sizes[:, None, :])
    spreads, cross = rows.square().sum(dim=2).add_(DILATION), (rows[:, 0] * rows[:, 1]).sum(dim=1)
    (xx, yy), half = spreads.unbind(dim=1), (spreads[:, 0] - spreads[:, 1]).mul_(0.5)
    longest = half.square_().addcmul_(cross, cross).clamp_(min=0.1).sqrt_().add_(xx, alpha=0.5).add_(yy, alpha=0.5)
    radius = longest.sqrt_().mul_(3).ceil_()[:, None]
    return ((center - radius < views.tiled) & (center + radius >= 1)).all(dim=1) & is_far


@torch.no_grad()
def on_image(views: ViewConstants, view: int, gaussians: Gaussians) -> Bool[Tensor, "G"]:
    """Mask of the Gaussians that may meet the image, as of `splatwire.train.growth.on_image`."""
    ratio, depth, is_far = views.local(gaussians.means, view)
    focal = views.focals[view]
    center = torch.addcmul(views.middles[view], ratio, focal)
    spread = gaussians.scales.amax(dim=1, keepdim=True) * focal.amax() / depth
    radius = spread.square_().add_(DILATION).sqrt_().mul_(3)
    return ((center + radius > 0) & (center - radius < views.size)).all(dim=1) & is_far


def spawn_all(
    anchors: Anchors,
    heads: GaussianHeads,
    camera_center: Float[Tensor, "3"],
    mask_weight: Float[Tensor, "M K"],
    size_gain: Float[Tensor, "M"] | None = None,
) -> AllGaussians:
    """Makes a Gaussian of every offset of every anchor; otherwise as `splatwire.model.gaussian_heads.spawn_gaussians`.

    Args:
        anchors: Visible anchors.
        heads: The networks.
        camera_center: Centre of the camera, world units.
        mask_weight: Factor on opacity and scale per offset, 0 where there is none.
        size_gain: Factor on the Gaussians' scales per anchor; 1 where absent.
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
    """Adds one view to the statistics, as `splatwire.train.growth.gather_statistics` does.

    Args:
        state: Its statistics are changed in place.
        visible: Anchors that the view may see.
        spawned: The Gaussians of all their offsets.
        d_centers: Gradient of the loss in the Gaussians' 2D centres, per pixel.
        views: The cameras.
        view: Which of them.
    """
    statistics = state.statistics
    shape = (len(visible), statistics.gradient_sum.shape[1])  # not -1, which no visible anchors leave open
    opacity = spawned.gaussians.opacities.view(shape).sum(dim=1)
    counted = (on_image(views, view, spawned.gaussians) & spawned.exists).float()
    length = torch.linalg.vector_norm(d_centers * (views.size / 2), dim=1).mul_(counted)
    statistics.visits.index_add_(0, visible, torch.ones_like(opacity))
    statistics.opacity_sum.index_add_(0, visible, opacity)
    statistics.gradient_sum.index_add_(0, visible, length.view(shape))
    statistics.gradient_count.index_add_(0, visible, counted.view(shape))
