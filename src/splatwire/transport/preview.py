"""What a welcome shows of a scene: the section `preview` of its side information, found without decoding anything."""

from splatwire.byte_io import ByteReader
from splatwire.errors import BitstreamError
from splatwire.transport.wire import MAX_PREVIEW

SECTION = "preview"
FIXED_SECTIONS = 7
"""Sections without a name, before those that have one (docs/format.md)."""


def stream_preview(side_info: bytes) -> bytes:
    """The preview that a stream carries; nothing where it has none.

    Raises:
        BitstreamError: If the bytes are not side information, or the preview does not fit a welcome.
    """
    reader = ByteReader(side_info, "side information")
    for _ in range(FIXED_SECTIONS):
        reader.blob()
    while reader.left:
        name, content = reader.blob(), reader.blob()
        if name == SECTION.encode():
            if len(content) > MAX_PREVIEW:
                raise BitstreamError(f"a preview of {len(content):,} bytes: a welcome carries at most {MAX_PREVIEW}")
            return content
    return b""
