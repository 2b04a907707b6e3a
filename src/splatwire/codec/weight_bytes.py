"""Quantised networks as bytes: every array under a normal distribution fitted to it, every matrix row with its own."""

import numpy as np
import numpy.typing as npt

from splatwire.codec.byte_io import ByteReader, ByteWriter
from splatwire.codec.weights import MAX_SHIFT, MAX_STEP, QuantisedLinear, QuantisedMlp
from splatwire.entropy.coder import Mixtures, decode_symbols, encode_symbols
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES, SCALE_MIN_EXPONENT, SCALE_STEPS
from splatwire.errors import BitstreamError

MAX_WIDTH = 4096
MAX_WEIGHTS = 1 << 20
MAX_SYMBOL = 1 << 24


def scale_index(scale: npt.ArrayLike) -> np.ndarray:
    """Entry of the scale table nearest to standard deviations, int64."""
    octaves = np.log2(np.maximum(np.asarray(scale, dtype=np.float64), 1e-9)) - SCALE_MIN_EXPONENT
    return np.asarray(np.clip(np.rint(octaves * SCALE_STEPS - 0.5), 0, NUM_SCALES - 1)).astype(np.int64)


def write_integers(writer: ByteWriter, values: np.ndarray) -> None:
    """Appends integers of which the reader knows the number, under one fitted normal."""
    mean = round(float(values.mean())) if len(values) else 0
    scale = int(scale_index(np.sqrt(((values - mean) ** 2).mean() + 0.05))) if len(values) else 0
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
        raise BitstreamError(f"side information: impossible distribution (mean {mean}, scale {scale})")
    return decode_symbols(reader.blob(), _normal(mean, scale, count))


def write_mlp(writer: ByteWriter, mlp: QuantisedMlp) -> None:
    """Appends a network."""
    out, hidden = mlp.output.symbols.shape
    for size in (mlp.hidden.symbols.shape[1], hidden, out):
        writer.unsigned(size)
    writer.u8(int(mlp.leaky))
    _write_linear(writer, mlp.hidden)
    _write_linear(writer, mlp.output)


def read_mlp(reader: ByteReader, what: str, inputs: int, outputs: int) -> QuantisedMlp:
    """Inverse of `write_mlp`.

    Args:
        reader: Where to read.
        what: Which network, for error messages.
        inputs: Inputs that it must have.
        outputs: Outputs that it must have.

    Raises:
        BitstreamError: If its shape or a number is impossible.
    """
    shape = [reader.unsigned() for _ in range(3)]
    leaky = reader.u8()
    hidden = shape[1]
    if shape[0] != inputs or shape[2] != outputs or not 0 < hidden <= MAX_WIDTH or leaky > 1:
        raise BitstreamError(f"{what} network: shape {shape} where {inputs} inputs and {outputs} outputs are needed")
    if max(inputs, outputs) * hidden > MAX_WEIGHTS:
        raise BitstreamError(f"{what} network: {shape} is too large")
    return QuantisedMlp(
        _read_linear(reader, what, inputs, hidden), _read_linear(reader, what, hidden, outputs), bool(leaky)
    )


def _write_linear(writer: ByteWriter, layer: QuantisedLinear) -> None:
    scales = scale_index(np.sqrt((layer.symbols.astype(np.float64) ** 2).mean(axis=1)))
    for values in (layer.row_steps, layer.column_shifts, layer.bias, scales):
        write_integers(writer, values)
    writer.blob(encode_symbols(layer.symbols.ravel().astype(np.int64), _rows(scales, layer.symbols.shape[1])))


def _read_linear(reader: ByteReader, what: str, inputs: int, outputs: int) -> QuantisedLinear:
    steps, shifts = read_integers(reader, outputs), read_integers(reader, inputs)
    bias, scales = read_integers(reader, outputs), read_integers(reader, outputs)
    for name, values, low, high in (
        ("row step", steps, 1, MAX_STEP),
        ("column shift", shifts, 0, MAX_SHIFT),
        ("bias", bias, -MAX_SYMBOL, MAX_SYMBOL),
        ("row scale", scales, 0, NUM_SCALES - 1),
    ):
        if values.min() < low or values.max() > high:
            raise BitstreamError(f"{what} network: a {name} is not between {low} and {high}")
    symbols = decode_symbols(reader.blob(), _rows(scales, inputs))
    if np.abs(symbols).max() > MAX_SYMBOL:
        raise BitstreamError(f"{what} network: a weight is beyond the range of the format")
    return QuantisedLinear(symbols.reshape(outputs, inputs).astype(np.int32), steps, shifts, bias.astype(np.int32))


def _normal(mean: int, scale: int, count: int) -> Mixtures:
    return Mixtures.normals(np.full(count, mean << MEAN_BITS), np.full(count, scale))


def _rows(scales: np.ndarray, width: int) -> Mixtures:
    return Mixtures.normals(np.zeros(len(scales) * width), np.repeat(scales, width))
