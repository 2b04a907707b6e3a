"""Antialiasing flag of a scene: an empty named section of the side information.

The flag is set if the scene needs antialiased rendering, which lowers the opacity of Gaussians that it widens to a
pixel (Mip-Splatting).
"""

SECTION = "antialiased"
"""Name of the section."""


def antialiasing_sections(antialiased: bool) -> dict[str, bytes]:
    """Returns the antialiasing flag as a named section of the side information, or no section if unset."""
    return {SECTION: b""} if antialiased else {}
