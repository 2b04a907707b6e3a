"""Background colour of a scene."""

from collections.abc import Sequence

from splatwire.errors import InvalidValueError, shown

Background = tuple[float, float, float]
"""Red, green and blue, 0 to 1."""
BLACK: Background = (0.0, 0.0, 0.0)
WHITE: Background = (1.0, 1.0, 1.0)


def check_background(values: object) -> Background:
    """Validates a colour read from a file or an option, and returns it as three floats.

    Raises:
        InvalidValueError: If `values` is not three numbers from 0 to 1.
    """
    if (
        not isinstance(values, Sequence)
        or len(values) != 3
        or not all(type(value) in (int, float) and 0 <= value <= 1 for value in values)
    ):
        raise InvalidValueError(f"a background is three numbers from 0 to 1, not {shown(values)}")
    red, green, blue = map(float, values)
    return red, green, blue
