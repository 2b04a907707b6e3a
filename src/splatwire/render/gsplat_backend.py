"""gsplat as an optional GPU backend behind the same protocols."""

import importlib
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.errors import BackendUnavailableError
from splatwire.model.projection import DILATION, NEAR_DEPTH, TILE
from splatwire.render.base import Drawing
from splatwire.scene import Cameras, Gaussians

_HOW = "install splatwire with its GPU extra (pip install 'splatwire[gpu]') on a machine with a CUDA device"


class GsplatRenderer:
    """Draws with gsplat's CUDA kernels; differentiable.

    gsplat's cap of alpha (0.999, not 0.99) and its lists of Gaussians per tile (3.33 standard deviations along each
    axis, not 3 along the longest) differ a little from 3DGS's, so pictures are close to the CPU renderer's, not bit for
    bit the same. Its pixels are those of `Cameras.Ks`, half a pixel more than ours: derivatives do not notice.

    Raises:
        BackendUnavailableError: gsplat is not installed, or there is no CUDA device.
    """

    def __init__(self) -> None:
        try:
            self._gsplat: Any = importlib.import_module("gsplat")
        except ImportError as error:
            raise BackendUnavailableError("gsplat", _HOW) from error
        if not torch.cuda.is_available():
            raise BackendUnavailableError("gsplat", f"torch finds no CUDA device; {_HOW}")

    def __call__(
        self, gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"]
    ) -> Float[Tensor, "C H W 3"]:
        """Draws on the GPU and returns the pictures on the device of the Gaussians."""
        home = gaussians.means.device
        moved = Gaussians(**{name: value.to("cuda", torch.float32) for name, value in vars(gaussians).items()})
        return self._rasterize(moved, cameras, background)[0].to(home)

    def draw(self, gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"], watched: bool) -> Drawing:
        """Draws a view for training; see `splatwire.render.base.TrainingRenderer`."""
        images, centers = self._rasterize(gaussians, cameras, background)
        if watched:
            centers.retain_grad()
        return Drawing(images[0], centers if watched else None)

    def _rasterize(
        self, gaussians: Gaussians, cameras: Cameras, background: Float[Tensor, "3"]
    ) -> tuple[Float[Tensor, "C H W 3"], Float[Tensor, "C G 2"]]:
        """Draws where the Gaussians are; returns the pictures and the 2D centres that they were drawn from.

        Centres come from gsplat in pixels, one row per Gaussian because nothing is packed, and are part of the graph:
        their gradient is per pixel, and zero for Gaussians outside the image.
        """
        if not gaussians.num_gaussians:
            return _nothing(gaussians, cameras, background)
        means = gaussians.means
        images, _, found = self._gsplat.rasterization(
            means,
            gaussians.quats,
            gaussians.scales,
            gaussians.opacities,
            gaussians.colors,
            torch.as_tensor(cameras.viewmats).to(means),
            torch.as_tensor(cameras.Ks).to(means),
            cameras.width,
            cameras.height,
            near_plane=NEAR_DEPTH,
            eps2d=DILATION,
            tile_size=TILE,
            packed=False,
            backgrounds=background.to(means).expand(cameras.num_views, 3),
        )
        return images, found["means2d"]


def _nothing(
    gaussians: Gaussians, cameras: Cameras, background: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "C H W 3"], Float[Tensor, "C 0 2"]]:
    """Pictures of no Gaussians: the background, differentiable as any other picture."""
    centers = gaussians.means.new_zeros(cameras.num_views, 0, 2, requires_grad=True)
    zero = torch.stack([value.sum() for value in (centers, *vars(gaussians).values())]).sum()
    shape = (cameras.num_views, cameras.height, cameras.width, 3)
    return (background.to(gaussians.means) + zero).expand(shape), centers


def check_gsplat(device: str = "cuda") -> None:
    """Draws one Gaussian and its gradient, so that what is missing is found before the work.

    gsplat's kernels may be compiled for that, which takes minutes the first time.

    Args:
        device: Where to draw it.

    Raises:
        BackendUnavailableError: gsplat is not installed, there is no CUDA device, or gsplat's kernels do not run here.
    """
    draw = GsplatRenderer().draw
    try:
        means = torch.tensor([[0.0, 0.0, 2.0]], device=device, requires_grad=True)
        one = torch.ones_like(means[:, 0])
        quats, scales = torch.eye(4, device=device)[:1], torch.full_like(means, 0.1)
        camera = Cameras(torch.eye(4)[None], torch.tensor([[[8.0, 0, 8], [0, 8.0, 8], [0, 0, 1]]]), 16, 16, ("one",))
        gaussian = Gaussians(means, quats, scales, 0.5 * one, torch.ones_like(means))
        drawing = draw(gaussian, camera, background=torch.zeros(3), watched=True)
        drawing.image.sum().backward()
    except (ImportError, AttributeError, TypeError, KeyError, RuntimeError, OSError) as error:
        how = (
            f"gsplat is installed, but its kernels do not run here ({error}); it needs a CUDA compiler or a built wheel"
        )
        raise BackendUnavailableError("gsplat", how) from error
    if drawing.d_centers is None:
        raise BackendUnavailableError("gsplat", "this version keeps the gradient of 2D centres to itself; use 1.5")
