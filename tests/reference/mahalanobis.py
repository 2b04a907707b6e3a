"""Neighbours by Mahalanobis distance, without a search tree."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor


def plain_nearest(
    points: Float[Tensor, "S 3"], sizes: Float[Tensor, "S 3"], queries: Float[Tensor, "Q 3"], k: int
) -> tuple[Int64[Tensor, "Q kept"], Float[Tensor, "Q kept"]]:
    """Result of `MahalanobisSearch` by sorting every distance."""
    gaps = (queries.double()[:, None] - points.double()) / sizes.double()
    distance, index = torch.linalg.vector_norm(gaps, dim=2).sort(dim=1, stable=True)
    return index[:, :k], distance[:, :k].to(queries.dtype)
