"""Erasure coding with RaptorQ (RFC 6330, package `raptorq`) for one source block."""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

from splatwire.errors import BackendUnavailableError, InvalidValueError

ALIGNMENT = 8
MAX_SYMBOLS = 2048
"""Maximum number of symbols in a source block; keeps decoding within tens of milliseconds."""
MAX_REPAIR = 4096
"""Maximum number of repair symbols per source block. RaptorQ itself allows millions."""
MAX_SYMBOL_BYTES = 4096
_ID_BYTES = 4


def check_symbol_bytes(symbol_bytes: int) -> None:
    """Checks that a size in bytes is valid for a symbol of the erasure code.

    Raises:
        InvalidValueError: If the size is not a multiple of 8 from 8 to 4096.
    """
    if not 0 < symbol_bytes <= MAX_SYMBOL_BYTES or symbol_bytes % ALIGNMENT:
        raise InvalidValueError(
            f"a symbol has a multiple of {ALIGNMENT} bytes up to {MAX_SYMBOL_BYTES}, not {symbol_bytes}"
        )


def num_symbols(num_bytes: int, symbol_bytes: int) -> int:
    """Returns the number of source symbols K that data of `num_bytes` bytes fill."""
    return -(-num_bytes // symbol_bytes)


def repair_symbols(data: bytes, symbol_bytes: int, count: int) -> list[bytes]:
    """Encodes data of K source symbols and returns repair symbols, with the numbers K to K + count - 1.

    Args:
        data: Source data, at most `MAX_SYMBOLS` symbols; the last one is padded with zeros.
        symbol_bytes: Size of a symbol in bytes.
        count: Number of repair symbols.

    Raises:
        InvalidValueError: If the data are empty or too long, or `count` is out of range.
        BackendUnavailableError: If the package `raptorq` is not installed.
    """
    check_symbol_bytes(symbol_bytes)
    total = num_symbols(len(data), symbol_bytes)
    if not 1 <= total <= MAX_SYMBOLS or not 0 <= count <= MAX_REPAIR:
        raise InvalidValueError(f"no source block has {total} symbols and {count} repair symbols")
    if not count:
        return []
    padded = data.ljust(total * symbol_bytes, b"\0")
    if total == 1:  # repetition: RaptorQ is not defined for one source symbol
        return [padded] * count
    encoded = _raptorq().Encoder.with_defaults(padded, symbol_bytes + _ID_BYTES).get_encoded_packets(count)
    symbols = {int.from_bytes(packet[1:4], "big"): packet[_ID_BYTES:] for packet in encoded if packet[0] == 0}
    if len(symbols) != total + count or len(symbols[0]) != symbol_bytes:
        raise BackendUnavailableError(
            "raptorq", "pip install 'raptorq>=2,<3' (this release of it cuts data differently)"
        )
    return [symbols[total + n] for n in range(count)]


def source_symbols(data: bytes, symbol_bytes: int) -> list[bytes]:
    """Splits data into source symbols of `symbol_bytes` bytes, with zeros after the end of the data."""
    return [data[i : i + symbol_bytes].ljust(symbol_bytes, b"\0") for i in range(0, len(data), symbol_bytes)]


def recover(symbols: Mapping[int, bytes], total: int, symbol_bytes: int) -> list[bytes] | None:
    """Recovers the source symbols of a source block (data that are encoded together) from enough received symbols.

    Args:
        symbols: Received symbols by number. Numbers 0 to K-1 are source symbols, higher numbers are repair symbols.
        total: Number of source symbols, K.
        symbol_bytes: Size of a symbol in bytes.

    Returns:
        All source symbols, or None if more symbols are needed. Corrupt symbols are not detected.

    Raises:
        BackendUnavailableError: If the package `raptorq` is needed and not installed.
    """
    if all(n in symbols for n in range(total)):
        return [symbols[n] for n in range(total)]
    if len(symbols) < total:
        return None
    if total == 1:
        return [next(iter(symbols.values()))]
    decoder = _raptorq().Decoder.with_defaults(total * symbol_bytes, symbol_bytes + _ID_BYTES)
    for number, payload in symbols.items():
        data = decoder.decode(b"\0" + number.to_bytes(3, "big") + payload)
        if data is not None:
            return source_symbols(bytes(data), symbol_bytes)
    return None


def framed(packets: Sequence[bytes], symbol_bytes: int) -> bytes:
    """Converts packets of different sizes to source symbols of equal size.

    A symbol contains the size of its packet (two bytes, little-endian), the packet, and zeros.
    """
    return b"".join((len(p).to_bytes(2, "little") + p).ljust(symbol_bytes, b"\0") for p in packets)


def unframed(symbol: bytes) -> bytes:
    """Extracts the packet from a source symbol made by `framed`."""
    return symbol[2 : 2 + int.from_bytes(symbol[:2], "little")]


def symbol_bytes_for(packet_bytes: int) -> int:
    """Returns the size in bytes of source symbols for packets of at most `packet_bytes` bytes."""
    return -(-(packet_bytes + 2) // ALIGNMENT) * ALIGNMENT


@functools.cache
def _raptorq() -> Any:
    try:
        import raptorq
    except ImportError as error:
        raise BackendUnavailableError("raptorq", "pip install 'splatwire[relay]'") from error
    return raptorq
