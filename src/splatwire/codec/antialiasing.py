"""Whether a scene's Gaussians were trained to lose opacity as they are widened: an empty section that says yes."""

SECTION = "antialiased"
"""Name of the section."""


def antialiasing_sections(antialiased: bool) -> dict[str, bytes]:
    """The section by its name; none where it is not so, so that such streams are what they always were."""
    return {SECTION: b""} if antialiased else {}
