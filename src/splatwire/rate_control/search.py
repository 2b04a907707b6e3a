"""Search for the argument at which an increasing function has a wanted value."""

from collections.abc import Callable
from dataclasses import dataclass

TRIALS = 12
"""Maximum number of calls of the function."""


@dataclass(frozen=True)
class Interval:
    """Range of function values that a search accepts, and the value that it aims at.

    Attributes:
        low: Smallest permitted value.
        wanted: Value to aim at.
        high: Largest permitted value.
    """

    low: float
    wanted: float
    high: float

    def __contains__(self, value: float) -> bool:
        """True if the value is permitted."""
        return self.low <= value <= self.high


def search(
    function: Callable[[float], float],
    permitted: Interval,
    start: float,
    slope: float,
    argument_range: tuple[float, float],
    min_width: float = 0.0,
) -> float | None:
    """Searches for an argument at which an increasing, expensive function has a value in a given range.

    Args:
        function: The increasing function.
        permitted: Range of accepted values of the function. The search ends when a value is in this range.
        start: First argument to try.
        slope: Expected increase of the function per unit of its argument, above 0.
        argument_range: Smallest and largest argument to try.
        min_width: Minimum width of the interval of arguments that are still considered. The search ends without a
            result when the interval is narrower.

    Returns:
        The argument with an accepted value; None if none was found.
    """
    # It is the argument of the last call of the function.
    # There are at most `TRIALS` calls.
    low, high, at = *argument_range, min(max(start, argument_range[0]), argument_range[1])
    below: tuple[float, float] | None = None
    above: tuple[float, float] | None = None
    for trial in range(TRIALS):
        value = function(at)
        if value in permitted:
            return at
        if value < permitted.low:
            below, low = (at, value), at
        else:
            above, high = (at, value), at
        if low >= argument_range[1] or high <= argument_range[0] or high - low < min_width:
            return None
        if below is not None and above is not None:
            # Every second step halves the bracket, in case secants approach from one side.
            share = (permitted.wanted - below[1]) / max(above[1] - below[1], 1e-12) if trial % 2 else 0.5
            at = low + min(max(share, 0.1), 0.9) * (high - low)
        else:  # steps grow, in case the slope is smaller than expected
            at = min(max(at + 2**trial * (permitted.wanted - value) / slope, argument_range[0]), argument_range[1])
    return None
