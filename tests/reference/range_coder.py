"""The range coder in plain Python, slow and close to the text of docs/format.md.

The fast coder keeps a 48-bit window and propagates carries into written bytes. This one keeps the whole code as one
unbounded integer, so a carry error becomes visible.
"""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass, field

from splatwire.entropy.tables import (
    INVERSE_BITS,
    MEAN_BITS,
    TOTAL_BITS,
    Z_BITS,
    Z_CELL_BITS,
    Z_LIMIT,
    half_width_table,
    inverse_scale_table,
    normal_table,
)

ESCAPE = 16
WINDOW_BITS = 48
RANGE_FLOOR = 1 << 40


@dataclass
class ReferenceEncoder:
    """Arithmetic encoder over intervals.

    Attributes:
        low: Lower end of the interval; grows by 8 bits with each byte that is settled.
        span: Width of the interval.
        num_bytes: Bytes settled so far.
    """

    low: int = 0
    span: int = 1 << WINDOW_BITS
    num_bytes: int = 0

    def encode(self, start: int, size: int, total_bits: int) -> None:
        """Narrows the interval to `[start, start + size)` out of `2**total_bits`."""
        unit = self.span >> total_bits
        self.low += unit * start
        self.span = unit * size
        while self.span < RANGE_FLOOR:
            self.low <<= 8
            self.span <<= 8
            self.num_bytes += 1

    def finish(self) -> bytes:
        """Returns the shortest code: the multiple of 2**40 above `low`, without zero bytes at its end."""
        value = -(-self.low // RANGE_FLOOR) * RANGE_FLOOR
        return value.to_bytes(self.num_bytes + WINDOW_BITS // 8, "big").rstrip(b"\0")


@dataclass
class ReferenceDecoder:
    """Inverse of `ReferenceEncoder`.

    Attributes:
        data: The code; zero bytes follow its end.
    """

    data: bytes
    code: int = field(init=False)
    span: int = field(init=False, default=1 << WINDOW_BITS)
    position: int = field(init=False, default=6)

    def __post_init__(self) -> None:
        self.code = int.from_bytes(self.data[:6].ljust(6, b"\0"), "big")

    def target(self, total_bits: int) -> int:
        """Number out of `2**total_bits` that the code points at."""
        return min(self.code // (self.span >> total_bits), (1 << total_bits) - 1)

    def advance(self, start: int, size: int, total_bits: int) -> None:
        """Removes an interval from the code."""
        unit = self.span >> total_bits
        self.span = unit * size
        self.code = min(self.code - unit * start, self.span - 1)  # hostile bytes may point after the last interval
        while self.span < RANGE_FLOOR:
            following = self.data[self.position] if self.position < len(self.data) else 0
            self.code = self.code << 8 | following
            self.span <<= 8
            self.position += 1


@dataclass(frozen=True)
class ReferenceMixture:
    """A normal or a mixture of two, by table indices; the fields of `splatwire.entropy.coder.Mixtures`."""

    mean0: int
    scale0: int
    mean1: int = 0
    scale1: int = 0
    weight: int = 1 << 16

    def window(self) -> tuple[int, int]:
        """First and last symbol with a separate interval."""
        widths = half_width_table()
        center = _nearest(self.mean0)
        low, high = center - int(widths[self.scale0]), center + int(widths[self.scale0])
        if self.weight < 1 << 16:
            center = _nearest(self.mean1)
            low = min(low, center - int(widths[self.scale1]))
            high = max(high, center + int(widths[self.scale1]))
            if high - low > 32767:
                low, high = center - 16383, center + 16383
        return low, high

    def start(self, symbol: int) -> int:
        """Start of a symbol's interval out of 2**24; that of `high + 1` is the start of the escape."""
        low, high = self.window()
        room = (1 << TOTAL_BITS) - ESCAPE
        if symbol <= low:
            return 0
        if symbol > high:
            return room
        boundary = (symbol << MEAN_BITS) - (1 << (MEAN_BITS - 1))
        below = _normal_cdf(boundary - self.mean0, self.scale0)
        if self.weight < 1 << 16:
            other = _normal_cdf(boundary - self.mean1, self.scale1)
            below = (below * self.weight + other * ((1 << 16) - self.weight)) >> 16
        return ((below * (room - (high - low + 1))) >> TOTAL_BITS) + symbol - low


def _nearest(mean: int) -> int:
    return (mean + (1 << (MEAN_BITS - 1))) >> MEAN_BITS


def _normal_cdf(distance: int, scale: int) -> int:
    z = (distance * int(inverse_scale_table()[scale])) >> (MEAN_BITS + INVERSE_BITS - Z_BITS)
    limit = Z_LIMIT << Z_BITS
    if z <= -limit:
        return 0
    if z >= limit:
        return 1 << TOTAL_BITS
    cell, fraction = divmod(z + limit, 1 << Z_CELL_BITS)
    table = normal_table()
    return int(table[cell]) + ((int(table[cell + 1] - table[cell]) * fraction) >> Z_CELL_BITS)


def encode(symbols: Sequence[int], mixtures: Sequence[ReferenceMixture]) -> bytes:
    """Codes integers; gives the bytes of `splatwire.entropy.coder.encode_symbols`."""
    coder = ReferenceEncoder()
    for symbol, mixture in zip(symbols, mixtures, strict=True):
        low, high = mixture.window()
        if low <= symbol <= high:
            start = mixture.start(symbol)
            coder.encode(start, mixture.start(symbol + 1) - start, TOTAL_BITS)
            continue
        coder.encode((1 << TOTAL_BITS) - ESCAPE, ESCAPE, TOTAL_BITS)
        above = symbol > high
        coder.encode(int(above), 1, 1)
        excess = (symbol - high if above else low - symbol) - 1
        length = (excess + 1).bit_length() - 1
        gamma = [1] * length + [0] + [excess + 1 >> i & 1 for i in range(length - 1, -1, -1)]
        for bit in gamma:
            coder.encode(bit, 1, 1)
    return coder.finish()


def decode(data: bytes, mixtures: Sequence[ReferenceMixture]) -> list[int]:
    """Inverse of `encode`."""
    coder = ReferenceDecoder(data)
    return [decode_mixture(coder, mixture) for mixture in mixtures]


def decode_mixture(coder: ReferenceDecoder, mixture: ReferenceMixture) -> int:
    """Decodes one integer: finds the last symbol of the window that starts at or before the target."""
    low, high = mixture.window()
    target = coder.target(TOTAL_BITS)
    if target >= (1 << TOTAL_BITS) - ESCAPE:
        return _decode_escape(coder, low, high)
    symbol = low - 1 + bisect.bisect_right(range(low, high + 1), target, key=mixture.start)
    start = mixture.start(symbol)
    coder.advance(start, mixture.start(symbol + 1) - start, TOTAL_BITS)
    return symbol


def _decode_escape(coder: ReferenceDecoder, low: int, high: int) -> int:
    coder.advance((1 << TOTAL_BITS) - ESCAPE, ESCAPE, TOTAL_BITS)

    def bit() -> int:
        value = coder.target(1)
        coder.advance(value, 1, 1)
        return value

    above = bit()
    length = 0
    while length < 32 and bit():
        length += 1
    excess = 1
    for _ in range(length):
        excess = excess << 1 | bit()
    return high + excess if above else low - excess


def encode_bits(bits: Sequence[int], contexts: Sequence[int], models: Sequence[Sequence[int]]) -> bytes:
    """Codes bits with adaptive models; gives the bytes of `splatwire.entropy.coder.encode_bits`.

    A model is two estimates of P(0) out of 2**16, one that moves by 1/128 of the error and one that moves by 1/16; the
    interval of a zero is their mean, kept between 32 and 65504.
    """
    coder, state = ReferenceEncoder(), [list(m) for m in models]
    for bit, context in zip(bits, contexts, strict=True):
        slow, fast = state[context]
        zero = min(max((slow + fast) >> 1, 32), 65536 - 32)
        coder.encode(*((zero, 65536 - zero) if bit else (0, zero)), 16)
        if bit:
            state[context] = [slow - (slow >> 7), fast - (fast >> 4)]
        else:
            state[context] = [slow + ((65536 - slow) >> 7), fast + ((65536 - fast) >> 4)]
    return coder.finish()
