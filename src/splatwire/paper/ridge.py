"""The optional ridge refinement of CARI's feature branch."""

import torch
from jaxtyping import Float
from torch import Tensor


def ridge_correction(
    offsets: Float[Tensor, "Q k 3"],
    residuals: Float[Tensor, "Q k D"],
    weight: Float[Tensor, "Q k"],
    strength: float,
) -> Float[Tensor, "Q D"]:
    """What a local linear model adds to the weighted mean of the neighbours' residuals.

    The paper only says "lightweight ridge-refinement"; this is our reading: `r(x) = mean + B (x - mean x)` is fitted by
    weighted least squares with penalty `strength * |B| ** 2`, positions in units of the neighbourhood's spread, and
    evaluated at the query. A large `strength` leaves the mean as it is.

    Args:
        offsets: Positions of the neighbours relative to the query.
        residuals: Their residuals.
        weight: Their weights.
        strength: Penalty, positive.
    """
    share = weight / weight.sum(dim=1, keepdim=True).clamp(min=torch.finfo(weight.dtype).tiny)
    center = torch.einsum("qk,qkd->qd", share, offsets)
    spread = torch.einsum("qk,qkd->q", share, (offsets - center[:, None]) ** 2).sqrt()
    unit = torch.where(spread > 0, spread, 1.0)[:, None]
    x = (offsets - center[:, None]) / unit[:, None]
    y = residuals - torch.einsum("qk,qkd->qd", share, residuals)[:, None]
    normal = torch.einsum("qk,qki,qkj->qij", share, x, x) + strength * torch.eye(3, dtype=x.dtype)
    slope = torch.linalg.solve(normal, torch.einsum("qk,qki,qkd->qid", share, x, y))
    return torch.einsum("qi,qid->qd", -center / unit, slope)
