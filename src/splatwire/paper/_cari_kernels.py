"""Compiled scoring of CARI. What it must compute is `splatwire.paper.weighting._select_plain`.

Every query is on its own, so results do not depend on how queries are shared among threads.
"""

from typing import no_type_check

import numpy as np
from numba import prange

from splatwire.ops.compiled import njit

_FAST = {"contract", "reassoc", "nsz"}  # sums of products in any order; NaN and infinity keep their meaning
_BATCH = 64


@njit(fastmath=_FAST)
@no_type_check
def _similarity(a, b):
    """`(a . b + 1) / 2` of unit vectors, kept in [0, 1] against rounding."""
    total = np.float32(0)
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return min(max((total + np.float32(1)) * np.float32(0.5), np.float32(0)), np.float32(1))


@njit()
@no_type_check
def _power(base, exponent):
    """`base ** exponent`, without the general power where the paper's constants do not need it."""
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
    """Puts a candidate into the descending list, behind its equals; the weakest falls out."""
    place = strength.shape[0] - 1
    while place > 0 and strength[place - 1] < u:
        strength[place] = strength[place - 1]
        index[place] = index[place - 1]
        place -= 1
    strength[place] = u
    index[place] = candidate


@njit()
@no_type_check
def _score_query(context, signature, reliability, query, candidates, distance, exponents, index, strength):
    """Fills the lists of one query: `index` and `strength`, (groups, keep)."""
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
                for place in range(index.shape[2]):
                    index[q, g, place] = candidates[q, 0]
                    strength[q, g, place] = -1
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
    """Scores candidates and keeps the strongest per group.

    Args:
        context: float32 (N, H), unit rows.
        signature: float32 (N, S), unit rows.
        reliability: float32 (N, G).
        queries: int64 (Q).
        candidates: int64 (Q, L).
        distance: float32 (Q, L).
        keep: At most L.
        exponents: float32 (4): powers of `distance + epsilon`, of the context and the signature similarity; epsilon.

    Returns:
        Anchors, int64 (Q, G, keep), and scores, float32 (Q, G, keep), strongest first.
    """
    index = np.empty((len(queries), reliability.shape[1], keep), np.int64)
    strength = np.empty(index.shape, np.float32)
    _score_all(context, signature, reliability, queries, candidates, distance, exponents, index, strength)
    return index, strength
