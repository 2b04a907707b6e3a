"""Fake gsplat without a GPU: the one function that is used, computed by the plain reference renderer."""

import types

import torch

from splatwire.anchors.projection import DILATION, TILE
from splatwire.neural.model.tensor_projection import ProjectedTensors, project_tensors
from splatwire.neural.render.reference import render_projected, rotation_matrices
from splatwire.types import Cameras


def rasterization(
    means: torch.Tensor,
    quats: torch.Tensor,
    scales: torch.Tensor,
    opacities: torch.Tensor,
    colors: torch.Tensor,
    viewmats: torch.Tensor,
    Ks: torch.Tensor,
    width: int,
    height: int,
    *,
    near_plane: float,
    eps2d: float,
    tile_size: int,
    packed: bool,
    backgrounds: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, dict[str, torch.Tensor]]:
    """Pictures, None as alpha, and differentiable 2D centres; pixel centres are at a half.

    As gsplat does, normalises quaternions.
    """
    assert (eps2d, tile_size, packed) == (DILATION, TILE, False)
    assert len({t.device for t in (means, quats, scales, opacities, colors, viewmats, Ks, backgrounds)}) == 1
    assert all(t.dtype == torch.float32 for t in (means, quats, scales, opacities, colors, viewmats, Ks, backgrounds))
    assert means.shape[0] > 0
    cameras = Cameras(viewmats, Ks, width, height, tuple(str(view) for view in range(len(viewmats))))
    quats = torch.nn.functional.normalize(quats, dim=1)
    flat = [project_tensors(means, scales, rotation_matrices(quats), cameras, view) for view in range(len(viewmats))]
    centers = torch.stack([view.means2d + 0.5 for view in flat])
    images = [
        render_projected(
            ProjectedTensors(center - 0.5, view.covs2d, view.depths, view.radii), opacities, colors, cameras, back
        )
        for center, view, back in zip(centers, flat, backgrounds, strict=True)
    ]
    return torch.stack(images), torch.empty(0), {"means2d": centers}


def module() -> types.ModuleType:
    """Module that `import gsplat` returns."""
    fake = types.ModuleType("gsplat")
    fake.rasterization = rasterization  # type: ignore[attr-defined]
    return fake
