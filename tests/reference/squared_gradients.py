"""Plain sum of squared gradients of one picture, for each Gaussian and attribute: the reference of `add_squared`."""

import torch
from torch import Tensor


def squared(
    means: Tensor, rotations: Tensor, scales: Tensor, opacities: Tensor, colors: Tensor, splat_scales: Tensor,
    quats: Tensor, levels: Tensor, order: Tensor, spun: Tensor,
) -> Tensor:  # fmt: skip
    """Float64 (N, 8): position, the three scales (longest first), direction, spin, opacity, colour."""
    means, rotations, scales, opacities, colors = (g.double() for g in (means, rotations, scales, opacities, colors))
    sizes = ((scales * splat_scales) ** 2).gather(1, order)
    turns = [(rotations * half_product(quats, axis)).sum(dim=1) ** 2 for axis in range(3)]
    turned = torch.stack(turns, dim=1).gather(1, order)
    spin = turned.gather(1, spun[:, None])[:, 0]
    direction = (turned.sum(dim=1) - spin) / 2
    shown = (opacities * levels) ** 2
    columns = [(means**2).mean(dim=1), *sizes.unbind(dim=1), direction, spin, shown, (colors**2).sum(dim=1)]
    return torch.stack(columns, dim=1)


def half_product(quats: Tensor, axis: int) -> Tensor:
    """Derivative of unit quaternions (w, x, y, z) for a rotation about their own axis 0, 1 or 2."""
    w, x, y, z = quats.double().unbind(dim=1)
    columns = ([-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w])[axis]
    return torch.stack(columns, dim=1) / 2
