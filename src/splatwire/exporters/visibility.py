"""How much of each Gaussian each view sees, measured with the renderer itself."""

from collections.abc import Callable
from typing import TypeAlias

import torch
from jaxtyping import BFloat16
from torch import Tensor

from splatwire.errors import InvalidValueError
from splatwire.exporters.neural import Slots, slot_view
from splatwire.model import AnchorScene
from splatwire.model.gaussian_heads import visible_anchors
from splatwire.scene import Cameras, Gaussians

GHOST_OPACITY = 0.008
"""Gaussians that a view does not draw take part with this opacity, so that it is known whether they would be seen."""
MIN_ALPHA = 1 / 255
"""Renderers draw nothing fainter than this."""
Draw: TypeAlias = Callable[..., Tensor]
"""A differentiable `splatwire.render.base.Renderer`, passed in: exporters and renderers do not know each other."""


def visible_areas(
    scene: AnchorScene, slots: Slots, cameras: Cameras, draw: Draw, progress: Callable[[float], None] | None = None
) -> BFloat16[Tensor, "C S"]:
    """Measures the area of each Gaussian that reaches the eye in each view, in square pixels.

    The gradient of a picture's sum with respect to a Gaussian's colour is the sum of its blending weights, opacity
    times what is let through by all in front of it. Divided by the opacity (less the 1/255 under which nothing is
    drawn) that is an area which does not depend on the opacity itself.

    Args:
        scene: The scene.
        slots: Its Gaussians.
        cameras: The views.
        draw: The renderer.
        progress: Called with the share of views done.

    Raises:
        InvalidValueError: If no view sees anything.
    """
    areas = torch.zeros(cameras.num_views, slots.num_slots, dtype=torch.bfloat16)
    for view in range(cameras.num_views):
        center = torch.as_tensor(cameras.centers[view]).to(slots.means)
        seen = visible_anchors(scene.anchors, cameras, view)[slots.anchor_index].nonzero()[:, 0]
        part = Slots(slots.anchor_index[seen], slots.offset_index[seen], slots.means[seen])
        if part.num_slots:
            now = slot_view(scene, part, center)
            opacities = now.opacities.clamp(min=GHOST_OPACITY)
            colors = torch.zeros_like(now.colors, requires_grad=True)
            gaussians = Gaussians(part.means, now.quats, now.scales, opacities, colors)
            picture = draw(gaussians, cameras.select([view]), background=torch.zeros(3))
            (weights,) = torch.autograd.grad(picture.sum(), colors)
            areas[view, seen] = (weights[:, 0] / (opacities - MIN_ALPHA)).to(torch.bfloat16)
        if progress is not None:
            progress((view + 1) / cameras.num_views)
    if not bool((areas > 0).any()):
        raise InvalidValueError("none of the views sees anything of the scene")
    return areas
