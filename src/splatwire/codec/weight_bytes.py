"""Serialises quantised networks with entropy coding."""
# The entries of a matrix are coded under normal distributions. The standard deviation of an entry is the product of a
# row scale and a column scale. Columns of less important inputs have coarser steps and take fewer bits. (Older streams
# have row scales only, indicated by a flag.)

from collections.abc import Iterable

import numpy as np

from splatwire.codec.weights import MAX_SHIFT, MAX_STEP, QuantisedLinear, QuantisedMlp
from splatwire.entropy.coder import decode_symbols, encode_symbols
from splatwire.entropy.integers import MAX_SYMBOL, read_integers, scale_index, write_integers, zero_mean_cells
from splatwire.entropy.tables import NUM_SCALES, SCALE_STEPS
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types import AnchorLayout

MAX_WIDTH = 4096
MAX_WEIGHTS = 1 << 20
"""Maximum number of weights of all networks of a section. A weight may take no bit, but takes 28 bytes of memory."""
LEAKY = 1
WITH_COLUMN_SCALES = 2
FIT_ROUNDS = 4


def write_mlp(writer: ByteWriter, mlp: QuantisedMlp) -> None:
    """Serialises a quantised network, and appends the bytes to a writer."""
    out, hidden = mlp.output.symbols.shape
    for size in (mlp.hidden.symbols.shape[1], hidden, out):
        writer.unsigned(size)
    writer.u8(int(mlp.leaky) | WITH_COLUMN_SCALES)
    _write_linear(writer, mlp.hidden)
    _write_linear(writer, mlp.output)


def read_mlp(
    reader: ByteReader, subject: str, inputs: int, outputs: int, max_weights: int = MAX_WEIGHTS
) -> QuantisedMlp:
    """Parses a network written by `write_mlp`.

    Args:
        reader: Source of the bytes.
        subject: Name of the network, for error messages.
        inputs: Required number of inputs.
        outputs: Required number of outputs.
        max_weights: Maximum number of weights.

    Raises:
        BitstreamError: If the shape differs or a number is out of range.
    """
    shape = [reader.unsigned() for _ in range(3)]
    flags = reader.u8()
    hidden = shape[1]
    if flags > (LEAKY | WITH_COLUMN_SCALES):
        raise BitstreamError(f"{subject} network: flags {flags} that this version does not know")
    if shape[0] != inputs or shape[2] != outputs or not 0 < hidden <= MAX_WIDTH:
        raise BitstreamError(f"{subject} network: shape {shape} where {inputs} inputs and {outputs} outputs are needed")
    if (inputs + outputs) * hidden > max_weights:
        raise BitstreamError(f"{subject} network: {shape} is too large: networks have {MAX_WEIGHTS:,} weights at most")
    columns = bool(flags & WITH_COLUMN_SCALES)
    first = _read_linear(reader, subject, inputs, hidden, columns)
    return QuantisedMlp(first, _read_linear(reader, subject, hidden, outputs, columns), bool(flags & LEAKY))


def write_networks(networks: Iterable[QuantisedMlp]) -> bytes:
    """Returns the bytes of several quantised networks, one after another."""
    writer = ByteWriter()
    for network in networks:
        write_mlp(writer, network)
    return writer.bytes()


def read_networks(data: bytes, shapes: Iterable[tuple[str, int, int]]) -> list[QuantisedMlp]:
    """Parses networks written by `write_networks`.

    Args:
        data: The bytes.
        shapes: Name, number of inputs and number of outputs of each network.

    Raises:
        BitstreamError: If the bytes are damaged or not networks of these shapes.
    """
    reader, networks, weights_left = ByteReader(data, "networks"), list[QuantisedMlp](), MAX_WEIGHTS
    for name, inputs, outputs in shapes:
        networks.append(read_mlp(reader, name, inputs, outputs, weights_left))
        weights_left -= (inputs + outputs) * len(networks[-1].hidden.symbols)
    reader.finish()
    return networks


def read_heads(data: bytes, layout: AnchorLayout) -> tuple[QuantisedMlp, QuantisedMlp, QuantisedMlp]:
    """Reads the rendering networks of anchors: opacity, covariance, colour.

    Raises:
        BitstreamError: If the bytes are damaged or not such networks.
    """
    inputs, num = layout.feature_dim + 4, layout.num_offsets
    shapes = (("opacity", inputs, num), ("covariance", inputs, 7 * num), ("color", inputs, 3 * num))
    opacity, covariance, color = read_networks(data, shapes)
    return opacity, covariance, color


def framed(data: bytes) -> bytes:
    """Returns bytes preceded by their length (a variable-length integer), as `ByteReader.blob` reads them."""
    writer = ByteWriter()
    writer.blob(data)
    return writer.bytes()


def _write_linear(writer: ByteWriter, layer: QuantisedLinear) -> None:
    rows, columns = _fitted_scales(layer.symbols)
    for values in (layer.row_steps, layer.column_shifts, layer.bias, rows, columns):
        write_integers(writer, values)
    writer.blob(encode_symbols(layer.symbols.ravel().astype(np.int64), zero_mean_cells(rows, columns)))


def _fitted_scales(symbols: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fits a standard deviation to each entry of a matrix for entropy coding: a row factor times a column factor.

    Args:
        symbols: The matrix, integers.

    Returns:
        Both factors as indices for `zero_mean_cells`, int64. For each row: index into the coder's table of standard
        deviations. For each column: number that is added to the index of the row.
    """
    # Alternating maximum-likelihood estimates.
    square = symbols.astype(np.float64) ** 2 + 1e-3
    column = np.ones(symbols.shape[1])
    for _ in range(FIT_ROUNDS):
        row = (square / column).mean(axis=1)
        column = (square / row[:, None]).mean(axis=0)
    return scale_index(np.sqrt(row)), np.rint(SCALE_STEPS * np.log2(column) / 2).astype(np.int64)


def _read_linear(reader: ByteReader, subject: str, inputs: int, outputs: int, columns: bool) -> QuantisedLinear:
    steps, shifts = read_integers(reader, outputs), read_integers(reader, inputs)
    bias, scales = read_integers(reader, outputs), read_integers(reader, outputs)
    further = read_integers(reader, inputs) if columns else np.zeros(inputs, dtype=np.int64)
    for name, values, low, high in (
        ("row step", steps, 1, MAX_STEP),
        ("column shift", shifts, 0, MAX_SHIFT),
        ("bias", bias, -MAX_SYMBOL, MAX_SYMBOL),
        ("row scale", scales, 0, NUM_SCALES - 1),
        ("column scale", further, -NUM_SCALES, NUM_SCALES),
    ):
        if values.min() < low or values.max() > high:
            raise BitstreamError(f"{subject} network: a {name} is not between {low} and {high}")
    symbols = decode_symbols(reader.blob(), zero_mean_cells(scales, further))
    if np.abs(symbols).max() > MAX_SYMBOL:
        raise BitstreamError(f"{subject} network: a weight is beyond the range of the format")
    return QuantisedLinear(symbols.reshape(outputs, inputs).astype(np.int32), steps, shifts, bias.astype(np.int32))
