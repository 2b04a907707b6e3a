"""Background colour of a scene."""

from collections.abc import Sequence

from splatwire.errors import InvalidValueError, shown

Background = tuple[float, float, float]
"""Red, green and blue, 0 to 1."""
BLACK: Background = (0.0, 0.0, 0.0)
WHITE: Background = (1.0, 1.0, 1.0)
_MAX_SHOWN = 4
"""Maximum number of values that a message about a wrong colour shows."""


def check_background(values: object) -> Background:
    """Validates a colour read from a file or an option, and returns it as three floats.

    Args:
        values: Three numbers, also as an array.

    Raises:
        InvalidValueError: If `values` is not three numbers from 0 to 1.
    """
    given = values
    if hasattr(values, "tolist"):
        values = values.tolist()
    elif isinstance(values, list | tuple):
        values = [value.tolist() if hasattr(value, "tolist") else value for value in values]
    if (
        not isinstance(values, Sequence)
        or len(values) != 3
        or not all(type(value) in (int, float) and 0 <= value <= 1 for value in values)
    ):
        text = shown(given)
        if isinstance(values, list | tuple) and len(values) <= _MAX_SHOWN:
            text = f"({', '.join(map(shown, values))})"
        raise InvalidValueError(f"a background is three numbers from 0 to 1, not {text}")
    red, green, blue = map(float, values)
    return red, green, blue
