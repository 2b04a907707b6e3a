"""Gaussians that move from their bases, in plain torch and by SciPy's rotations."""

import torch
from scipy.spatial.transform import Rotation
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
        turned(rotation, splats.quats),
        splats.scales * gains.exp(),
        (splats.opacities * offsets[:, 9].exp()).clamp(max=1 - 1e-6),
        sh,
    )


def turned(turns: Tensor, quats: Tensor) -> Tensor:
    """Unit quaternions (N, 4), w first: `quats`, then turned."""
    first, second = (Rotation.from_quat(some.double().roll(-1, dims=1).numpy()) for some in (turns, quats))
    return torch.from_numpy((first * second).as_quat()).roll(1, dims=1).to(quats)
