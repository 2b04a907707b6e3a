"""Sizes of the parts of a stream: bytes of each attribute, and overhead."""

from splatwire.bitstream import SceneStream
from splatwire.bitstream.sections import sections_of, without_section
from splatwire.codec import side_info_parts
from splatwire.concealment.registry import concealer_sections


def without_sections(stream: SceneStream, sections: set[str]) -> SceneStream:
    """Returns the stream without the given named sections."""
    for name in sorted(sections):
        stream = without_section(stream, name)
    return stream


def needed_stream(stream: SceneStream, concealer: str) -> SceneStream:
    """Removes the sections of side information that only other concealers read.

    Args:
        stream: The stream; may contain sections for several concealers.
        concealer: Name of the concealer; `name:FILE` for a concealer that reads a file instead of its section.

    Raises:
        BitstreamError: If the side information is damaged or missing.
    """
    name, _, file = concealer.partition(":")
    read_by = concealer_sections()
    others = set(read_by.values()) - {None if file else read_by.get(name)}
    return without_sections(stream, others & set(sections_of(stream)))


def stream_parts(stream: SceneStream) -> dict[str, int]:
    """Returns the bytes of each part of a stream (attributes, headers, sections); the sum is the file size."""
    parts = dict(stream.part_sizes())
    whole = parts.pop("side_info")
    inner = side_info_parts(stream.side_info, stream.manifest.schema_name)
    side = {f"side_{name}": size for name, size in inner.items()}
    rest = whole - sum(side.values())
    return {**side, **({"side_other": rest} if rest else {}), **parts}
