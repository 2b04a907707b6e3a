"""Arrays of integers under normal distributions that are fitted to them."""

import numpy as np
import numpy.typing as npt

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.entropy.coder import Mixtures, decode_symbols, encode_symbols
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES, SCALE_MIN_EXPONENT, SCALE_STEPS
from splatwire.errors import BitstreamError

MAX_SYMBOL = 1 << 24


def scale_index(scale: npt.ArrayLike) -> np.ndarray:
    """Entry of the scale table nearest to standard deviations, int64."""
    octaves = np.log2(np.maximum(np.asarray(scale, dtype=np.float64), 1e-9)) - SCALE_MIN_EXPONENT
    return np.asarray(np.clip(np.rint(octaves * SCALE_STEPS - 0.5), 0, NUM_SCALES - 1)).astype(np.int64)


def write_integers(writer: ByteWriter, values: np.ndarray) -> None:
    """Appends integers of which the reader knows the number, under one fitted normal."""
    mean = round(float(values.mean())) if len(values) else 0
    variance = ((values.astype(np.float64) - mean) ** 2).mean() if len(values) else 0.0
    scale = int(scale_index(np.sqrt(variance + 0.05))) if len(values) else 0
    writer.signed(mean)
    writer.unsigned(scale)
    writer.blob(encode_symbols(values.astype(np.int64), _normal(mean, scale, len(values))))


def read_integers(reader: ByteReader, count: int) -> np.ndarray:
    """Inverse of `write_integers`, int64 (count).

    Raises:
        BitstreamError: If the parameters are impossible.
    """
    mean, scale = reader.signed(), reader.unsigned()
    if abs(mean) > MAX_SYMBOL or scale >= NUM_SCALES:
        raise BitstreamError(f"impossible distribution (mean {mean}, scale {scale})")
    return decode_symbols(reader.blob(), _normal(mean, scale, count))


def zero_mean_rows(scales: np.ndarray, width: int) -> Mixtures:
    """Distributions of a matrix, row after row: each row with its own entry of the scale table and mean 0."""
    return Mixtures.normals(np.zeros(len(scales) * width), np.repeat(scales, width))


def zero_mean_cells(rows: np.ndarray, columns: np.ndarray) -> Mixtures:
    """Distributions of a matrix, row after row, of mean 0: entries of rows, `columns` entries further on."""
    index = np.clip(rows[:, None] + columns[None, :], 0, NUM_SCALES - 1)
    return Mixtures.normals(np.zeros(index.size), index.ravel())


def _normal(mean: int, scale: int, count: int) -> Mixtures:
    return Mixtures.normals(np.full(count, mean << MEAN_BITS), np.full(count, scale))
