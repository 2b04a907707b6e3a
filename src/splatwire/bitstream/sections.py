"""Optional parts of the side information, each identified by a name (named sections)."""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace

from splatwire.arguments import checked
from splatwire.bitstream.limits import MAX_SECTION_BYTES, MAX_SECTION_NAME, MAX_SECTIONS, RESERVED_SECTIONS, SCHEMAS
from splatwire.bitstream.scene_stream import SceneStream
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.files.byte_io import ByteReader, ByteWriter

_NAME = re.compile(f"[a-z][a-z0-9_]{{0,{MAX_SECTION_NAME - 1}}}", re.ASCII)


def write_sections(sections: Mapping[str, bytes]) -> bytes:
    """Serialises the named sections (optional parts) of side information.

    Args:
        sections: Content by name; may be empty.

    Raises:
        InvalidValueError: If a name is invalid, a section is too large, or there are too many sections.
    """
    if wrong := _problem(sections):
        raise InvalidValueError(wrong)
    writer = ByteWriter()
    for name in sorted(sections):
        writer.blob(name.encode())
        writer.blob(sections[name])
    return writer.bytes()


def read_sections(data: bytes) -> dict[str, bytes]:
    """Parses the named sections (optional parts) of side information; returns their content by name.

    Raises:
        BitstreamError: If the bytes are damaged, or a name is duplicated or out of order.
    """
    reader, sections, last = ByteReader(data, "side information sections"), dict[str, bytes](), ""
    while reader.left:
        name = reader.blob().decode("latin-1")
        if not _NAME.fullmatch(name):
            raise BitstreamError(f"side information: {ascii(name)[:40]} is no name of a section")
        if name <= last:
            raise BitstreamError(f"side information: section '{name}' is there twice or out of order")
        sections[name], last = reader.blob(), name
        if wrong := _problem(sections):
            raise BitstreamError(f"side information: {wrong}")
    return sections


def _problem(sections: Mapping[str, bytes]) -> str | None:
    """Returns a message about the first problem of the sections; None if all sections are valid.

    A problem is an excessive number of sections, or a section that is too large or has an invalid name.
    """
    if len(sections) > MAX_SECTIONS:
        return f"{len(sections)} named sections, at most {MAX_SECTIONS} are possible"
    for name, data in sections.items():
        if not _NAME.fullmatch(name) or name in RESERVED_SECTIONS:
            return f"a section cannot be called {ascii(name)[:40]}"
        if len(data) > MAX_SECTION_BYTES:
            return f"section '{name}' has {len(data):,} bytes, at most {MAX_SECTION_BYTES:,} are possible"
    return None


def split_sections(side_info: bytes, schema_name: str) -> tuple[bytes, dict[str, bytes]]:
    """Divides side information into the fixed part and the named sections (content by name).

    Raises:
        BitstreamError: If the bytes are not side information.
    """
    reader = ByteReader(side_info, "side information")
    for _ in SCHEMAS[schema_name].sections:
        reader.blob()
    rest = reader.rest()
    return side_info[: len(side_info) - len(rest)], read_sections(rest)


def sections_of(stream: SceneStream) -> dict[str, bytes]:
    """Returns the named sections in a stream's side information, without the fixed ones: content by name.

    Raises:
        BitstreamError: If its side information is damaged or missing.
    """
    return split_sections(stream.side_info, stream.manifest.schema_name)[1]


@checked
def side_info_parts(data: bytes, schema_name: str) -> dict[str, int]:
    """Returns the size of each section of side information, bytes, by section name.

    Raises:
        BitstreamError: If the bytes are not side information.
    """
    fixed, sections = split_sections(data, schema_name)
    reader, sizes = ByteReader(fixed, "side information"), dict[str, int]()
    for name in SCHEMAS[schema_name].sections:
        before = reader.left
        reader.blob()
        sizes[name] = before - reader.left
    return sizes | {name: len(write_sections({name: content})) for name, content in sections.items()}


@checked
def with_section(stream: SceneStream, name: str, data: bytes) -> SceneStream:
    """Adds a named section to a stream's side information.

    An existing section of the same name is replaced. The stream id stays, so that the packets remain valid.

    Args:
        stream: The stream, complete or not.
        name: Name of the section, such as that of a concealer or `viewpoint`.
        data: Content of the section.

    Returns:
        The stream with new side information.

    Raises:
        InvalidValueError: If the name is invalid or the section is too large.
        BitstreamError: If the stream's side information is damaged or missing.
    """
    fixed, sections = split_sections(stream.side_info, stream.manifest.schema_name)
    return _with_side_info(stream, fixed + write_sections({**sections, name: data}))


@checked
def without_section(stream: SceneStream, name: str) -> SceneStream:
    """Removes a named section from a stream's side information.

    Args:
        stream: The stream, complete or not.
        name: Name of the section.

    Returns:
        The stream without the section.

    Raises:
        BitstreamError: If the stream's side information is damaged or missing.
    """
    fixed, sections = split_sections(stream.side_info, stream.manifest.schema_name)
    return _with_side_info(stream, fixed + write_sections({n: d for n, d in sections.items() if n != name}))


def _with_side_info(stream: SceneStream, side_info: bytes) -> SceneStream:
    digest = hashlib.sha256(side_info).hexdigest()
    manifest = replace(stream.manifest, side_info_bytes=len(side_info), side_info_digest=digest)
    return replace(stream, manifest=manifest, side_info=side_info)
