"""What a row of a table costs: bytes that its concealer does not read are not counted against it."""

from pathlib import Path

from splatwire.conceal.base import concealer_sections
from splatwire.packets import SceneStream
from splatwire.packets.sections import split_sections, without_concealment


def bytes_needed(stream: SceneStream, concealer: str) -> int:
    """Bytes of a stream for one concealer: with its own section or file of weights, without those of others.

    Args:
        stream: The stream; it may carry sections for several concealers.
        concealer: Name of the concealer, or `name:FILE`.

    Raises:
        BitstreamError: If the side information is damaged or missing.
    """
    name, _, file = concealer.partition(":")
    read_by = concealer_sections()
    own = None if file else read_by.get(name)
    for section in split_sections(stream.side_info)[1]:
        if section != own and section in read_by.values():
            stream = without_concealment(stream, section)
    return stream.num_bytes + (Path(file).stat().st_size if file else 0)
