"""Background colour of a scene: a named section of the side information, absent for black."""

from splatwire.bitstream.vector_section import VectorSection
from splatwire.types.background import BLACK, check_background

BACKGROUND_SECTION = VectorSection("background", BLACK, check_background)
"""Section with red, green and blue as `f32`, 0 to 1."""
