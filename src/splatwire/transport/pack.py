"""Streams and their receiver in one HTML file, to mail or to put on any web server."""

import base64
import hashlib
import html
from collections.abc import Mapping
from urllib.parse import quote

from splatwire.errors import InvalidValueError
from splatwire.packets import SceneStream, stream_to_bytes
from splatwire.transport.page_content import DRAWING, SCRIPT, STYLE, web_file
from splatwire.transport.preview import stream_preview
from splatwire.transport.scene_list import scene_list, told_of

_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src {hashes}; \
style-src '{style_hash}'; img-src data:; worker-src blob:; base-uri 'none'; form-action 'none'">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>{style}</style>
<main><h1>{title}</h1>{scenes}<splat-wire data="stream"></splat-wire></main>
<noscript>This page draws with JavaScript.</noscript>
{streams}
{scripts}
</html>
"""
_CHOOSE = """\
const links = [...document.querySelectorAll("nav a")], element = document.querySelector("splat-wire");
function choose() {
  const found = links.findIndex(({ hash }) => hash === location.hash), place = Math.max(found, 0);
  document.title = links[place].textContent;
  element.setAttribute("data", place ? `stream${place}` : "stream");
  for (const link of links) link.removeAttribute("aria-current");
  links[place].setAttribute("aria-current", "page");
}
addEventListener("hashchange", choose);
if (location.hash) choose();
"""
"""Shows what the address names, where there are several streams."""


def pack_stream(stream: SceneStream, title: str) -> bytes:
    """Writes a page that holds a stream; see `pack_streams`."""
    return pack_streams({title: stream})


def pack_streams(streams: Mapping[str, SceneStream]) -> bytes:
    """Writes a page that holds streams and shows the first; where there are several, a list leads to the others.

    Args:
        streams: Streams by what they are called; what was lost is concealed by the page.

    Raises:
        InvalidValueError: If the page does not decode such streams.
    """
    for stream in streams.values():
        if not stream.manifest.schema.page:
            raise InvalidValueError(
                f"a stream of {stream.manifest.elements} is not for browsers where it has format 1 or a schema of "
                "its own: train with --model causal, or make explicit Gaussians of it (splatwire export ply, then "
                "splatwire encode)"
            )
    style, scripts = web_file(STYLE), [web_file(DRAWING), web_file(SCRIPT), *([_CHOOSE] if len(streams) > 1 else [])]
    title, told = next(iter(streams)), {name: _told(stream) for name, stream in streams.items()}
    return _PAGE.format(
        hashes=" ".join(f"'{_source_hash(script)}'" for script in scripts),
        style_hash=_source_hash(style),
        title=html.escape(title),
        style=style,
        scenes=scene_list(told, title, lambda name: f"#stream={quote(name, safe='')}"),
        streams="\n".join(_element(place, stream) for place, stream in enumerate(streams.values())),
        scripts="\n".join(f'<script type="module">{script}</script>' for script in scripts),
    ).encode()


def _told(stream: SceneStream) -> dict[str, str]:
    codec = stream.manifest.codec
    return told_of(stream.side_info, codec, stream_preview(stream.side_info, codec))


def _element(place: int, stream: SceneStream) -> str:
    """What holds the bytes of a stream."""
    data = base64.b64encode(stream_to_bytes(stream)).decode()
    return f'<script type="application/octet-stream" id="stream{place or ""}">{data}</script>'


def _source_hash(text: str) -> str:
    """How a content security policy names an inline script or style."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
