"""gsplat as an optional GPU backend behind the same protocol."""

import importlib
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.errors import BackendUnavailableError
from splatwire.model.projection import DILATION, NEAR_DEPTH, TILE
from splatwire.scene import Cameras, Gaussians


class GsplatRenderer:
    """Draws with gsplat's CUDA kernels; differentiable.

    gsplat's cap of alpha and its lists of Gaussians per tile differ a little from 3DGS's, so pictures are close to the
    CPU renderer's, not bit for bit the same.

    Raises:
        BackendUnavailableError: gsplat is not installed, or there is no CUDA device.
    """

    def __init__(self) -> None:
        how = "install splatwire with its GPU extra (pip install 'splatwire[gpu]') on a machine with a CUDA device"
        try:
            self._gsplat: Any = importlib.import_module("gsplat")
        except ImportError as error:
            raise BackendUnavailableError("gsplat", how) from error
        if not torch.cuda.is_available():
            raise BackendUnavailableError("gsplat", f"torch finds no CUDA device; {how}")

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"]
    ) -> Float[Tensor, "C H W 3"]:
        """Draws on the GPU and returns the pictures on the device of the Gaussians."""
        home = gaussians.means.device
        parts = [gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors]
        means, quats, scales, opacities, colors = (t.to("cuda", torch.float32) for t in parts)
        images, _, _ = self._gsplat.rasterization(
            means,
            quats,
            scales,
            opacities,
            colors,
            cameras.viewmats.to(means),
            cameras.Ks.to(means),
            cameras.width,
            cameras.height,
            near_plane=NEAR_DEPTH,
            eps2d=DILATION,
            tile_size=TILE,
            packed=False,
            backgrounds=background.to(means).expand(cameras.num_views, 3),
        )
        return images.to(home)
