"""The background of a scene: a named section of the side information that only scenes not on black have."""

from collections.abc import Mapping

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.packets import SceneStream
from splatwire.packets.sections import sections_of
from splatwire.scene.background import BLACK, Background, check_background

SECTION = "background"
"""Name of the section."""


def background_sections(background: Background) -> dict[str, bytes]:
    """The section of a background, by name; none for black, so that such streams are what they always were."""
    if background == BLACK:
        return {}
    writer = ByteWriter()
    for value in background:
        writer.f32(value)
    return {SECTION: writer.bytes()}


def read_background(sections: Mapping[str, bytes]) -> Background:
    """The background that named sections tell of; black where they tell of none.

    Raises:
        BitstreamError: If the section is damaged.
    """
    if SECTION not in sections:
        return BLACK
    reader = ByteReader(sections[SECTION], f"section '{SECTION}'")
    values = (reader.f32(), reader.f32(), reader.f32())
    reader.finish()
    try:
        return check_background(values)
    except InvalidValueError as error:
        raise BitstreamError(f"side information: {error}") from None


def background_of(stream: SceneStream) -> Background:
    """The background of a stream's scene; nothing is decoded.

    Raises:
        BitstreamError: If its side information is damaged.
    """
    return read_background(sections_of(stream))
