"""Tables of contexts from how often what was coded."""

import numpy as np
from scipy.special import ndtr

from splatwire.codec.schemas.gaussians.layout import (
    EIGHTHS,
    NARROW_WEIGHT,
    NUM_CONTEXTS,
    SCALE_UNIT,
    SECONDS,
    SPREADS,
    STREAMS,
    WIDE,
)
from splatwire.entropy.tables import INVERSE_BITS, NUM_SCALES, inverse_scale_table

_TRUST = 4.0
"""A context of n residuals believes its own mean as much as what row and column expect once n is this large."""


def empty_statistics() -> tuple[np.ndarray, np.ndarray]:
    """What the kernels count: bits by context (contexts, 2), residuals and their magnitudes by table entry."""
    return np.zeros((NUM_CONTEXTS, 2), np.int64), np.zeros((len(STREAMS), SPREADS, SECONDS, 2), np.int64)


def fit_bits(counts: np.ndarray) -> np.ndarray:
    """Initial P(0) of each model out of 2**8, int64 (contexts)."""
    share = (counts[:, 0] + 0.5) / (counts.sum(axis=1) + 1.0)
    return np.clip(np.rint(share * 256), 1, 255).astype(np.int64)


def fit_scales(residuals: np.ndarray) -> np.ndarray:
    """Narrow scale of each context by its mean magnitude, in units of `SCALE_UNIT` entries, int64.

    An entry that nothing used is that of the context before, which costs nothing to send.
    """
    number, total = residuals[..., 0].astype(np.float64), residuals[..., 1].astype(np.float64)
    mean = (total + _TRUST * _products(number, total)) / (number + _TRUST)
    expected = _expected_magnitudes()
    scales = np.searchsorted((expected[1:] + expected[:-1]) / 2, mean)
    for second in range(SECONDS):
        unused = number[:, :, second] == 0
        scales[:, :, second][unused] = scales[:, :, second - 1][unused] if second else 0
    return scales.astype(np.int64)


def _products(number: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Means of contexts if each were a number of its row times one of its column, which agree with all sums."""
    rows, columns = (total.sum(axis=2) + 1.0) / (number.sum(axis=2) + 1.0), np.ones_like(number[:, 0])
    for _ in range(3):
        columns = (total.sum(axis=1) + 1.0) / ((number * rows[:, :, None]).sum(axis=1) + 1.0)
        rows = (total.sum(axis=2) + 1.0) / ((number * columns[:, None]).sum(axis=2) + 1.0)
    return rows[:, :, None] * columns[:, None]


def first_scales() -> np.ndarray:
    """Tables to begin with, before anything was counted."""
    return np.full((len(STREAMS), SPREADS, SECONDS), 24, dtype=np.int64)


def _expected_magnitudes() -> np.ndarray:
    """Mean magnitude of an integer under each scale's mixture, increasing; its mean is anywhere within half a step."""
    sigma = 2.0**INVERSE_BITS / inverse_scale_table()[np.arange(0, NUM_SCALES, SCALE_UNIT)]
    share, ratio, most = NARROW_WEIGHT / 65536, 2.0 ** (WIDE / 16), 1 << (int(EIGHTHS) - 1)
    edges = np.arange(64, dtype=np.float64)[:, None] + 0.5
    # Both tails: a mean above 0 is as far from the edges below as one below is from those above.
    edges = edges - np.arange(-most, most, dtype=np.float64) / (2 * most)
    means = []
    for s in sigma.tolist():
        small = [2 * float(ndtr(-edges / scale).sum(axis=0).mean()) for scale in (s, s * ratio)]
        large = [0.7978845608 * scale for scale in (s, s * ratio)]
        narrow, wide = (a if scale < 8 else b for a, b, scale in zip(small, large, (s, s * ratio), strict=True))
        means.append(share * narrow + (1 - share) * wide)
    return np.array(means)
