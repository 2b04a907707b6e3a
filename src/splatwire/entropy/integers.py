"""Codes arrays of integers under normal distributions fitted to them."""

import numpy as np
import numpy.typing as npt

from splatwire.entropy.coder import Mixtures, decode_symbols, encode_symbols
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES, SCALE_MIN_EXPONENT, SCALE_STEPS
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter

MAX_SYMBOL = 1 << 24


def scale_index(scale: npt.ArrayLike) -> np.ndarray:
    """Returns the index of the nearest entry of the scale table for each standard deviation, int64."""
    octaves = np.log2(np.maximum(np.asarray(scale, dtype=np.float64), 1e-9)) - SCALE_MIN_EXPONENT
    return np.asarray(np.clip(np.rint(octaves * SCALE_STEPS - 0.5), 0, NUM_SCALES - 1)).astype(np.int64)


def write_integers(writer: ByteWriter, values: np.ndarray) -> None:
    """Writes integers, entropy-coded under a normal distribution that is fitted to them.

    The mean and standard deviation of the distribution are written, too. The number of integers is not written.
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
    """Returns the probability distributions for coding a matrix of integers: zero-mean normals, one scale per row.

    Args:
        scales: For each row, index of the standard deviation in the coder's table.
        width: Number of columns.

    Returns:
        Distributions of all entries in row-major order.
    """
    return Mixtures.normals(np.zeros(len(scales) * width), np.repeat(scales, width))


def zero_mean_cells(rows: np.ndarray, columns: np.ndarray) -> Mixtures:
    """Returns zero-mean normal distributions for the entries of a matrix.

    The standard deviation of entry (i, j) has the index `rows[i] + columns[j]` in the scale table.

    Args:
        rows: First summand of this index for each row, an integer.
        columns: Second summand of this index for each column, an integer.
    """
    index = np.clip(rows[:, None] + columns[None, :], 0, NUM_SCALES - 1)
    return Mixtures.normals(np.zeros(index.size), index.ravel())


def _normal(mean: int, scale: int, count: int) -> Mixtures:
    return Mixtures.normals(np.full(count, mean << MEAN_BITS), np.full(count, scale))
