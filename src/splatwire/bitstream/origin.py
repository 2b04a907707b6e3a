"""Origin of a geo-referenced scene: a named section of the side information."""

from splatwire.bitstream.vector_section import VectorSection
from splatwire.errors import InvalidValueError

MAX_COORDINATE = 1e12
"""Largest absolute coordinate of an origin, world units."""
AT_ZERO = (0.0, 0.0, 0.0)
"""Origin of a scene whose stream does not contain the section."""


def _checked(values: tuple[float, float, float]) -> tuple[float, float, float]:
    if not all(abs(value) <= MAX_COORDINATE for value in values):
        raise InvalidValueError(f"an origin is three numbers within {MAX_COORDINATE:g}, not {values}")
    x, y, z = (value + 0.0 for value in values)  # no -0
    return x, y, z


ORIGIN_SECTION = VectorSection("origin", AT_ZERO, _checked, wide=True)
"""Section with x, y and z of the origin as `f64`, world units."""
