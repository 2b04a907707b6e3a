"""Quantisation and entropy coding of the weights of the inpainting network."""

# Each weight matrix has one quantisation step. The quantised integers are coded row by row, with a zero-mean normal
# distribution whose standard deviation is chosen per row. A quantisation step of `2 ** (2.05 - bits)` standard
# deviations of the weights takes about `bits` bits per weight. Vectors (biases) have a fixed quantisation step. The
# constants that standardise the network's inputs are rounded: standard deviations to eight values per octave, means to
# a sixteenth of the standard deviation.

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from splatwire.entropy.coder import decode_symbols, encode_symbols
from splatwire.entropy.integers import read_integers, scale_index, write_integers, zero_mean_rows
from splatwire.entropy.tables import NUM_SCALES
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.paper.gnn.network import InpaintingNetwork
from splatwire.paper.gnn.settings import GnnSettings

MIN_BITS, MAX_BITS = 2, 6
MAX_SYMBOL = 127
"""Maximum magnitude of a matrix integer, so that it fits 8 bits."""
_VECTOR_BITS = 7
_MEAN_BITS = 4
_MAX_EXPONENT = 60
_MAX_INTEGER = 1 << 20
_HEADS = (("feature", 0), ("scaling", 1), ("offset", 2), ("offset", 3))
"""Pairs of an attribute and the index of a network head; used only if the attribute's threshold is at most 1."""


def short_float(index: int | np.ndarray) -> np.ndarray:
    """Decodes short floating-point numbers `(1 + fraction / 8) * 2 ** exponent`, exact in float32.

    Args:
        index: Codes of the numbers, `8 * exponent + fraction`, with fractions 0 to 7.
    """
    index = np.asarray(index, dtype=np.int64)
    return np.asarray(np.ldexp(1 + (index & 7) / 8, index >> 3))


def short_float_index(value: np.ndarray | float) -> np.ndarray:
    """Returns the integer code of the short float nearest to each positive value, the inverse of `short_float`.

    A short float has 3 bits for the fraction.
    """
    fraction, exponent = np.frexp(np.clip(np.asarray(value, dtype=np.float64), 2.0**-_MAX_EXPONENT, 2.0**_MAX_EXPONENT))
    eighths = np.rint((2 * fraction - 1) * 8)
    return (
        np.asarray(8.0 * (exponent - 1) + eighths, dtype=np.float64)
        .astype(np.int64, copy=False)
        .reshape(np.shape(value))
    )


def check_bits(bits: int) -> None:
    """Checks the number of bits per weight.

    Raises:
        InvalidValueError: If the number is not from 2 to 6.
    """
    if not MIN_BITS <= bits <= MAX_BITS:
        raise InvalidValueError(f"bits of a GNN weight must be from {MIN_BITS} to {MAX_BITS}, not {bits!r}")


def _step_index(matrix: np.ndarray, bits: int) -> int:
    rms = max(float(np.sqrt((matrix.astype(np.float64) ** 2).mean())), 1e-9)
    return int(short_float_index(rms * 2.0 ** (2.05 - bits)))


def _matrix_symbols(matrix: np.ndarray, step_index: int) -> np.ndarray:
    symbols = np.rint(matrix.astype(np.float64) / short_float(step_index))
    return np.clip(symbols, -MAX_SYMBOL, MAX_SYMBOL).astype(np.int64)


def rounded(value: Tensor, bits: int) -> Tensor:
    """Returns a network parameter after quantisation, as a receiver reads it.

    Args:
        value: The parameter, a matrix or a vector.
        bits: Approximate bits per weight of a matrix.
    """
    array = value.detach().cpu().numpy()
    if array.ndim == 2:
        index = _step_index(array, bits)
        return torch.from_numpy((_matrix_symbols(array, index) * short_float(index)).astype(np.float32))
    return torch.from_numpy((np.rint(array.astype(np.float64) * 2**_VECTOR_BITS) / 2**_VECTOR_BITS).astype(np.float32))


def rounded_constants(mean: Tensor, deviation: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the means and standard deviations of the network's inputs, rounded as a receiver reads them."""
    index = short_float_index(deviation.cpu().numpy())
    unit = short_float(index) / 2**_MEAN_BITS
    near = np.rint(mean.cpu().double().numpy() / unit) * unit
    return torch.from_numpy(near.astype(np.float32)), torch.from_numpy(short_float(index).astype(np.float32))


@contextmanager
def rounded_parameters(network: InpaintingNetwork, bits: int) -> Iterator[None]:
    """Context manager in which a network computes with quantised weights.

    Gradients are computed as if the weights were not quantised (straight-through estimator).
    """
    exact = {name: parameter.data for name, parameter in network.named_parameters()}
    try:
        for parameter in network.parameters():
            parameter.data = rounded(parameter.data, bits)
        yield
    finally:
        for name, parameter in network.named_parameters():
            parameter.data = exact[name]


def sent_names(network: InpaintingNetwork, settings: GnnSettings) -> list[str]:
    """Returns the names of the network parameters that are sent to receivers."""
    # The output head of an attribute is omitted if its threshold in the settings is above 1, because its output is
    # then never used.
    unused = tuple(f"regressors.{head}." for name, head in _HEADS if getattr(settings, f"{name}_threshold") > 1)
    return [name for name, _ in network.named_parameters() if not (unused and name.startswith(unused))]


def write_parameters(writer: ByteWriter, network: InpaintingNetwork, bits: int) -> None:
    """Writes the constants that standardise the network's inputs, and all parameters that a receiver needs.

    Raises:
        InvalidValueError: If a parameter is not finite.
    """
    state = network.state_dict()
    for name in ("source", "query"):
        mean, spread = (state[f"{name}_{part}"].double().numpy() for part in ("mean", "spread"))
        index = short_float_index(spread)
        write_integers(writer, index)
        write_integers(writer, np.rint(mean / (short_float(index) / 2**_MEAN_BITS)).astype(np.int64))
    for name in sent_names(network, network.settings):
        array = state[name].numpy()
        if not np.isfinite(array).all():
            raise InvalidValueError(f"'{name}' of the GNN weights is not finite")
        if array.ndim == 1:
            write_integers(writer, np.rint(array.astype(np.float64) * 2**_VECTOR_BITS).astype(np.int64))
            continue
        step = _step_index(array, bits)
        symbols = _matrix_symbols(array, step)
        scales = scale_index(np.sqrt((symbols.astype(np.float64) ** 2).mean(axis=1)))
        writer.signed(step)
        write_integers(writer, scales)
        writer.blob(encode_symbols(symbols.ravel(), zero_mean_rows(scales, symbols.shape[1])))


def read_parameters(reader: ByteReader, network: InpaintingNetwork) -> None:
    """Reads the data written by `write_parameters` into a network with the same settings.

    Raises:
        BitstreamError: If a value is out of range.
    """
    # Omitted heads become zero.
    state = {name: torch.zeros_like(value) for name, value in network.state_dict().items()}
    for name in ("source", "query"):
        count = len(state[f"{name}_mean"])
        index = _checked(read_integers(reader, count), 8 * _MAX_EXPONENT + 8)
        spread = short_float(index)
        mean = _checked(read_integers(reader, count), _MAX_INTEGER) * spread / 2**_MEAN_BITS
        state[f"{name}_mean"], state[f"{name}_spread"] = _float32(mean), _float32(spread)
    for name in sent_names(network, network.settings):
        shape = state[name].shape
        if len(shape) == 1:
            state[name] = _float32(_checked(read_integers(reader, shape[0]), _MAX_INTEGER) / 2**_VECTOR_BITS)
            continue
        step = int(_checked(np.array([reader.signed()]), 8 * _MAX_EXPONENT + 8)[0])
        scales = read_integers(reader, shape[0])
        if scales.min() < 0 or scales.max() >= NUM_SCALES:
            raise BitstreamError("GNN weights: the scale of a row is impossible")
        symbols = decode_symbols(reader.blob(), zero_mean_rows(scales, shape[1]))
        state[name] = _float32(_checked(symbols, MAX_SYMBOL).reshape(shape) * short_float(step))
    network.load_state_dict(state)


def _checked(values: np.ndarray, max_magnitude: int) -> np.ndarray:
    if len(values) and int(np.abs(values).max()) > max_magnitude:
        raise BitstreamError(f"GNN weights: a number is beyond {max_magnitude}")
    return values


def _float32(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values.astype(np.float32))
