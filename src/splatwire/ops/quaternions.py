"""Quaternions (w, x, y, z)."""

import torch
from jaxtyping import Float
from torch import Tensor


def multiply(first: Float[Tensor, "N 4"], second: Float[Tensor, "N 4"]) -> Float[Tensor, "N 4"]:
    """Hamilton products: the rotation `second`, then `first`."""
    a, b, c, d = first.unbind(dim=1)
    w, x, y, z = second.unbind(dim=1)
    return torch.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        dim=1,
    )
