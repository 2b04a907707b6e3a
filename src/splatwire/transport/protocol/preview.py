"""Reads the encoded preview (about a hundred Gaussians) of a stream, which clients get first."""

from splatwire.bitstream.sections import split_sections
from splatwire.errors import BitstreamError
from splatwire.transport.protocol.messages import MAX_PREVIEW

SECTION = "preview"


def stream_preview(side_info: bytes, schema_name: str) -> bytes:
    """Returns the encoded preview of a stream; empty if the stream has none.

    Args:
        side_info: Side information of the stream (data that all packets need).
        schema_name: Name of the stream's schema.

    Raises:
        BitstreamError: If the side information is malformed, or the preview is too large for the server's first
            response (welcome).
    """
    content = split_sections(side_info, schema_name)[1].get(SECTION, b"")
    if len(content) > MAX_PREVIEW:
        raise BitstreamError(f"a preview of {len(content):,} bytes: a welcome carries at most {MAX_PREVIEW}")
    return content
