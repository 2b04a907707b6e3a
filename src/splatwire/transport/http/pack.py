"""HTML files that contain one or more streams and the player that shows them."""

import base64
import hashlib
import html
from collections.abc import Mapping
from urllib.parse import quote

from splatwire.arguments import checked
from splatwire.bitstream import Manifest, SceneStream, stream_to_bytes
from splatwire.errors import InvalidValueError
from splatwire.transport.http.content import RENDERER, SCRIPT, STYLE, web_file
from splatwire.transport.http.scene_list import preview_attributes, scene_list
from splatwire.transport.protocol.preview import stream_preview

_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src {hashes} 'wasm-unsafe-eval'; \
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
_SELECTION_SCRIPT = """\
const links = [...document.querySelectorAll("nav a")], element = document.querySelector("splat-wire");
function choose() {
  const [chosen] = location.hash.split("&"); // links to a view have further fields
  const found = links.findIndex(({ hash }) => hash === chosen), place = Math.max(found, 0);
  document.title = links[place].textContent;
  element.setAttribute("data", place ? `stream${place}` : "stream");
  for (const link of links) link.removeAttribute("aria-current");
  links[place].setAttribute("aria-current", "page");
}
addEventListener("hashchange", choose);
if (location.hash) choose();
"""
"""Script of the page that selects one of several streams by the fragment of the page's URL."""


@checked
def pack_stream(stream: SceneStream, title: str) -> bytes:
    """Returns an HTML page that contains a stream and the player for the stream.

    Args:
        stream: Stream to show; packets may be missing.
        title: Title of the page.

    Raises:
        InvalidValueError: If browsers cannot decode the stream.
    """
    return pack_streams({title: stream})


@checked
def pack_streams(streams: Mapping[str, SceneStream]) -> bytes:
    """Returns an HTML file that contains several streams, links to select one, and the player.

    Args:
        streams: Streams by title, the first is shown first; packets may be missing.

    Raises:
        InvalidValueError: If browsers cannot decode one of the streams.
    """
    for stream in streams.values():
        check_page_support(stream.manifest)
    style, scripts = web_file(STYLE), [web_file(RENDERER), web_file(SCRIPT)]
    if len(streams) > 1:
        scripts.append(_SELECTION_SCRIPT)
    title, previews = next(iter(streams)), {name: stream_attributes(stream) for name, stream in streams.items()}
    return _PAGE.format(
        hashes=" ".join(f"'{_source_hash(script)}'" for script in scripts),
        style_hash=_source_hash(style),
        title=html.escape(title),
        style=style,
        scenes=scene_list(previews, title, lambda name: f"#stream={quote(name, safe='')}"),
        streams="\n".join(_element(number, stream) for number, stream in enumerate(streams.values())),
        scripts="\n".join(f'<script type="module">{script}</script>' for script in scripts),
    ).encode()


def check_page_support(manifest: Manifest) -> None:
    """Checks that browsers can decode a stream.

    Args:
        manifest: Manifest of the stream.

    Raises:
        InvalidValueError: If the stream has format version 1, or a schema that the page does not support.
    """
    if not manifest.schema.page:
        raise InvalidValueError(
            f"a stream of {manifest.elements} is not for browsers where it has format 1 or a schema of its own: train "
            "with --model causal, or make explicit Gaussians of it (splatwire export ply, then splatwire encode); "
            "splatwire apply makes a stream of an update"
        )


def stream_attributes(stream: SceneStream) -> dict[str, str]:
    """Returns the HTML attributes with a stream's preview, initial view and up axis; empty without a preview."""
    schema_name = stream.manifest.schema_name
    return preview_attributes(stream.side_info, schema_name, stream_preview(stream.side_info, schema_name))


def _element(number: int, stream: SceneStream) -> str:
    """Returns the HTML element that contains a stream's bytes.

    Args:
        number: Index of the stream among the streams of the page.
        stream: The stream.
    """
    data = base64.b64encode(stream_to_bytes(stream)).decode()
    return f'<script type="application/octet-stream" id="stream{number or ""}">{data}</script>'


def _source_hash(text: str) -> str:
    """Returns the hash of an inline script or style for the page's Content Security Policy."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
