"""A stream and its receiver in one HTML file, to mail or to put on any web server."""

import base64
import hashlib
import html

from splatwire.errors import InvalidValueError
from splatwire.packets import SceneStream, stream_to_bytes
from splatwire.transport.page_content import DRAWING, SCRIPT, STYLE, web_file

_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src '{drawing_hash}' '{script_hash}'; \
style-src '{style_hash}'; img-src data:; worker-src blob:; base-uri 'none'; form-action 'none'">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
<main><h1>{title}</h1><splat-wire data="stream"></splat-wire></main>
<noscript>This page draws with JavaScript.</noscript>
<script type="application/octet-stream" id="stream">{stream}</script>
<script type="module">{drawing}</script>
<script type="module">{script}</script>
</html>
"""


def pack_stream(stream: SceneStream, title: str) -> bytes:
    """Writes a page that holds a stream.

    Args:
        stream: The stream; what was lost is concealed by the page.
        title: What the page is called.

    Raises:
        InvalidValueError: If the page does not decode such streams.
    """
    if not stream.manifest.schema.page:
        raise InvalidValueError(
            f"a stream of {stream.manifest.elements} is not for browsers where it has format 1 or a schema of its own: "
            "train with --model causal, or make explicit Gaussians of it (splatwire export ply, then splatwire encode)"
        )
    script, drawing, style = web_file(SCRIPT), web_file(DRAWING), web_file(STYLE)
    return _PAGE.format(
        drawing_hash=_source_hash(drawing),
        script_hash=_source_hash(script),
        style_hash=_source_hash(style),
        title=html.escape(title),
        style=style,
        stream=base64.b64encode(stream_to_bytes(stream)).decode(),
        drawing=drawing,
        script=script,
    ).encode()


def _source_hash(text: str) -> str:
    """How a content security policy names an inline script or style."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
