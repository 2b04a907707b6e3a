"""Range coder: arrays of integers under table-indexed distributions to bytes and back.

The coder sees table indices only (`splatwire.entropy.tables`), so the same indices give the same bytes everywhere.
`tests/reference/range_coder.py` is the same coder in plain Python.
"""

from dataclasses import dataclass

import numpy as np

from splatwire.entropy.tables import half_width_table, inverse_scale_table, normal_table

BYTES_PER_SYMBOL = 12
"""Room for the costliest symbol: an escape of 86 bits."""


@dataclass(frozen=True, eq=False)
class Mixtures:
    """One distribution per symbol: a normal, or a mixture of two, named by table indices.

    Attributes:
        mean0: int64, mean of the first component in steps, `MEAN_BITS` fractional bits.
        scale0: int64, index into the scale table.
        mean1: int64, mean of the second component.
        scale1: int64, index into the scale table.
        weight: int64, weight of the first component out of 2**16; 2**16 makes it a plain normal.
    """

    mean0: np.ndarray
    scale0: np.ndarray
    mean1: np.ndarray
    scale1: np.ndarray
    weight: np.ndarray

    @staticmethod
    def normals(means: np.ndarray, scales: np.ndarray) -> "Mixtures":
        """Builds plain normals from means (fixed point) and scale indices."""
        mean, scale = means.astype(np.int64), scales.astype(np.int64)
        zero = np.zeros_like(mean)
        return Mixtures(mean, scale, zero, zero, np.full_like(mean, 65536))


def encode_symbols(symbols: np.ndarray, mixtures: Mixtures) -> bytes:
    """Codes integers.

    Args:
        symbols: int64 (n), magnitudes below 2**31.
        mixtures: Their distributions.

    Returns:
        The shortest code; decoding pads it with zero bytes.
    """
    from splatwire.entropy import _array_kernels

    buffer = np.empty(len(symbols) * BYTES_PER_SYMBOL + 64, dtype=np.uint8)
    m = mixtures
    length = _array_kernels.encode_symbols(
        symbols.astype(np.int64), m.mean0, m.scale0, m.mean1, m.scale1, m.weight, *tables(), buffer
    )
    return buffer[:length].tobytes()


def decode_symbols(data: bytes, mixtures: Mixtures) -> np.ndarray:
    """Decodes as many integers as there are distributions; any bytes decode to something.

    Args:
        data: A code of `encode_symbols`.
        mixtures: The distributions that it was coded under.

    Returns:
        int64 (n).
    """
    from splatwire.entropy import _array_kernels

    symbols = np.empty(len(mixtures.mean0), dtype=np.int64)
    m = mixtures
    _array_kernels.decode_symbols(
        np.frombuffer(data, dtype=np.uint8), m.mean0, m.scale0, m.mean1, m.scale1, m.weight, *tables(), symbols
    )
    return symbols


def tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The coder's tables, in the order in which the kernels take them: reciprocal scales, half widths, normal CDF."""
    return inverse_scale_table(), half_width_table(), normal_table()


def fresh_models(num_contexts: int) -> np.ndarray:
    """Adaptive binary models that know nothing: P(0) = 1/2 in both of their estimates, int64 (contexts, 2)."""
    return np.full((num_contexts, 2), 32768, dtype=np.int64)


def encode_bits(bits: np.ndarray, contexts: np.ndarray, models: np.ndarray) -> bytes:
    """Codes bits with adaptive models.

    Args:
        bits: uint8 (n), 0 or 1.
        contexts: int64 (n), which model each bit uses.
        models: int64 (contexts, 2) initial estimates; left as they are.

    Returns:
        The shortest code.
    """
    from splatwire.entropy import _array_kernels

    buffer = np.empty(2 * len(bits) + 64, dtype=np.uint8)
    length = _array_kernels.encode_bits(bits.astype(np.uint8), contexts.astype(np.int64), models.copy(), buffer)
    return buffer[:length].tobytes()


def decode_bits(data: bytes, contexts: np.ndarray, models: np.ndarray) -> np.ndarray:
    """Decodes one bit for each context; the inverse of `encode_bits`.

    Args:
        data: A code of `encode_bits`.
        contexts: int64 (n).
        models: int64 (contexts, 2) initial estimates; left as they are.

    Returns:
        uint8 (n).
    """
    from splatwire.entropy import _array_kernels

    bits = np.empty(len(contexts), dtype=np.uint8)
    _array_kernels.decode_bits(np.frombuffer(data, dtype=np.uint8), contexts.astype(np.int64), models.copy(), bits)
    return bits
