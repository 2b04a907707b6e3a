"""Differentiable CPU renderer for torch tensors; same pictures as `splatwire.render.cpu`."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from splatwire.render.base import Drawing
from splatwire.render.cpu import ViewRasterizer, keep_freed_memory
from splatwire.types import Cameras, Gaussians


def render_differentiable(
    gaussians: Gaussians,
    cameras: Cameras,
    *,
    background: Float[Tensor, "3"],
    probe: Float[Tensor, "C G 2"] | None = None,
) -> Float[Tensor, "C H W 3"]:
    """Renders Gaussians on the CPU in float32; gradients reach the Gaussians and the background.

    Args:
        gaussians: The Gaussians to render.
        cameras: Cameras of one or more views.
        background: RGB of the background.
        probe: Tensor of zeros that is added to the 2D centres of the G Gaussians in each of the C views. A backward
            pass adds the gradient with respect to the 2D centres to `probe.grad`, 1 / pixel. None if this gradient is
            not needed.

    Returns:
        RGB pictures, not clamped, on the device of the Gaussians.
    """
    keep_freed_memory()
    fields = (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors)
    inputs = [t.to("cpu", torch.float32).contiguous() for t in (*fields, background)]
    views = []
    for view in range(cameras.num_views):
        shift = None if probe is None else probe[view]
        views.append(_Rasterize.apply(cameras, view, shift, *inputs))
    pictures = torch.stack(views) if len(views) > 1 else views[0][None]  # copying large pictures takes long
    return pictures.to(gaussians.means.device)


def draw_cpu(
    gaussians: Gaussians, cameras: Cameras, *, background: Float[Tensor, "3"], center_gradients: bool
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
    probe = torch.zeros(1, gaussians.num_gaussians, 2, requires_grad=True) if center_gradients else None
    return Drawing(render_differentiable(gaussians, cameras, background=background, probe=probe)[0], probe)


class _Rasterize(torch.autograd.Function):
    """Autograd function that renders one view."""

    # Its tensor inputs are `probe` (see `render_differentiable`), means, quats, scales, opacities, colors and
    # background.

    @staticmethod
    def forward(ctx: Any, cameras: Cameras, view: int, probe: Tensor | None, *inputs: Tensor) -> Tensor:
        *arrays, background = (t.detach().numpy() for t in inputs)
        rasterizer = ViewRasterizer(arrays, cameras, view, for_gradients=any(ctx.needs_input_grad))
        image, transmittance = rasterizer.draw(background)
        ctx.rasterizer, ctx.transmittance, ctx.has_probe = rasterizer, transmittance, probe is not None
        result = torch.from_numpy(image)
        ctx.save_for_backward(*inputs, result)
        return result

    @staticmethod
    def backward(ctx: Any, *d_images: Tensor) -> tuple[Any, ...]:
        *inputs, _, image = ctx.saved_tensors  # torch raises an error if a saved tensor was changed in place
        d_image = d_images[0].detach().to(torch.float32).contiguous().numpy()
        gradients = ctx.rasterizer.gradients([t.detach().numpy() for t in inputs], image.detach().numpy(), d_image)
        d_background = np.einsum("hw,hwc->c", ctx.transmittance, d_image)
        *d_inputs, d_probe = (torch.from_numpy(g) for g in gradients)
        return None, None, d_probe if ctx.has_probe else None, *d_inputs, torch.from_numpy(d_background)
