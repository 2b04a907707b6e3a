"""Compiled kernels that choose the neighbours from which a lost anchor is interpolated.

The interpolation is CARI, Context-Aware Residual Interpolation (`paper.cari`).
"""

# Results equal those of `splatwire.paper.weighting._select_plain`. Lost anchors (queries) are processed independently,
# so results do not depend on the number of threads.

from typing import no_type_check

import numpy as np
from numba import prange

from splatwire.ops.compiled import njit

_FAST = {"contract", "reassoc", "nsz"}  # the compiler may reorder sums, but must handle NaN and infinity correctly
_BATCH = 64


@njit(fastmath=_FAST)
@no_type_check
def _similarity(a, b):
    """Returns the cosine similarity of two unit vectors, mapped from [-1, 1] to [0, 1]: `(a . b + 1) / 2`."""
    total = np.float32(0)
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return min(max((total + np.float32(1)) * np.float32(0.5), np.float32(0)), np.float32(1))


@njit()
@no_type_check
def _power(base, exponent):
    """Returns `base ** exponent`."""
    # Fast for the exponents 2, 1.5 and -0.5, which the paper uses.
    if exponent == np.float32(2):
        return base * base
    if exponent == np.float32(1.5):
        return base * np.sqrt(base)
    if exponent == np.float32(-0.5):
        return np.float32(1) / np.sqrt(base)
    return base**exponent


@njit()
@no_type_check
def _insert(index, strength, candidate, u):
    """Inserts an anchor into a list sorted by descending score, and drops the last anchor of the list.

    Args:
        index: Indices of the listed anchors, changed in place.
        strength: Scores of the listed anchors, changed in place.
        candidate: Index of the anchor to insert.
        u: Score of this anchor.
    """
    # Behind entries of equal score.
    rank = strength.shape[0] - 1
    while rank > 0 and strength[rank - 1] < u:
        strength[rank] = strength[rank - 1]
        index[rank] = index[rank - 1]
        rank -= 1
    strength[rank] = u
    index[rank] = candidate


@njit()
@no_type_check
def _score_query(context, signature, reliability, query, candidates, distance, exponents, index, strength):
    """Scores the candidate neighbours of one lost anchor (query), and keeps the best ones for each attribute group.

    Args:
        context: Hash-grid feature of each anchor, a unit vector, float32 (N, H).
        signature: Normalised mean residuals of each anchor (its signature), float32 (N, S).
        reliability: Factor of the score that depends only on the candidate and the attribute group, float32 (N, G).
        query: Index of the lost anchor.
        candidates: Indices of its candidate anchors, int64 (L).
        distance: Distances of the candidates, float32 (L).
        exponents: Exponents of distance, context similarity and signature similarity; then epsilon, which is added to
            distances, float32 (4).
        index: Output: indices of the best candidates of each attribute group, best first, int64 (G, K).
        strength: Output: scores of the best candidates, float32 (G, K).
    """
    for c in range(candidates.shape[0]):
        k = candidates[c]
        shared = _power(distance[c] + exponents[3], exponents[0])
        shared *= _power(_similarity(context[query], context[k]), exponents[1])
        shared *= _power(_similarity(signature[query], signature[k]), exponents[2])
        for g in range(reliability.shape[1]):
            u = shared * reliability[k, g]
            if u > strength[g, -1]:
                _insert(index[g], strength[g], k, u)


@njit(parallel=True)
@no_type_check
def _score_all(context, signature, reliability, queries, candidates, distance, exponents, index, strength):
    for batch in prange((queries.shape[0] + _BATCH - 1) // _BATCH):
        for q in range(batch * _BATCH, min((batch + 1) * _BATCH, queries.shape[0])):
            for g in range(index.shape[1]):
                for rank in range(index.shape[2]):
                    index[q, g, rank] = candidates[q, 0]
                    strength[q, g, rank] = -1
            _score_query(
                context, signature, reliability, queries[q], candidates[q], distance[q], exponents,
                index[q], strength[q],
            )  # fmt: skip


def score_and_keep(
    context: np.ndarray,
    signature: np.ndarray,
    reliability: np.ndarray,
    queries: np.ndarray,
    candidates: np.ndarray,
    distance: np.ndarray,
    keep: int,
    exponents: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Chooses the neighbours from which CARI interpolates each lost anchor: the candidates with the highest scores.

    Each attribute group has its own neighbours.

    Args:
        context: Hash-grid feature of each anchor, a unit vector, float32 (N, H).
        signature: Normalised mean residuals of each anchor (its signature), float32 (N, S).
        reliability: Factor of the score that depends only on the candidate and the attribute group, float32 (N, G).
        queries: Indices of the lost anchors, int64 (Q).
        candidates: Indices of the candidate anchors of each query, int64 (Q, L).
        distance: Distances of the candidates, float32 (Q, L).
        keep: Number of candidates to keep, at most L.
        exponents: Exponents of distance, context similarity and signature similarity; then epsilon, which is added to
            distances, float32 (4).

    Returns:
        Anchor indices, int64 (Q, G, keep), and scores, float32 (Q, G, keep), highest score first.
    """
    # `splatwire.paper.weighting.select_neighbors` describes the score.
    index = np.empty((len(queries), reliability.shape[1], keep), np.int64)
    strength = np.empty(index.shape, np.float32)
    _score_all(context, signature, reliability, queries, candidates, distance, exponents, index, strength)
    return index, strength
