"""Bits and whole numbers of a packet in plain Python, as `gaussian_packets` reads them."""

from reference.range_coder import ReferenceDecoder
from splatwire.codec.gaussians.layout import MAX_RESIDUAL


class ReferenceBits:
    """Reads all fields except residuals.

    Args:
        payload: Payload of a packet.
        zeros: Initial P(0) of each adaptive model, out of 2**16.
    """

    def __init__(self, payload: bytes, zeros: list[int]) -> None:
        self.coder = ReferenceDecoder(payload)
        self.models = [[zero] * 2 for zero in zeros]

    def bit(self, context: int) -> int:
        """A bit of an adaptive model."""
        model = self.models[context]
        zero = min(max((model[0] + model[1]) >> 1, 32), 65536 - 32)
        one = int(self.coder.target(16) >= zero)
        self.coder.advance(zero if one else 0, 65536 - zero if one else zero, 16)
        for estimate, rate in ((0, 7), (1, 4)):
            p = model[estimate]
            model[estimate] = p - (p >> rate) if one else p + ((65536 - p) >> rate)
        return one

    def raw(self, bits: int) -> int:
        """Equiprobable bits, at most 16 at a time."""
        value = 0
        while bits > 0:
            some = min(bits, 16)
            found, bits = self.coder.target(some), bits - some
            self.coder.advance(found, 1, some)
            value = value << some | found
        return value

    def below(self, count: int) -> int:
        """A number below `count` with equal probabilities."""
        value = ((self.coder.target(16) + 1) * count - 1) >> 16
        start = (value << 16) // count
        self.coder.advance(start, ((value + 1 << 16) // count) - start, 16)
        return value

    def gamma(self) -> int:
        """A non-negative number in Elias gamma code of at most 32 bits."""
        length = 0
        while length < 32 and self.raw(1):
            length += 1
        value = 1
        for _ in range(length):
            value = value << 1 | self.raw(1)
        return min(value - 1, MAX_RESIDUAL)
