"""Joint weighting of CARI: scores the neighbours of lost anchors, selects the best, and computes their weights.

CARI is Context-Aware Residual Interpolation, a concealer of lost anchors (`paper.cari`).
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from splatwire.paper._cari_kernels import score_and_keep


@dataclass(frozen=True)
class ScoreExponents:
    """Exponents in a neighbour's score, the same for all attribute groups.

    Attributes:
        distance: alpha of `w_geo = (d + epsilon) ** (-alpha / 2)`, with the distance d.
        context: beta of `w_ctx = h ** beta`, with the similarity h of the hash-grid features.
        signature: delta of `w_sig = rho ** delta`, with the similarity rho of the residual signatures.
        epsilon: Added to distances and to the sum of the scores.
    """

    distance: float
    context: float
    signature: float
    epsilon: float


@dataclass(frozen=True, eq=False)
class Support:
    """Properties of all N anchors that determine their scores as neighbours of a lost anchor in CARI.

    CARI (Context-Aware Residual Interpolation) conceals lost anchors. The signature of an anchor contains the mean
    residual of each group of its attribute channels.

    Attributes:
        context: Hash-grid feature of each anchor, normalised to length 1.
        signature: Signature of each anchor, normalised to length 1.
        reliability: Factor of the score that depends on the neighbour only, for each of G attribute groups.
    """

    # Zero vectors remain zero. The reliability is lower if the neighbour's prior is uncertain (`w_unc`) or the
    # neighbour is itself concealed (`w_conf`).

    context: Float[Tensor, "N H"]
    signature: Float[Tensor, "N S"]
    reliability: Float[Tensor, "N G"]


@dataclass(frozen=True, eq=False)
class Selection:
    """The neighbours with the highest scores for each lost anchor (query), per attribute group.

    Attributes:
        index: Index in the scene of each neighbour.
        weight: Weights of the neighbours, not negative, with a sum of about 1.
    """

    # With fewer than k candidates, the remaining entries repeat a candidate, with weight 0. With the sum S of the
    # scores, the weights sum to `S / (S + epsilon)`.

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
    """Selects the candidates with the highest scores as neighbours of each lost anchor (query).

    The score is the product of five factors: `u = w_geo w_ctx w_unc w_conf w_sig` (Section 3.3 of the paper). `w_geo`
    depends on distance, `w_ctx` on the similarity of hash-grid features, and `w_sig` on the similarity of residual
    signatures. `w_unc` is lower for candidates with an uncertain prior, and `w_conf` for candidates that are themselves
    concealed.

    Args:
        support: Properties of all anchors that determine scores.
        queries: Indices of the lost anchors to conceal.
        candidates: Anchor indices of the candidates of each query, nearest first.
        distance: Distances of the candidates from the query.
        keep: Number of neighbours to select per query, K.
        exponents: Exponents of the factors, and the constant epsilon that prevents division by zero.
        backend: `numba` (compiled) or `torch` (reference).
    """
    # Of candidates with equal scores, the nearer candidate is preferred.
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
    """Returns the cosine similarity of each query and candidate, mapped from [-1, 1] to [0, 1]."""
    cosine = torch.einsum("qd,qld->ql", unit[queries], unit[candidates])
    return ((cosine + 1) / 2).clamp(0, 1)


def _select_compiled(
    support: Support, queries: Tensor, candidates: Tensor, distance: Tensor, keep: int, exponents: ScoreExponents
) -> tuple[Tensor, Tensor]:
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
