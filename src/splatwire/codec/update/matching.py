"""Finds the Gaussians of an edited scene that are unchanged since it was encoded."""

import numpy as np

from splatwire.bitstream import splitmix64
from splatwire.codec.gaussians.rounding import round_splats
from splatwire.types import SplatCoding
from splatwire.types.splats import Splats


def find_unchanged(
    before: Splats, coding: SplatCoding, after: Splats, coarsest_class: np.ndarray | None = None
) -> np.ndarray:
    """Finds the Gaussians of an edited scene that are already in a stream.

    A Gaussian of the edited scene is unchanged if it equals a Gaussian of the stream after rounding with the same
    quantisation steps. Each Gaussian of the stream is found at most once.

    Args:
        before: Decoded Gaussians of the stream.
        coding: Quantisation steps and precision classes of the stream's Gaussians.
        after: The M Gaussians of the edited scene, with spherical harmonics of the same degree.
        coarsest_class: Coarsest precision class (set of quantisation steps) that is accepted for each Gaussian of
            `after`, uint8 (M); class 0 is the coarsest of all. A Gaussian of `after` is not matched with a Gaussian of
            the stream whose class is coarser. None to accept any class.

    Returns:
        Index in `before` of each Gaussian of `after`, int64 (M); -1 for new and changed Gaussians.
    """
    match = np.full(after.num_gaussians, -1, np.int64)
    for level in np.unique(coding.precision_classes)[::-1]:
        allowed = True if coarsest_class is None else coarsest_class <= level
        candidates, unmatched = np.flatnonzero(coding.precision_classes == level), np.flatnonzero((match < 0) & allowed)
        if not len(unmatched):
            continue
        classes = np.full(len(unmatched), level, np.uint8)
        steps = SplatCoding(**{**vars(coding), "precision_classes": classes})
        rounded = _attribute_rows(round_splats(after.select(unmatched), steps))
        # The same rounding for both, so that the few positions that it moves are found, too.
        steps = SplatCoding(**{**vars(coding), "precision_classes": coding.precision_classes[candidates]})
        rounded_before = _attribute_rows(round_splats(before.select(candidates), steps))
        rows = _find_rows(rounded_before, rounded)
        match[unmatched[rows >= 0]] = candidates[rows[rows >= 0]]
    return match


def _attribute_rows(splats: Splats) -> np.ndarray:
    """Returns the attributes of each Gaussian as one row, uint32 (N, columns); equal Gaussians have equal rows."""
    columns = [values.reshape(splats.num_gaussians, -1) for values in vars(splats).values()]
    return np.ascontiguousarray(np.concatenate(columns, axis=1, dtype=np.float32) + np.float32(0)).view(np.uint32)


def _find_rows(targets: np.ndarray, queries: np.ndarray) -> np.ndarray:
    """Finds an equal row in `targets` for each row of `queries`; each row of `targets` is used at most once.

    Returns:
        Index in `targets` for each row of `queries`, int64; -1 if there is none.
    """
    hashes = [_hashes(rows) for rows in (targets, queries)]
    orders = [np.argsort(each, kind="stable") for each in hashes]
    sorted_hashes = [each[order] for each, order in zip(hashes, orders, strict=True)]
    # The n-th of several equal rows is matched with the n-th of the others.
    number = np.arange(len(queries)) - np.searchsorted(sorted_hashes[1], sorted_hashes[1], side="left")
    position = np.searchsorted(sorted_hashes[0], sorted_hashes[1], side="left") + number
    inside = position < len(targets)
    candidates = orders[0][np.where(inside, position, 0)] if len(targets) else np.zeros(len(queries), np.int64)
    match = np.full(len(queries), -1, np.int64)
    if len(targets):
        equal = inside & (targets[candidates] == queries[orders[1]]).all(axis=1)
        match[orders[1][equal]] = candidates[equal]
    return match


def _hashes(rows: np.ndarray) -> np.ndarray:
    hashes = np.zeros(len(rows), np.uint64)
    for column in rows.T:
        hashes = splitmix64(hashes ^ column.astype(np.uint64))
    return hashes
