"""Optional GPU renderer with gsplat; implements the same protocols as the CPU renderers."""

import importlib
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.anchors.projection import DILATION, TILE
from splatwire.errors import BackendUnavailableError
from splatwire.render.base import Drawing
from splatwire.types import Cameras, Gaussians

_HOW = "install splatwire with its GPU extra (pip install 'splatwire[gpu]') on a machine with a CUDA device"


class GsplatRenderer:
    """Renders Gaussians with gsplat's CUDA kernels; differentiable.

    Pictures are close to those of the CPU renderer, not equal bit for bit.

    Raises:
        BackendUnavailableError: gsplat is not installed, or there is no CUDA device.
    """

    # gsplat differs from 3DGS in two ways. It limits alpha to 0.999 instead of 0.99. It assigns a Gaussian to the
    # tiles within 3.33 standard deviations along each axis, instead of 3 along the longest axis. Pixel coordinates
    # of gsplat have the centre of the top-left pixel at (0.5, 0.5), as `Cameras.Ks`; elsewhere in this package it
    # is at (0, 0).

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
        """Renders the Gaussians on the GPU and returns the pictures on the device of the Gaussians."""
        home = gaussians.means.device
        moved = Gaussians(**{name: value.to("cuda", torch.float32) for name, value in vars(gaussians).items()})
        return self._rasterize(moved, cameras, background)[0].to(home)

    def draw(
        self, gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"], center_gradients: bool
    ) -> Drawing:
        """Renders one view for training.

        Args:
            gaussians: The Gaussians to render.
            cameras: Camera of the view.
            background: RGB of the background.
            center_gradients: True if the gradient with respect to the 2D centres is needed.

        Returns:
            The picture; and the tensor that receives the gradient of the 2D centres, None unless `center_gradients`.
        """
        images, centers = self._rasterize(gaussians, cameras, background)
        if center_gradients:
            centers.retain_grad()
        return Drawing(images[0], centers if center_gradients else None)

    def _rasterize(
        self, gaussians: Gaussians, cameras: Cameras, background: Float[Tensor, "3"]
    ) -> tuple[Float[Tensor, "C H W 3"], Float[Tensor, "C G 2"]]:
        """Renders on the device of the Gaussians; returns the pictures and the projected 2D centres in pixels."""
        if not gaussians.num_gaussians:
            return _nothing(gaussians, cameras, background)
        means = gaussians.means
        images, _, info = self._gsplat.rasterization(
            means,
            gaussians.quats,
            gaussians.scales,
            gaussians.opacities,
            gaussians.colors,
            torch.as_tensor(cameras.viewmats).to(means),
            torch.as_tensor(cameras.Ks).to(means),
            cameras.width,
            cameras.height,
            near_plane=cameras.near_depth,
            eps2d=DILATION,
            tile_size=TILE,
            packed=False,
            backgrounds=background.to(means).expand(cameras.num_views, 3),
        )
        return images, info["means2d"]


def _nothing(
    gaussians: Gaussians, cameras: Cameras, background: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "C H W 3"], Float[Tensor, "C 0 2"]]:
    """Returns the result for a scene without Gaussians: pictures of the background, and no 2D centres."""
    # The pictures are part of the autograd graph, so that training can call `backward`.
    centers = gaussians.means.new_zeros(cameras.num_views, 0, 2, requires_grad=True)
    zero = torch.stack([value.sum() for value in (centers, *vars(gaussians).values())]).sum()
    shape = (cameras.num_views, cameras.height, cameras.width, 3)
    return (background.to(gaussians.means) + zero).expand(shape), centers


def check_gsplat(device: str = "cuda") -> None:
    """Checks that gsplat works, by rendering one Gaussian and computing the gradient.

    The first call may compile gsplat's kernels, which takes minutes.

    Args:
        device: CUDA device to test.

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
        drawing = draw(gaussian, camera, background=torch.zeros(3), center_gradients=True)
        drawing.image.sum().backward()
    except (ImportError, AttributeError, TypeError, KeyError, RuntimeError, OSError) as error:
        how = (
            f"gsplat is installed, but its kernels do not run here ({error}); it needs a CUDA compiler or a built wheel"
        )
        raise BackendUnavailableError("gsplat", how) from error
    if drawing.d_centers is None:
        raise BackendUnavailableError("gsplat", "this version keeps the gradient of 2D centres to itself; use 1.5")
