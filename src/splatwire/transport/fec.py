"""Erasure coding: RaptorQ (RFC 6330) through the package `raptorq`, one source block of at most `MAX_SYMBOLS` symbols.

Codes are systematic: symbols 0 to K-1 are the data itself, so that nothing needs the package when nothing was lost.
"""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

from splatwire.errors import BackendUnavailableError, InvalidValueError

ALIGNMENT = 8
MAX_SYMBOLS = 2048
"""Symbols of one source block: decoding stays in tens of milliseconds."""
MAX_REPAIR = 4096
"""Repair symbols that one source block can have here; the code itself knows millions."""
MAX_SYMBOL_BYTES = 4096
_ID_BYTES = 4


def check_symbol_bytes(symbol_bytes: int) -> None:
    """Refuses symbol sizes that the code does not take.

    Raises:
        InvalidValueError: If it is not a multiple of 8 from 8 to 4096.
    """
    if not 0 < symbol_bytes <= MAX_SYMBOL_BYTES or symbol_bytes % ALIGNMENT:
        raise InvalidValueError(
            f"a symbol has a multiple of {ALIGNMENT} bytes up to {MAX_SYMBOL_BYTES}, {symbol_bytes} it cannot"
        )


def num_symbols(num_bytes: int, symbol_bytes: int) -> int:
    """Source symbols of some data, K."""
    return -(-num_bytes // symbol_bytes)


def repair_symbols(data: bytes, symbol_bytes: int, count: int) -> list[bytes]:
    """Repair symbols K to K + count - 1 of some data.

    Args:
        data: At most `MAX_SYMBOLS` symbols, zero-padded to whole ones by this function.
        symbol_bytes: Size of a symbol.
        count: How many.

    Raises:
        InvalidValueError: If the data are empty or too many, or the count is.
        BackendUnavailableError: If the package is not installed.
    """
    check_symbol_bytes(symbol_bytes)
    total = num_symbols(len(data), symbol_bytes)
    if not 1 <= total <= MAX_SYMBOLS or not 0 <= count <= MAX_REPAIR:
        raise InvalidValueError(f"no source block has {total} symbols and {count} repair symbols")
    if not count:
        return []
    padded = data.ljust(total * symbol_bytes, b"\0")
    if total == 1:  # repetition: the code itself is not defined for so little
        return [padded] * count
    encoded = _raptorq().Encoder.with_defaults(padded, symbol_bytes + _ID_BYTES).get_encoded_packets(count)
    found = {int.from_bytes(packet[1:4], "big"): packet[_ID_BYTES:] for packet in encoded if packet[0] == 0}
    if len(found) != total + count or len(found[0]) != symbol_bytes:
        raise BackendUnavailableError(
            "raptorq", "pip install 'raptorq>=2,<3' (this release of it cuts data differently)"
        )
    return [found[total + n] for n in range(count)]


def source_symbols(data: bytes, symbol_bytes: int) -> list[bytes]:
    """The data in symbols, the last one zero-padded."""
    return [data[i : i + symbol_bytes].ljust(symbol_bytes, b"\0") for i in range(0, len(data), symbol_bytes)]


def recover(symbols: Mapping[int, bytes], total: int, symbol_bytes: int) -> list[bytes] | None:
    """Source symbols out of any that arrived.

    Args:
        symbols: Symbols by number, all of the right size; 0 to K-1 are source symbols.
        total: Source symbols, K.
        symbol_bytes: Size of a symbol.

    Returns:
        All source symbols; None if more are needed. What was wrong with a symbol is still wrong in them.

    Raises:
        BackendUnavailableError: If the package is needed and not installed.
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
    """Packets of different sizes as source symbols: each behind its size in two bytes, zero-padded."""
    return b"".join((len(p).to_bytes(2, "little") + p).ljust(symbol_bytes, b"\0") for p in packets)


def unframed(symbol: bytes) -> bytes:
    """A packet out of its source symbol; too large a size gives what is there."""
    return symbol[2 : 2 + int.from_bytes(symbol[:2], "little")]


def framed_bytes(packet_bytes: int) -> int:
    """Size of the symbols that packets of at most some bytes are framed in."""
    return -(-(packet_bytes + 2) // ALIGNMENT) * ALIGNMENT


@functools.cache
def _raptorq() -> Any:
    try:
        import raptorq
    except ImportError as error:
        raise BackendUnavailableError("raptorq", "pip install 'splatwire[relay]'") from error
    return raptorq
