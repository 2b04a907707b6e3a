"""Reference renderer in plain torch, for tests of the fast renderers."""

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.anchors.projection import TILE
from splatwire.neural.model.tensor_projection import ProjectedTensors, project_tensors
from splatwire.ops.quaternions import rotation_rows
from splatwire.types import Cameras, Gaussians

MAX_ALPHA = 0.99
MIN_ALPHA = 1 / 255
MIN_TRANSMITTANCE = 1e-4
_ROWS_AT_A_TIME = 8


def render_reference(
    gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"]
) -> Float[Tensor, "C H W 3"]:
    """Renders Gaussians with torch operations only; differentiable. For small pictures.

    Args:
        gaussians: The Gaussians to render.
        cameras: Cameras of the views to render.
        background: RGB of the background.

    Returns:
        RGB pictures, one per view.
    """
    return torch.stack([_render_view(gaussians, cameras, v, background) for v in range(cameras.num_views)])


def rotation_matrices(quats: Float[Tensor, "N 4"]) -> Float[Tensor, "N 3 3"]:
    """Converts unit quaternions (w, x, y, z) to rotation matrices."""
    return torch.stack([torch.stack(row, dim=1) for row in rotation_rows(*quats.unbind(dim=1))], dim=1)


def _render_view(
    gaussians: Gaussians, cameras: Cameras, view: int, background: Float[Tensor, "3"]
) -> Float[Tensor, "H W 3"]:
    flat = project_tensors(gaussians.means, gaussians.scales, rotation_matrices(gaussians.quats), cameras, view)
    return render_projected(flat, gaussians.opacities, gaussians.colors, cameras, background)


def render_projected(
    flat: ProjectedTensors,
    opacities: Float[Tensor, "G"],
    colors: Float[Tensor, "G 3"],
    cameras: Cameras,
    background: Float[Tensor, "3"],
) -> Float[Tensor, "H W 3"]:
    """Draws Gaussians that are already projected to the image.

    Args:
        flat: The projected Gaussians, in any order.
        opacities: Opacity of each Gaussian.
        colors: RGB of each Gaussian.
        cameras: Cameras that give the image size.
        background: RGB of the background.

    Returns:
        RGB of the image.
    """
    order = torch.argsort(flat.depths.detach(), stable=True)
    order = order[flat.touches_image(cameras.width, cameras.height)[order]]
    flat = ProjectedTensors(flat.means2d[order], flat.covs2d[order], flat.depths[order], flat.radii[order])
    opacities, colors = opacities[order], colors[order]
    bands = []
    for top in range(0, cameras.height, _ROWS_AT_A_TIME):
        bottom = min(top + _ROWS_AT_A_TIME, cameras.height)
        bands.append(_render_rows(flat, opacities, colors, background.to(colors), cameras, top, bottom))
    return torch.cat(bands)


def _render_rows(
    flat: ProjectedTensors,
    opacities: Float[Tensor, "G"],
    colors: Float[Tensor, "G 3"],
    background: Float[Tensor, "3"],
    cameras: Cameras,
    top: int,
    bottom: int,
) -> Float[Tensor, "rows W 3"]:
    """Blends all Gaussians, nearest first, into the pixels of rows `top` to `bottom` (exclusive)."""
    rows = torch.arange(top, bottom, dtype=colors.dtype, device=colors.device)
    columns = torch.arange(cameras.width, dtype=colors.dtype, device=colors.device)
    y, x = torch.meshgrid(rows, columns, indexing="ij")
    pixels = torch.stack([x, y], dim=-1).view(-1, 1, 2)

    delta = pixels - flat.means2d
    xx, xy, yy = flat.covs2d.unbind(dim=1)
    dx, dy = delta.unbind(dim=-1)
    distance = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    alpha = torch.clamp(opacities * torch.exp(-distance / 2), max=MAX_ALPHA)

    tile = torch.floor(pixels / TILE)
    left, first, right, last = flat.tile_rectangles(cameras.width, cameras.height).unbind(dim=1)
    tx, ty = tile.unbind(dim=-1)
    listed = (tx >= left) & (tx < right) & (ty >= first) & (ty < last)
    alpha = torch.where(listed & (alpha >= MIN_ALPHA), alpha, torch.zeros_like(alpha))

    after = torch.cumprod(1 - alpha, dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    drawn = after >= MIN_TRANSMITTANCE  # the Gaussian that would cross the limit is not drawn
    weights = torch.where(drawn, alpha * before, torch.zeros_like(alpha))
    transmittance = torch.prod(torch.where(drawn, 1 - alpha, torch.ones_like(alpha)), dim=1)
    return (weights @ colors + transmittance[:, None] * background).view(bottom - top, cameras.width, 3)
