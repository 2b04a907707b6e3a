"""Named sections behind the fixed part of the side information: what only some streams have (docs/format.md)."""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.packets.limits import MAX_SECTION_BYTES, MAX_SECTION_NAME, MAX_SECTIONS, RESERVED_SECTIONS, SCHEMAS
from splatwire.packets.scene_stream import SceneStream

_NAME = re.compile(f"[a-z][a-z0-9_]{{0,{MAX_SECTION_NAME - 1}}}", re.ASCII)


def write_sections(sections: Mapping[str, bytes]) -> bytes:
    """Writes named sections: for each, in the order of the names, the name and the content behind their sizes.

    Args:
        sections: Content by name; nothing for no byte.

    Raises:
        InvalidValueError: If a name is not possible, or there are too many or too large sections.
    """
    if wrong := _problem(sections):
        raise InvalidValueError(wrong)
    writer = ByteWriter()
    for name in sorted(sections):
        writer.blob(name.encode())
        writer.blob(sections[name])
    return writer.bytes()


def read_sections(data: bytes) -> dict[str, bytes]:
    """Reads what `write_sections` wrote; sections that this release does not know are read like any other.

    Raises:
        BitstreamError: If the bytes are damaged, or a name is there twice or out of order.
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
    """What is wrong with some sections, in words."""
    if len(sections) > MAX_SECTIONS:
        return f"{len(sections)} named sections, at most {MAX_SECTIONS} are possible"
    for name, data in sections.items():
        if not _NAME.fullmatch(name) or name in RESERVED_SECTIONS:
            return f"a section cannot be called {ascii(name)[:40]}"
        if len(data) > MAX_SECTION_BYTES:
            return f"section '{name}' has {len(data):,} bytes, at most {MAX_SECTION_BYTES:,} are possible"
    return None


def split_sections(side_info: bytes, codec: str) -> tuple[bytes, dict[str, bytes]]:
    """Splits side information into its fixed part, as it is, and the named sections; decodes nothing.

    Raises:
        BitstreamError: If the bytes are not side information.
    """
    reader = ByteReader(side_info, "side information")
    for _ in SCHEMAS[codec].sections:
        reader.blob()
    rest = reader.rest()
    return side_info[: len(side_info) - len(rest)], read_sections(rest)


def sections_of(stream: SceneStream) -> dict[str, bytes]:
    """The named sections of a stream, content by name.

    Raises:
        BitstreamError: If its side information is damaged or missing.
    """
    return split_sections(stream.side_info, stream.manifest.codec)[1]


def side_info_parts(data: bytes, codec: str) -> dict[str, int]:
    """Bytes of each section of side information with its size (and name), without decoding it.

    Raises:
        BitstreamError: If the bytes are not side information.
    """
    fixed, sections = split_sections(data, codec)
    reader, sizes = ByteReader(fixed, "side information"), dict[str, int]()
    for name in SCHEMAS[codec].sections:
        before = reader.left
        reader.blob()
        sizes[name] = before - reader.left
    return sizes | {name: len(write_sections({name: content})) for name, content in sections.items()}


def add_concealment(stream: SceneStream, name: str, data: bytes) -> SceneStream:
    """Puts a named section into a stream's side information, in the place of one that has this name.

    Packets, and with them the stream's id, stay as they are: a receiver may mix packets from before and after.

    Args:
        stream: The stream, complete or not.
        name: Name of the section, for example that of the concealer which reads it.
        data: Its content.

    Returns:
        The stream with new side information and a manifest that has its digest.

    Raises:
        InvalidValueError: If the name or the size is not possible.
        BitstreamError: If the stream's side information is damaged or missing.
    """
    fixed, sections = split_sections(stream.side_info, stream.manifest.codec)
    return _with_side_info(stream, fixed + write_sections({**sections, name: data}))


def without_concealment(stream: SceneStream, name: str) -> SceneStream:
    """Takes a named section out of a stream's side information; the inverse of `add_concealment`.

    Returns:
        The stream without it; the same stream where there was none.

    Raises:
        BitstreamError: If the stream's side information is damaged or missing.
    """
    fixed, sections = split_sections(stream.side_info, stream.manifest.codec)
    return _with_side_info(stream, fixed + write_sections({n: d for n, d in sections.items() if n != name}))


def _with_side_info(stream: SceneStream, side_info: bytes) -> SceneStream:
    digest = hashlib.sha256(side_info).hexdigest()
    manifest = replace(stream.manifest, side_info_bytes=len(side_info), side_info_digest=digest)
    return replace(stream, manifest=manifest, side_info=side_info)
