"""Code books of numbers and of vectors for quantisation, computed in time linear in the data."""

import numpy as np

_QUANTILES = 1024
_ROUNDS_1D, _ROUNDS = 30, 8
_REPAIRS = 12
"""Maximum number of rounds that relocate unused entries; each round doubles the entries in use."""
_BRANCHES = 256
_CHUNK = 1 << 24
"""Maximum number of distances that are computed at once."""


def number_codebook(values: np.ndarray, size: int) -> np.ndarray:
    """Finds a code book of numbers that represent given values with a small mean squared error (Lloyd algorithm).

    Args:
        values: The values, at least one.
        size: Number of entries.

    Returns:
        float32 (size), ascending.
    """
    distinct = np.unique(values)
    if len(distinct) <= size:  # lossless
        return np.pad(distinct, (0, size - len(distinct)), "edge").astype(np.float32)
    ordered = np.sort(values.astype(np.float64).ravel())
    edges = np.quantile(ordered, np.linspace(0, 1, _QUANTILES + 1))
    # initial density: cube root of that of the values, optimal for fine quantisation (Panter and Dite, 1951)
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
    """Divides sorted values into ranges that have the same nearest entry of a code book.

    Args:
        ordered: The values, ascending.
        centers: Entries of the code book, ascending.

    Returns:
        Bounds of the ranges as indices into `ordered`, int64 (entries + 1). The range of entry `i` starts at bound `i`
        and ends before bound `i + 1`.
    """
    return np.concatenate([[0], np.searchsorted(ordered, (centers[1:] + centers[:-1]) / 2), [len(ordered)]])


def _repaired(ordered: np.ndarray, centers: np.ndarray) -> tuple[np.ndarray, bool]:
    """Moves unused entries of a code book to where the quantisation error is largest.

    An entry is unused if it is not the nearest entry of any value.

    Args:
        ordered: The values, ascending.
        centers: Entries of the code book, ascending.

    Returns:
        The entries, ascending, and True if any was moved.
    """
    ends = _cells(ordered, centers)
    number = np.diff(ends)
    first, last = ordered[ends[:-1].clip(max=len(ordered) - 1)], ordered[(ends[1:] - 1).clip(min=0)]
    errors = np.where(number > 0, number * (last - first) ** 2, 0)
    empty, worst = np.flatnonzero(number == 0), np.argsort(-errors, kind="stable")
    worst = worst[errors[worst] > 0][: len(empty)]
    repaired = centers.copy()
    repaired[worst] = first[worst] + (last - first)[worst] / 4
    repaired[empty[: len(worst)]] = first[worst] + (last - first)[worst] * 3 / 4
    return np.sort(repaired), len(worst) > 0


def nearest_number(values: np.ndarray, codebook: np.ndarray) -> np.ndarray:
    """Finds the code book entry that is nearest to each value; returns indices into the code book, uint8.

    Args:
        values: The values, any shape.
        codebook: Entries of the code book, ascending, at most 256.
    """
    return np.searchsorted((codebook[1:] + codebook[:-1]) / 2, values).astype(np.uint8)


def vector_palette(vectors: np.ndarray, size: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Finds a palette of vectors that approximates given vectors, by k-means on two levels.

    Args:
        vectors: float32 (N, d).
        size: Maximum number of vectors.
        seed: Seed of the initial centres.

    Returns:
        Palette (at most size, d), and the entry of each vector, int64 (N).
    """
    rng = np.random.default_rng(seed)
    if len(vectors) <= size:
        return vectors.copy(), np.arange(len(vectors))
    distinct, index = np.unique(vectors, axis=0, return_inverse=True)
    if len(distinct) <= size:
        return distinct, index.reshape(-1)
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
    half, rows = (centers**2).sum(axis=1) / 2, max(_CHUNK // len(centers), 1)
    parts = [(half - part @ centers.T).argmin(axis=1) for part in np.split(vectors, range(rows, len(vectors), rows))]
    return np.concatenate(parts)
