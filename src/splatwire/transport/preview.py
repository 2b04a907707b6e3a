"""What a welcome shows of a scene: the section `preview` of its side information, found without decoding anything."""

from splatwire.errors import BitstreamError
from splatwire.packets.sections import split_sections
from splatwire.transport.frames import MAX_PREVIEW

SECTION = "preview"


def stream_preview(side_info: bytes, codec: str) -> bytes:
    """The preview that a stream carries; nothing where it has none.

    Raises:
        BitstreamError: If the bytes are not side information, or the preview does not fit a welcome.
    """
    content = split_sections(side_info, codec)[1].get(SECTION, b"")
    if len(content) > MAX_PREVIEW:
        raise BitstreamError(f"a preview of {len(content):,} bytes: a welcome carries at most {MAX_PREVIEW}")
    return content
