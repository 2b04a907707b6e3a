"""Code books of a few numbers or vectors, found in a time that grows with the data only."""

import numpy as np

_QUANTILES = 1024
_ROUNDS_1D, _ROUNDS = 30, 8
_REPAIRS = 12
"""Maximum number of times that entries without values are moved: each doubles the entries among the values."""
_BRANCHES = 256
_CHUNK = 1 << 16


def number_codebook(values: np.ndarray, size: int) -> np.ndarray:
    """Finds numbers that stand for others with a small mean squared error (Lloyd's algorithm in one dimension).

    It starts where the density to the power of 1/3 says, the optimum of fine quantisation (Panter and Dite, 1951).

    Args:
        values: Any number of numbers, at least one.
        size: How many numbers to find.

    Returns:
        float32 (size), ascending.
    """
    distinct = np.unique(values)
    if len(distinct) <= size:  # nothing is lost
        return np.pad(distinct, (0, size - len(distinct)), "edge").astype(np.float32)
    ordered = np.sort(values.astype(np.float64).ravel())
    edges = np.quantile(ordered, np.linspace(0, 1, _QUANTILES + 1))
    share = np.concatenate([[0.0], np.cumsum(np.diff(edges) ** (2 / 3))])  # density is 1 / width between quantiles
    centers = np.interp((np.arange(size) + 0.5) / size * share[-1], share, edges)
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    for _ in range(_REPAIRS):
        for _ in range(_ROUNDS_1D):
            ends = _cells(ordered, centers)
            number = np.diff(ends)
            centers = np.where(number > 0, np.diff(sums[ends]) / np.maximum(number, 1), centers)
        centers, moved = _repaired(ordered, np.sort(centers))
        if not moved:
            break
    return np.sort(centers).astype(np.float32)


def _cells(ordered: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Bounds among ascending values of those that are nearest to each center, int64 (size + 1)."""
    return np.concatenate([[0], np.searchsorted(ordered, (centers[1:] + centers[:-1]) / 2), [len(ordered)]])


def _repaired(ordered: np.ndarray, centers: np.ndarray) -> tuple[np.ndarray, bool]:
    """Moves entries without values, as outliers leave them in gaps, into the cells with the largest errors.

    Returns:
        The entries, ascending, and True if any was moved.
    """
    ends = _cells(ordered, centers)
    number = np.diff(ends)
    first, last = ordered[ends[:-1].clip(max=len(ordered) - 1)], ordered[(ends[1:] - 1).clip(min=0)]
    errors = np.where(number > 0, number * (last - first) ** 2, 0)
    empty, worst = np.flatnonzero(number == 0), np.argsort(-errors, kind="stable")
    worst = worst[errors[worst] > 0][: len(empty)]
    found = centers.copy()
    found[worst] = first[worst] + (last - first)[worst] / 4
    found[empty[: len(worst)]] = first[worst] + (last - first)[worst] * 3 / 4
    return np.sort(found), len(worst) > 0


def nearest_number(values: np.ndarray, codebook: np.ndarray) -> np.ndarray:
    """Index of the nearest entry of an ascending code book, uint8 where it has at most 256."""
    return np.searchsorted((codebook[1:] + codebook[:-1]) / 2, values).astype(np.uint8)


def vector_palette(vectors: np.ndarray, size: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Finds vectors that stand for others: k-means on two levels, so that a large palette needs no long search.

    Args:
        vectors: float32 (N, d).
        size: Most vectors to find.
        seed: Of the first guess.

    Returns:
        Palette (at most size, d), and the entry of each vector, int64 (N).
    """
    rng = np.random.default_rng(seed)
    if len(vectors) <= size:
        return vectors.copy(), np.arange(len(vectors))
    _, branch = _k_means(vectors, min(_BRANCHES, size), rng)
    counts = np.bincount(branch)
    order = np.argsort(branch, kind="stable")
    palette, labels, used = [], np.empty(len(vectors), np.int64), 0
    for members in np.split(order, np.cumsum(counts)[:-1]):
        if not len(members):
            continue
        children = max(1, min(len(members), size * len(members) // len(vectors)))
        centers, label = _k_means(vectors[members], children, rng)
        labels[members] = used + label
        palette.append(centers)
        used += len(centers)
    return np.concatenate(palette), labels


def _k_means(vectors: np.ndarray, size: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    centers = vectors[rng.permutation(len(vectors))[:size]].copy()
    for _ in range(_ROUNDS):
        label = _nearest(vectors, centers)
        counts = np.bincount(label, minlength=size)
        sums = np.stack([np.bincount(label, weights=column, minlength=size) for column in vectors.T], axis=1)
        centers = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], centers).astype(np.float32)
    return centers, _nearest(vectors, centers)


def _nearest(vectors: np.ndarray, centers: np.ndarray) -> np.ndarray:
    half = (centers**2).sum(axis=1) / 2
    parts = [
        (half - part @ centers.T).argmin(axis=1) for part in np.split(vectors, range(_CHUNK, len(vectors), _CHUNK))
    ]
    return np.concatenate(parts)
