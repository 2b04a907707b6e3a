"""Codes arrays of integers under normal distributions fitted to them."""

import numpy as np
import numpy.typing as npt

from splatwire.entropy.coder import Mixtures, decode_symbols, encode_symbols
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES, SCALE_MIN_EXPONENT, SCALE_STEPS
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter

MAX_SYMBOL = 1 << 24


def scale_index(scale: npt.ArrayLike) -> np.ndarray:
    """Converts standard deviations to indices into the entropy coder's table of standard deviations.

    The nearest entry of the table is chosen.

    Args:
        scale: Standard deviations in quantisation steps, any shape.

    Returns:
        int64 of the same shape.
    """
    octaves = np.log2(np.maximum(np.asarray(scale, dtype=np.float64), 1e-9)) - SCALE_MIN_EXPONENT
    return np.asarray(np.clip(np.rint(octaves * SCALE_STEPS - 0.5), 0, NUM_SCALES - 1)).astype(np.int64)


def write_integers(writer: ByteWriter, values: np.ndarray) -> None:
    """Writes integers, entropy-coded under a normal distribution that is fitted to them.

    The output contains the mean and the standard deviation of the distribution, but not the number of integers.
    """
    mean = round(float(values.mean())) if len(values) else 0
    variance = ((values.astype(np.float64) - mean) ** 2).mean() if len(values) else 0.0
    scale = int(scale_index(np.sqrt(variance + 0.05))) if len(values) else 0
    writer.signed(mean)
    writer.unsigned(scale)
    writer.blob(encode_symbols(values.astype(np.int64), _normal(mean, scale, len(values))))


def read_integers(reader: ByteReader, count: int) -> np.ndarray:
    """Reads `count` integers that `write_integers` has written, int64 (count).

    Raises:
        BitstreamError: If the distribution's parameters are out of range.
    """
    mean, scale = reader.signed(), reader.unsigned()
    if abs(mean) > MAX_SYMBOL or scale >= NUM_SCALES:
        raise BitstreamError(f"impossible distribution (mean {mean}, scale {scale})")
    return decode_symbols(reader.blob(), _normal(mean, scale, count))


def zero_mean_rows(scales: np.ndarray, width: int) -> Mixtures:
    """Returns a zero-mean normal distribution for each entry of a matrix; entries of a row have the same distribution.

    Args:
        scales: Standard deviation of each row, as index into the coder's table of standard deviations.
        width: Number of columns.

    Returns:
        Distributions of all entries in row-major order.
    """
    return Mixtures.normals(np.zeros(len(scales) * width), np.repeat(scales, width))


def zero_mean_cells(rows: np.ndarray, columns: np.ndarray) -> Mixtures:
    """Returns a zero-mean normal distribution for each entry of a matrix.

    Standard deviations are given as indices into the coder's table of standard deviations. The index of entry (i, j) is
    `rows[i] + columns[j]`, clamped to the table.

    Args:
        rows: Contribution of each row to the index, integers (R).
        columns: Contribution of each column to the index, integers (C).

    Returns:
        Distributions of all entries in row-major order.
    """
    index = np.clip(rows[:, None] + columns[None, :], 0, NUM_SCALES - 1)
    return Mixtures.normals(np.zeros(index.size), index.ravel())


def _normal(mean: int, scale: int, count: int) -> Mixtures:
    return Mixtures.normals(np.full(count, mean << MEAN_BITS), np.full(count, scale))
