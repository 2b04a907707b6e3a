"""Optional refinement of interpolated features: a local linear model instead of the weighted mean.

The interpolation is CARI, Context-Aware Residual Interpolation (`paper.cari`).
"""

import torch
from jaxtyping import Float
from torch import Tensor


def ridge_correction(
    offsets: Float[Tensor, "Q k 3"],
    residuals: Float[Tensor, "Q k D"],
    weight: Float[Tensor, "Q k"],
    strength: float,
) -> Float[Tensor, "Q D"]:
    """Computes a correction of the interpolated residual of each lost anchor (query), with a local linear model.

    A linear function of the position, with slope B, is fitted to the neighbours' residuals by weighted least squares,
    with the penalty `strength * |B| ** 2`.

    Args:
        offsets: Positions of the neighbours relative to the query.
        residuals: Residuals of the neighbours.
        weight: Weights of the neighbours.
        strength: Weight of the penalty, positive.

    Returns:
        Correction to add to the weighted mean of the neighbours' residuals.
    """
    # Positions are in units of the standard deviation of the neighbours' positions. The correction is the value of
    # the function at the query minus the weighted mean of the residuals. With a large penalty, it approaches 0.
    # This is our interpretation of the paper's "lightweight ridge-refinement".
    share = weight / weight.sum(dim=1, keepdim=True).clamp(min=torch.finfo(weight.dtype).tiny)
    center = torch.einsum("qk,qkd->qd", share, offsets)
    spread = torch.einsum("qk,qkd->q", share, (offsets - center[:, None]) ** 2).sqrt()
    unit = torch.where(spread > 0, spread, 1.0)[:, None]
    x = (offsets - center[:, None]) / unit[:, None]
    y = residuals - torch.einsum("qk,qkd->qd", share, residuals)[:, None]
    normal = torch.einsum("qk,qki,qkj->qij", share, x, x) + strength * torch.eye(3, dtype=x.dtype)
    slope = torch.linalg.solve(normal, torch.einsum("qk,qki,qkd->qid", share, x, y))
    return torch.einsum("qi,qid->qd", -center / unit, slope)
