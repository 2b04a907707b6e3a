"""Sorts Gaussians into the chunks of a compressed PLY so that the rounding errors of their positions are small.

A chunk has 256 Gaussians, and its extent determines the quantisation steps of their positions. Dense details are
therefore kept apart from distant Gaussians.
"""

import numpy as np

from splatwire.io.formats.outliers import FINE_DIVISOR, local_scales, morton_order
from splatwire.types.splats import Splats

CHUNK = 256
WIDTHS = (11, 10, 11)
"""Number of bits of the x, y and z coordinates of a position."""
_LOOSER = (1, 2, 4, 8)
"""Factors on the error limit, tried in ascending order until few enough Gaussians are padding."""
_MAX_PADDING, _MAX_SHARE = 16 * CHUNK, 1 / 16
"""Maximum number of padding Gaussians, and their maximum share of all Gaussians; the larger limit applies."""
_CLASS = 8.0
"""Ratio of the largest to the smallest local scale within a sorting class."""


def assign_chunks(splats: Splats) -> tuple[np.ndarray, np.ndarray]:
    """Distributes Gaussians over the chunks of a compressed PLY so that few positions are rounded visibly.

    Positions are quantised within the extent of their chunk of 256 rows. The Gaussians of chunks with visible errors
    are sorted again and divided into new chunks. Unused rows of the new chunks are filled with copies (padding).

    Args:
        splats: The Gaussians, sorted along a space-filling curve.

    Returns:
        Two arrays: for each row of the file, the index of the input Gaussian, int64 (M); and the mask of the rows that
        are padding, bool (M).
    """
    count = splats.num_gaussians
    rows, chunk = np.arange(count), np.arange(count) // CHUNK
    errors = position_errors(splats.means.astype(np.float64))
    unsure = np.flatnonzero(
        errors > np.median(splats.scales, axis=1) / FINE_DIVISOR
    )  # skips neighbour searches for others
    scales = local_scales(splats, unsure)
    coarse = np.unique(chunk[unsure[errors[unsure] > scales / FINE_DIVISOR]])
    if not len(coarse):
        return rows, np.zeros(count, bool)
    last = np.array([chunk[-1]] if count % CHUNK else [], np.int64)  # only the last chunk may have fewer rows
    again = np.isin(chunk, np.union1d(coarse, last))
    index, filling = _cut_into_chunks(splats, rows[again], max(_MAX_PADDING, int(_MAX_SHARE * count)))
    return np.concatenate([rows[~again], index]), np.concatenate([np.zeros(int((~again).sum()), bool), filling])


def position_errors(means: np.ndarray) -> np.ndarray:
    """Returns the largest possible quantisation error of each position along any axis, world units, float64 (N).

    Args:
        means: Centres in the order of the file, 256 for each chunk, float64 (N, 3).
    """
    starts = np.arange(0, len(means), CHUNK)
    spans = np.maximum.reduceat(means, starts) - np.minimum.reduceat(means, starts)
    return np.repeat(_half_steps(spans), CHUNK)[: len(means)]


def _half_steps(spans: np.ndarray) -> np.ndarray:
    return np.asarray((spans / (2 * (2.0 ** np.array(WIDTHS) - 1))).max(axis=1))


def _cut_into_chunks(splats: Splats, rows: np.ndarray, most_filled: int) -> tuple[np.ndarray, np.ndarray]:
    """Sorts Gaussians and divides the result into chunks with small quantisation errors of positions.

    A chunk has 256 rows. A chunk with fewer Gaussians is filled with copies of its last Gaussian (padding). Only the
    last chunk stays short.

    Smaller errors need more chunks with fewer Gaussians, and thus more padding. If the total padding would exceed
    `most_filled`, larger errors are accepted.

    Args:
        splats: All Gaussians.
        rows: Indices of the Gaussians to sort and cut, int64 (n).
        most_filled: Maximum number of padding rows in all chunks together.

    Returns:
        Index into `splats` for each row of the file, int64 (m); and mask of the rows that are padding, bool (m).
    """
    means, scales = splats.means[rows].astype(np.float64), local_scales(splats, rows)
    classes = np.floor(np.log(np.maximum(scales, 1e-30)) / np.log(_CLASS)).astype(np.int64)
    order = morton_order(means)
    order = order[np.argsort(classes[order], kind="stable")]
    for factor in _LOOSER:
        lengths = _chunk_lengths(means[order], scales[order] * (factor / FINE_DIVISOR))
        if CHUNK * len(lengths) - len(rows) <= most_filled:
            break
    else:
        lengths = [CHUNK] * (len(rows) // CHUNK) + [len(rows) % CHUNK] * (len(rows) % CHUNK > 0)
    index, filling, begin = [], [], 0
    for number, length in enumerate(lengths):
        missing = 0 if number == len(lengths) - 1 else CHUNK - length
        members = order[begin : begin + length]
        index += [members, np.repeat(members[-1:], missing)]
        filling += [np.zeros(length, bool), np.ones(missing, bool)]
        begin += length
    return rows[np.concatenate(index)], np.concatenate(filling)


def _chunk_lengths(means: np.ndarray, limits: np.ndarray) -> list[int]:
    """Divides sorted Gaussians into chunks so that the rounding of each position stays within a given limit.

    Args:
        means: Centres in the order of the file, world units, float64 (n, 3).
        limits: Maximum rounding error of each Gaussian, world units, float64 (n).

    Returns:
        Number of Gaussians of each chunk.
    """
    lengths, begin = [], 0
    while begin < len(means):
        piece, limit = means[begin : begin + CHUNK], np.minimum.accumulate(limits[begin : begin + CHUNK])
        spans = np.maximum.accumulate(piece) - np.minimum.accumulate(piece)
        beyond = np.flatnonzero(_half_steps(spans) > limit)
        length = max(1, int(beyond[0])) if len(beyond) else len(piece)
        lengths.append(length)
        begin += length
    return lengths
