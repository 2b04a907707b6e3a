"""Differentiable projection of Gaussians in torch; same results as `splatwire.anchors.projection`."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from splatwire.anchors.projection import DILATION, FRUSTUM_MARGIN, TILE
from splatwire.reprs import summary_repr
from splatwire.types import Cameras


@dataclass(frozen=True, eq=False)
class ProjectedTensors:
    """N Gaussians projected to the image of a camera.

    Attributes:
        means2d: Centres in pixels; (0, 0) is the centre of the top-left pixel.
        covs2d: Entries xx, xy, yy of the projected covariance plus 0.3 on the diagonal, square pixels.
        depths: Distance from the camera along the viewing axis, world units.
        radii: Three standard deviations along the longest axis, rounded up to whole pixels; 0 for Gaussians closer
            than the near plane.
    """

    means2d: Float[Tensor, "N 2"]
    covs2d: Float[Tensor, "N 3"]
    depths: Float[Tensor, "N"]
    radii: Float[Tensor, "N"]

    __repr__ = summary_repr

    def tile_rectangles(self, width: int, height: int) -> Float[Tensor, "N 4"]:
        """Returns the image tiles that each Gaussian covers: left, top, right, bottom (exclusive), in tiles.

        Args:
            width: Width of the image, pixels.
            height: Height of the image, pixels.
        """
        grid = torch.tensor([-(-width // TILE), -(-height // TILE)], dtype=self.radii.dtype, device=self.radii.device)
        radius = self.radii[:, None]
        low = torch.floor((self.means2d - radius) / TILE)
        high = torch.floor((self.means2d + radius + (TILE - 1)) / TILE)
        return torch.cat([low.clamp(min=0).minimum(grid), high.clamp(min=0).minimum(grid)], dim=1).detach()

    def touches_image(self, width: int, height: int) -> Bool[Tensor, "N"]:
        """Returns the mask of the Gaussians beyond the near plane that intersect a tile of the image, bool (N).

        Args:
            width: Width of the image, pixels.
            height: Height of the image, pixels.
        """
        tiles = self.tile_rectangles(width, height)
        return (self.radii > 0) & (tiles[:, 2] > tiles[:, 0]) & (tiles[:, 3] > tiles[:, 1])


def project_tensors(
    means: Float[Tensor, "N 3"],
    scales: Float[Tensor, "N 3"],
    rotations: Float[Tensor, "N 3 3"] | None,
    cameras: Cameras,
    view: int,
) -> ProjectedTensors:
    """Projects Gaussians to the image of a camera; differentiable in `means`, `scales` and `rotations`.

    Args:
        means: Centres of the Gaussians in world coordinates.
        scales: Standard deviations along the principal axes, world units.
        rotations: Rotation matrices with the principal axes as columns; None for the world axes.
        cameras: The cameras.
        view: Index of the camera.

    Returns:
        The projected Gaussians. The covariance is J W S W^T J^T + 0.3 I, with the world covariance S, the rotation W of
        the camera and the Jacobian J of the projection.
    """
    # The Jacobian is evaluated at the centre, clamped to 1.3 times the half field of view (HAC++, decoding of a
    # view).
    pose, K = (torch.as_tensor(values[view]).to(means) for values in (cameras.viewmats, cameras.Ks))
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    local = means @ pose[:3, :3].T + pose[:3, 3]
    near = local[:, 2] <= cameras.near_depth
    z = torch.where(near, torch.ones_like(local[:, 2]), local[:, 2])
    x, y = local[:, 0] / z, local[:, 1] / z
    means2d = torch.stack([fx * x + (cx - 0.5), fy * y + (cy - 0.5)], dim=1)

    margin_x, margin_y = FRUSTUM_MARGIN * cameras.width / (2 * fx), FRUSTUM_MARGIN * cameras.height / (2 * fy)
    x = torch.clamp(x, -cx / fx - margin_x, (cameras.width - cx) / fx + margin_x)
    y = torch.clamp(y, -cy / fy - margin_y, (cameras.height - cy) / fy + margin_y)
    # rows of J W: derivatives of the pixel coordinates with respect to the world axes
    row_x = (fx / z)[:, None] * (pose[0, :3] - x[:, None] * pose[2, :3])
    row_y = (fy / z)[:, None] * (pose[1, :3] - y[:, None] * pose[2, :3])
    if rotations is not None:
        row_x = torch.einsum("ni,nij->nj", row_x, rotations)
        row_y = torch.einsum("ni,nij->nj", row_y, rotations)
    row_x, row_y = row_x * scales, row_y * scales
    xx, yy = (row_x * row_x).sum(dim=1) + DILATION, (row_y * row_y).sum(dim=1) + DILATION
    covs2d = torch.stack([xx, (row_x * row_y).sum(dim=1), yy], dim=1)
    return ProjectedTensors(means2d, covs2d, local[:, 2], _radii(covs2d.detach(), near))


def _radii(covs2d: Float[Tensor, "N 3"], near: Bool[Tensor, "N"]) -> Float[Tensor, "N"]:
    """Returns the radius of each projected Gaussian, rounded up to pixels.

    The radius is three times the standard deviation along the longest axis.

    Args:
        covs2d: Entries xx, xy, yy of the covariances, square pixels.
        near: Mask of the Gaussians closer than the near plane, whose result is 0.
    """
    # As in 3DGS, the square root in the formula for the longest axis is taken of at least 0.1.
    xx, xy, yy = covs2d.unbind(dim=1)
    middle = (xx + yy) / 2
    longest = middle + torch.sqrt((middle * middle - (xx * yy - xy * xy)).clamp(min=0.1))
    return torch.where(near, torch.zeros_like(longest), torch.ceil(3 * torch.sqrt(longest)))
