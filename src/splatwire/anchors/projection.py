"""Perspective projection of 3D Gaussians to 2D Gaussians on the image (EWA), with the conventions of 3DGS.

In image coordinates, the centre of the top-left pixel is (0, 0); in `Cameras.Ks`, it is (0.5, 0.5).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from splatwire.ops.arrays import to_numpy
from splatwire.reprs import summary_repr
from splatwire.types import Cameras

DILATION = 0.3
"""Added to the diagonal of the 2D covariance, square pixels; no Gaussian is thinner than about half a pixel."""
FRUSTUM_MARGIN = 0.3
"""Margin around the image, as a fraction of half the image size, to which the point of linearisation is clamped."""
TILE = 16
"""Side of a rasteriser tile in pixels; part of the visibility test of 3DGS, see `touches_image`."""


@dataclass(frozen=True, eq=False)
class Projected:
    """Projection of N Gaussians to one image.

    Attributes:
        means2d: Centres in pixels, (0, 0) is the centre of the top-left pixel.
        covs2d: Entries xx, xy, yy of the projected covariance, plus 0.3 on the diagonal, in pixels squared.
        depths: Distance from the camera along the viewing axis, world units.
        radii: Three standard deviations along the longest axis, whole pixels; 0 for Gaussians too near to the camera.
    """

    means2d: Float[np.ndarray, "N 2"]
    covs2d: Float[np.ndarray, "N 3"]
    depths: Float[np.ndarray, "N"]
    radii: Float[np.ndarray, "N"]

    __repr__ = summary_repr

    def tile_rectangles(self, width: int, height: int) -> Float[np.ndarray, "N 4"]:
        """Returns the tiles that each Gaussian overlaps: left, top, right, bottom (exclusive), in tiles.

        Args:
            width: Width of the image, pixels.
            height: Height of the image, pixels.
        """
        grid = np.array([-(-width // TILE), -(-height // TILE)], self.radii.dtype)
        radius = self.radii[:, None]
        low = np.floor((self.means2d - radius) / TILE)
        high = np.floor((self.means2d + radius + (TILE - 1)) / TILE)
        return np.concatenate([np.clip(low, 0, grid), np.clip(high, 0, grid)], axis=1)

    def touches_image(self, width: int, height: int) -> Bool[np.ndarray, "N"]:
        """Returns the mask of Gaussians that may be visible (HAC++): not too near, and overlapping a tile of the image.

        Args:
            width: Width of the image, pixels.
            height: Height of the image, pixels.
        """
        tiles = self.tile_rectangles(width, height)
        return (self.radii > 0) & (tiles[:, 2] > tiles[:, 0]) & (tiles[:, 3] > tiles[:, 1])


def project(
    means: Float[np.ndarray, "N 3"],
    scales: Float[np.ndarray, "N 3"],
    rotations: Float[np.ndarray, "N 3 3"] | None,
    cameras: Cameras,
    view: int,
) -> Projected:
    """Projects Gaussians to the image of a camera.

    Args:
        means: Centres, world units, relative to the origin of the cameras.
        scales: Standard deviations along the principal axes, world units.
        rotations: Principal axes as columns; None for the world axes.
        cameras: The cameras.
        view: Index of the camera.

    Returns:
        The Gaussians on the image. The covariance is J W S W^T J^T + 0.3 I, with the world covariance S, the rotation W
        of the camera and the Jacobian J of the projection at the centre (HAC++, decoding of a view).
    """
    pose, K = (to_numpy(values[view]).astype(means.dtype) for values in (cameras.viewmats, cameras.Ks))
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    local = means @ pose[:3, :3].T + pose[:3, 3]
    half, wide = means.dtype.type(0.5), means.dtype.type(DILATION)
    near = local[:, 2] <= cameras.near_depth
    z = np.where(near, means.dtype.type(1), local[:, 2])
    x, y = local[:, 0] / z, local[:, 1] / z
    means2d = np.stack([fx * x + (cx - half), fy * y + (cy - half)], axis=1)

    margin_x, margin_y = FRUSTUM_MARGIN * cameras.width / (2 * fx), FRUSTUM_MARGIN * cameras.height / (2 * fy)
    x = np.clip(x, -cx / fx - margin_x, (cameras.width - cx) / fx + margin_x)
    y = np.clip(y, -cy / fy - margin_y, (cameras.height - cy) / fy + margin_y)
    # Rows of J W: how the pixel moves with each world axis.
    row_x = (fx / z)[:, None] * (pose[0, :3] - x[:, None] * pose[2, :3])
    row_y = (fy / z)[:, None] * (pose[1, :3] - y[:, None] * pose[2, :3])
    if rotations is not None:
        row_x = np.einsum("ni,nij->nj", row_x, rotations)
        row_y = np.einsum("ni,nij->nj", row_y, rotations)
    row_x, row_y = row_x * scales, row_y * scales
    xx, yy = (row_x * row_x).sum(axis=1) + wide, (row_y * row_y).sum(axis=1) + wide
    covs2d = np.stack([xx, (row_x * row_y).sum(axis=1), yy], axis=1)
    return Projected(means2d, covs2d, local[:, 2], _radii(covs2d, near))


def _radii(covs2d: Float[np.ndarray, "N 3"], near: Bool[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    """Returns the radius of each Gaussian: three standard deviations of its longest axis, in whole pixels.

    Args:
        covs2d: Entries xx, xy, yy of the covariance on the image, square pixels.
        near: Mask of Gaussians too near to the camera, whose radius is 0.
    """
    xx, xy, yy = covs2d.T
    middle = (xx + yy) / 2
    # larger eigenvalue of the covariance; the root of at least 0.1 is that of 3DGS
    longest = middle + np.sqrt(np.maximum(middle * middle - (xx * yy - xy * xy), 0.1))
    return np.where(near, covs2d.dtype.type(0), np.ceil(3 * np.sqrt(longest)))
