"""The joint weighting of CARI: which neighbours are trusted, and how much."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor


@dataclass(frozen=True)
class ScoreExponents:
    """Exponents of the shared factors of the score.

    Attributes:
        distance: alpha of `w_geo = (d + epsilon) ** (-alpha / 2)`.
        context: beta of `w_ctx = h ** beta`.
        signature: delta of `w_sig = rho ** delta`.
        epsilon: Added to distances and to the sum of the scores.
    """

    distance: float
    context: float
    signature: float
    epsilon: float


@dataclass(frozen=True, eq=False)
class Support:
    """What the score needs to know about all N anchors.

    Attributes:
        context: Hash-grid features of length 1 (or 0).
        signature: Signatures of length 1 (or 0).
        reliability: `w_unc * w_conf` per group.
    """

    context: Float[Tensor, "N H"]
    signature: Float[Tensor, "N S"]
    reliability: Float[Tensor, "N G"]


@dataclass(frozen=True, eq=False)
class Selection:
    """The strongest neighbours of each query, per group.

    Attributes:
        index: Anchors; where there are fewer than k candidates the rest repeats one with weight 0.
        weight: Their normalised weights, not negative; they sum to `sum / (sum + epsilon)`, or to 0 without support.
    """

    index: Int64[Tensor, "Q G k"]
    weight: Float[Tensor, "Q G k"]


def select_neighbors(
    support: Support,
    queries: Int64[Tensor, "Q"],
    candidates: Int64[Tensor, "Q L"],
    distance: Float[Tensor, "Q L"],
    keep: int,
    exponents: ScoreExponents,
    backend: str = "numba",
) -> Selection:
    """Scores candidates with `u = w_geo w_ctx w_unc w_conf w_sig` and keeps the strongest (paper, Section 3.3).

    Args:
        support: All anchors.
        queries: The anchors to conceal.
        candidates: Their candidates, nearest first; equal scores go to the nearer one.
        distance: Distances of the candidates.
        keep: How many to keep, K.
        exponents: Constants of the score.
        backend: `numba` (compiled) or `torch` (the plain version that it must agree with).
    """
    keep = min(keep, candidates.shape[1])
    groups = support.reliability.shape[1]
    if keep == 0 or len(queries) == 0:
        empty = candidates.new_zeros(len(queries), groups, keep)
        return Selection(empty, empty.to(distance.dtype))
    score = _select_compiled if backend == "numba" else _select_plain
    index, strength = score(support, queries, candidates, distance, keep, exponents)
    return Selection(index, strength / (strength.sum(dim=2, keepdim=True) + exponents.epsilon))


def _select_plain(
    support: Support, queries: Tensor, candidates: Tensor, distance: Tensor, keep: int, exponents: ScoreExponents
) -> tuple[Tensor, Tensor]:
    h = _similarity(support.context, queries, candidates)
    rho = _similarity(support.signature, queries, candidates)
    shared = (distance + exponents.epsilon) ** (-exponents.distance / 2)
    shared = shared * h**exponents.context * rho**exponents.signature
    u = (shared[:, :, None] * support.reliability[candidates]).transpose(1, 2)
    u, order = u.sort(dim=2, descending=True, stable=True)
    index = candidates[:, None].expand(-1, u.shape[1], -1).gather(2, order[:, :, :keep])
    return index, u[:, :, :keep]


def _similarity(unit: Tensor, queries: Tensor, candidates: Tensor) -> Tensor:
    """`(CosSim + 1) / 2`, kept in [0, 1] against rounding."""
    cosine = torch.einsum("qd,qld->ql", unit[queries], unit[candidates])
    return ((cosine + 1) / 2).clamp(0, 1)


def _select_compiled(
    support: Support, queries: Tensor, candidates: Tensor, distance: Tensor, keep: int, exponents: ScoreExponents
) -> tuple[Tensor, Tensor]:
    from splatwire.paper._cari_kernels import score_and_keep

    index, strength = score_and_keep(
        support.context.contiguous().numpy(),
        support.signature.contiguous().numpy(),
        support.reliability.contiguous().numpy(),
        queries.numpy(),
        candidates.contiguous().numpy(),
        distance.contiguous().numpy(),
        keep,
        np.array(
            [-exponents.distance / 2, exponents.context, exponents.signature, exponents.epsilon], dtype=np.float32
        ),
    )
    return torch.from_numpy(index), torch.from_numpy(strength)
