"""Sections of the side information that contain three numbers, such as the origin or the background of a scene."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from splatwire.bitstream.scene_stream import SceneStream
from splatwire.bitstream.sections import sections_of, split_sections
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.files.byte_io import ByteReader, ByteWriter

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class VectorSection:
    """Codec of a named section with three numbers, such as the origin of a scene.

    Attributes:
        name: Name of the section.
        usual: Default numbers. A stream with these numbers has no such section.
        check: Function that validates the numbers and returns them, or raises `InvalidValueError`.
        wide: True to store the numbers as `f64`, False for `f32`.
    """

    name: str
    usual: Vector
    check: Callable[[Vector], Vector]
    wide: bool = False

    def sections(self, values: Vector) -> dict[str, bytes]:
        """Serialises the three numbers as the section of that name.

        Returns:
            Content of the section by its name; empty if the numbers are the default.
        """
        if values == self.usual:
            return {}
        writer = ByteWriter()
        for value in values:
            (writer.f64 if self.wide else writer.f32)(value)
        return {self.name: writer.bytes()}

    def of_stream(self, stream: SceneStream) -> Vector:
        """Reads the three numbers of the section from a stream's side information.

        Streams whose numbers equal `usual` have no such section. For them, `usual` is returned.

        Raises:
            BitstreamError: If the side information or the section is damaged.
        """
        return self.read(sections_of(stream))

    def of_side_info(self, side_info: bytes, schema_name: str) -> Vector:
        """Reads the three numbers of this kind of section, such as the origin, from serialised side information.

        Returns the default numbers (`usual`) if the side information has no such section.

        Args:
            side_info: The side information.
            schema_name: Name of the stream's schema.

        Raises:
            BitstreamError: If the bytes are not side information, or the section is damaged.
        """
        return self.read(split_sections(side_info, schema_name)[1])

    def read(self, sections: Mapping[str, bytes]) -> Vector:
        """Reads the three numbers from the sections of a stream, or returns the default.

        Args:
            sections: All named sections of a stream's side information, by name.

        Raises:
            BitstreamError: If the section is damaged.
        """
        if self.name not in sections:
            return self.usual
        reader = ByteReader(sections[self.name], f"section '{self.name}'")
        number = reader.f64 if self.wide else reader.f32
        values = (number(), number(), number())
        reader.finish()
        try:
            return self.check(values)
        except InvalidValueError as error:
            raise BitstreamError(f"side information: {error}") from None
