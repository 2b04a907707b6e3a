"""Origin of a geo-referenced scene: a named section of the side information."""

from collections.abc import Mapping

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.packets import SceneStream
from splatwire.packets.sections import sections_of
from splatwire.scene.origin import NO_ORIGIN, Origin, check_origin

SECTION = "origin"
"""Name of the section: x, y and z as `f64`, world units."""


def origin_sections(origin: Origin) -> dict[str, bytes]:
    """Returns the section of an origin by its name; none for (0, 0, 0): such streams stay unchanged."""
    if origin == NO_ORIGIN:
        return {}
    writer = ByteWriter()
    for value in origin:
        writer.f64(value)
    return {SECTION: writer.bytes()}


def read_origin(sections: Mapping[str, bytes]) -> Origin:
    """Returns the origin in named sections; (0, 0, 0) where there is none.

    Raises:
        BitstreamError: If the section is damaged.
    """
    if SECTION not in sections:
        return NO_ORIGIN
    reader = ByteReader(sections[SECTION], f"section '{SECTION}'")
    values = (reader.f64(), reader.f64(), reader.f64())
    reader.finish()
    try:
        return check_origin(values)
    except InvalidValueError as error:
        raise BitstreamError(f"side information: {error}") from None


def origin_of_stream(stream: SceneStream) -> Origin:
    """Returns the origin of a stream's scene without decoding it.

    Raises:
        BitstreamError: If its side information is damaged.
    """
    return read_origin(sections_of(stream))
