"""What of a stream a row needs, and its bytes by part: what a concealer does not read is not counted against it."""

from splatwire.codec import side_info_parts
from splatwire.conceal.registry import concealer_sections
from splatwire.packets import SceneStream
from splatwire.packets.sections import sections_of, without_concealment


def without_sections(stream: SceneStream, sections: set[str]) -> SceneStream:
    """The stream without some of its named sections."""
    for name in sorted(sections):
        stream = without_concealment(stream, name)
    return stream


def needed_stream(stream: SceneStream, concealer: str) -> SceneStream:
    """What of a stream a concealer needs: the sections that only others read are left out.

    Args:
        stream: The stream; it may carry sections for several concealers.
        concealer: Name of the concealer, or `name:FILE`, which reads the file instead of its section.

    Raises:
        BitstreamError: If the side information is damaged or missing.
    """
    name, _, file = concealer.partition(":")
    read_by = concealer_sections()
    others = set(read_by.values()) - {None if file else read_by.get(name)}
    return without_sections(stream, others & set(sections_of(stream)))


def stream_parts(stream: SceneStream) -> dict[str, int]:
    """Bytes of a stream by part, with the side information taken apart; they add up to the whole file."""
    parts = dict(stream.parts())
    whole = parts.pop("side_info")
    inner = side_info_parts(stream.side_info, stream.manifest.codec)
    side = {f"side_{name}": size for name, size in inner.items()}
    rest = whole - sum(side.values())
    return {**side, **({"side_other": rest} if rest else {}), **parts}
