"""Quantised networks as bytes: every array under a normal distribution fitted to it, every matrix row with its own."""

import numpy as np

from splatwire.codec.weights import MAX_SHIFT, MAX_STEP, QuantisedLinear, QuantisedMlp
from splatwire.entropy.byte_io import ByteReader, ByteWriter
from splatwire.entropy.coder import decode_symbols, encode_symbols
from splatwire.entropy.integers import MAX_SYMBOL, read_integers, scale_index, write_integers, zero_mean_rows
from splatwire.entropy.tables import NUM_SCALES
from splatwire.errors import BitstreamError

MAX_WIDTH = 4096
MAX_WEIGHTS = 1 << 20


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
    writer.blob(encode_symbols(layer.symbols.ravel().astype(np.int64), zero_mean_rows(scales, layer.symbols.shape[1])))


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
    symbols = decode_symbols(reader.blob(), zero_mean_rows(scales, inputs))
    if np.abs(symbols).max() > MAX_SYMBOL:
        raise BitstreamError(f"{what} network: a weight is beyond the range of the format")
    return QuantisedLinear(symbols.reshape(outputs, inputs).astype(np.int32), steps, shifts, bias.astype(np.int32))
