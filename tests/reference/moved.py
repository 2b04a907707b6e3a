"""Gaussians that move from their bases, in plain torch."""

import torch
from torch import Tensor

from splatwire.scene.splats import Splats


def moved(splats: Splats, offsets: Tensor) -> Splats:
    """Gaussians that differ from these as `splatwire.model.clip.GroupMotion.at` says, (n, C)."""
    turn, order = offsets[:, 3:6] / 4, (-splats.scales).argsort(dim=1, stable=True)
    square = (turn * turn).sum(dim=1, keepdim=True)
    rotation = torch.cat([1 - square, 2 * turn], dim=1) / (1 + square)
    gains = torch.zeros_like(splats.scales).scatter(1, order, offsets[:, 6:9])
    sh = splats.sh.clone()
    sh[:, 0] += offsets[:, 10:]
    return Splats(
        splats.means + offsets[:, :3],
        torch.nn.functional.normalize(multiply(rotation, splats.quats), dim=1),
        splats.scales * gains.exp(),
        (splats.opacities * offsets[:, 9].exp()).clamp(max=1 - 1e-6),
        sh,
    )


def multiply(first: Tensor, second: Tensor) -> Tensor:
    """Hamilton products (N, 4): the rotation `second`, then `first`."""
    a, b, c, d = first.unbind(dim=1)
    w, x, y, z = second.unbind(dim=1)
    rows = [
        a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w,
    ]  # fmt: skip
    return torch.stack(rows, dim=1)
