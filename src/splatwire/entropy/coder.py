"""Range coder: converts arrays of integers under given distributions to bytes and back.

Results are identical on every machine.
"""
# The coder sees table indices only (`splatwire.entropy.tables`), so the same indices give the same bytes everywhere.
# `tests/reference/range_coder.py` is the same coder in plain Python.

from dataclasses import dataclass

import numpy as np

from splatwire.entropy.tables import half_width_table, inverse_scale_table, normal_table

BYTES_PER_SYMBOL = 12
"""Buffer space per symbol, bytes. The longest code is an escape of 86 bits."""


@dataclass(frozen=True, eq=False)
class Mixtures:
    """Probability distribution of each symbol: a normal distribution or a mixture of two.

    Attributes:
        mean0: Mean of the first component in quantisation steps, fixed point with `MEAN_BITS` fractional bits, int64.
        scale0: Standard deviation of the first component, as an index into the scale table, int64.
        mean1: Mean of the second component, as `mean0`.
        scale1: Standard deviation of the second component, as `scale0`.
        weight: Weight of the first component in units of 2**-16, int64; 2**16 selects the first component only.
    """

    mean0: np.ndarray
    scale0: np.ndarray
    mean1: np.ndarray
    scale1: np.ndarray
    weight: np.ndarray

    @staticmethod
    def normals(means: np.ndarray, scales: np.ndarray) -> "Mixtures":
        """Builds a normal distribution for each symbol.

        Args:
            means: Means in quantisation steps, fixed point with `MEAN_BITS` fractional bits.
            scales: Standard deviations, as indices into the scale table.
        """
        mean, scale = means.astype(np.int64), scales.astype(np.int64)
        zero = np.zeros_like(mean)
        return Mixtures(mean, scale, zero, zero, np.full_like(mean, 65536))


def encode_symbols(symbols: np.ndarray, mixtures: Mixtures) -> bytes:
    """Encodes integers, each under its own distribution.

    Args:
        symbols: Integers with magnitudes below 2**31, int64 (n).
        mixtures: Distribution of each symbol.

    Returns:
        The encoded bytes.
    """
    from splatwire.entropy import _array_kernels

    buffer = np.empty(len(symbols) * BYTES_PER_SYMBOL + 64, dtype=np.uint8)
    m = mixtures
    length = _array_kernels.encode_symbols(
        symbols.astype(np.int64), m.mean0, m.scale0, m.mean1, m.scale1, m.weight, *tables(), buffer
    )
    return buffer[:length].tobytes()


def decode_symbols(data: bytes, mixtures: Mixtures) -> np.ndarray:
    """Decodes integers that were encoded by `encode_symbols`; damaged bytes give wrong integers, but no error.

    Args:
        data: The encoded bytes.
        mixtures: Probability distribution of each of the n integers, the same as for encoding.

    Returns:
        The integers, int64 (n).
    """
    from splatwire.entropy import _array_kernels

    symbols = np.empty(len(mixtures.mean0), dtype=np.int64)
    m = mixtures
    _array_kernels.decode_symbols(
        np.frombuffer(data, dtype=np.uint8), m.mean0, m.scale0, m.mean1, m.scale1, m.weight, *tables(), symbols
    )
    return symbols


def tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the tables with which the entropy coder computes probabilities of normal distributions.

    Returns:
        Three arrays: the reciprocals of the supported standard deviations (`inverse_scale_table`); for each of these,
        the largest distance from the mean that needs no escape code (`half_width_table`); and the standard normal CDF
        (`normal_table`).
    """
    return inverse_scale_table(), half_width_table(), normal_table()


def fresh_models(num_contexts: int) -> np.ndarray:
    """Returns adaptive models of bits in their initial state.

    Args:
        num_contexts: Number of models. Each context of a bit has a separate model.

    Returns:
        For each context, two estimates of the probability that a bit is 0, in units of 2**-16, int64 (contexts, 2).
    """
    # One estimate adapts slowly, one fast.
    return np.full((num_contexts, 2), 32768, dtype=np.int64)


def encode_bits(bits: np.ndarray, contexts: np.ndarray, models: np.ndarray) -> bytes:
    """Encodes bits with adaptive probability models.

    Args:
        bits: uint8 (n), 0 or 1.
        contexts: int64 (n), index of the model of each bit.
        models: int64 (contexts, 2), initial estimates; not modified.

    Returns:
        The encoded bytes.
    """
    from splatwire.entropy import _array_kernels

    buffer = np.empty(2 * len(bits) + 64, dtype=np.uint8)
    length = _array_kernels.encode_bits(bits.astype(np.uint8), contexts.astype(np.int64), models.copy(), buffer)
    return buffer[:length].tobytes()


def decode_bits(data: bytes, contexts: np.ndarray, models: np.ndarray) -> np.ndarray:
    """Decodes bits that were encoded by `encode_bits`, one for each entry of `contexts`.

    Args:
        data: Bytes written by `encode_bits`.
        contexts: int64 (n), index of the model of each bit.
        models: int64 (contexts, 2), initial estimates; not modified.

    Returns:
        uint8 (n).
    """
    from splatwire.entropy import _array_kernels

    bits = np.empty(len(contexts), dtype=np.uint8)
    _array_kernels.decode_bits(np.frombuffer(data, dtype=np.uint8), contexts.astype(np.int64), models.copy(), bits)
    return bits
