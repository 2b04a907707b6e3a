"""SplitMix64 of one number in plain Python integers."""

from splatwire.bitstream.splitmix64 import GAMMA, MASK64, MULTIPLIERS


def splitmix64_reference(x: int) -> int:
    """Hashes one number in plain Python integers: the reference of `splitmix64`."""
    z = (x + GAMMA) & MASK64
    z = ((z ^ (z >> 30)) * MULTIPLIERS[0]) & MASK64
    z = ((z ^ (z >> 27)) * MULTIPLIERS[1]) & MASK64
    return z ^ (z >> 31)
