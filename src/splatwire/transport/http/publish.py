"""Files of a static web site with streams and the player, for a web host or CDN."""

import hashlib
import html
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import quote

from splatwire.bitstream import SceneStream, send_sequence, stream_to_bytes
from splatwire.errors import InvalidValueError
from splatwire.transport.http.content import RENDERER, SCRIPT, STYLE, web_file
from splatwire.transport.http.pack import check_page_support, stream_attributes
from splatwire.transport.http.scene_list import scene_list
from splatwire.version import __version__

HASH_DIGITS = 12
"""Number of hexadecimal digits of a content hash in a file name."""
FOREVER = "public, max-age=31536000, immutable"
"""`Cache-Control` of files whose name contains the hash of their content."""
REVALIDATED = "public, max-age=0, must-revalidate"
"""`Cache-Control` of files that are replaced under the same name."""
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' data:; "
    "worker-src blob:; connect-src 'self'; base-uri 'none'; form-action 'none'"
)
"""Content Security Policy of the pages."""
_SAFE_NAME = re.compile(r"[^/\\\0-\x1f]{1,120}")
_RESERVED_NAMES = {"index", "404"}
"""Names of pages that hosts show by themselves."""
_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>{title}</title>
{social}<link rel="icon" href="data:,">
<link rel="stylesheet" href="{player_folder}/{style}">
<link rel="modulepreload" href="{player_folder}/{script}">
<script type="module" src="{player_folder}/{script}"></script>
<main><h1>{title}</h1>{scenes}<splat-wire {attributes}></splat-wire></main>
<noscript>{picture}This page draws with JavaScript.</noscript>
</html>
"""


@dataclass(frozen=True)
class PublishedScene:
    """A scene of a static site.

    Attributes:
        stream: Complete stream that browsers can decode.
        thumbnail: JPEG file with a picture of the scene; None for no thumbnail.
    """

    stream: SceneStream
    thumbnail: bytes | None = None


def published_files(scenes: Mapping[str, PublishedScene], url: str | None = None) -> dict[str, bytes]:
    """Returns the content of each file of a static site, by relative path, in the order in which files are written.

    Args:
        scenes: Scenes by name; `index.html` shows the first, `NAME.html` each other one.
        url: Address of the site, such as `https://example.org/splats`, for link previews in other programs; None for no
            link previews.

    Raises:
        InvalidValueError: If there is no scene, a stream is incomplete or cannot be decoded by browsers, or a name
            cannot be a file name.
    """
    if not scenes:
        raise InvalidValueError("a site needs at least one scene")
    for name, scene in scenes.items():
        _check_scene(name, scene.stream)
    if len({name.casefold() for name in scenes}) < len(scenes):
        raise InvalidValueError(
            "two names of scenes differ only in case, so some disks have one file for both: rename one"
        )
    player_folder, files = _player_folder(), dict[str, bytes]()
    for file in (SCRIPT, RENDERER, STYLE):
        files[f"{player_folder}/{file}"] = web_file(file).encode()
    paths, pictures = dict[str, str](), dict[str, str]()
    for name, scene in scenes.items():
        data = stream_to_bytes(scene.stream.with_packets(send_sequence(scene.stream, "tiers")))
        paths[name] = _hashed_path(f"streams/{name}", data, "swz")
        files[paths[name]] = data
        if scene.thumbnail is not None:
            pictures[name] = _hashed_path(f"thumbnails/{name}", scene.thumbnail, "jpg")
            files[pictures[name]] = scene.thumbnail
    files["_headers"] = _netlify_headers(player_folder).encode()
    files["vercel.json"] = _vercel_headers(player_folder).encode()
    files["streams.json"] = json.dumps({"streams": [f"/{quote(path)}" for path in paths.values()]}).encode()
    pages = {name: f"{name}.html" if number else "index.html" for number, name in enumerate(scenes)}
    previews = {name: stream_attributes(scene.stream) for name, scene in scenes.items()}
    for name in reversed(list(scenes)):
        base = None if url is None else url.rstrip("/")
        listed = scene_list(previews, name, lambda other: quote(pages[other]))
        attributes = {"src": quote(paths[name]), **_viewer_attributes(previews[name])}
        files[pages[name]] = _PAGE.format(
            policy=POLICY,
            title=html.escape(name),
            social=_link_preview(name, base, pages[name], pictures.get(name)),
            player_folder=player_folder, style=STYLE, script=SCRIPT,
            scenes=listed,
            attributes=" ".join(f'{key}="{html.escape(value)}"' for key, value in attributes.items()),
            picture=f'<img src="{quote(pictures[name])}" alt="{html.escape(name)}"> ' if name in pictures else "",
        ).encode()  # fmt: skip
    return files


def _check_scene(name: str, stream: SceneStream) -> None:
    if not _SAFE_NAME.fullmatch(name) or name.startswith(".") or name.lower() in _RESERVED_NAMES:
        raise InvalidValueError(f"a scene called {name!r:.60} cannot have a file of that name: rename it")
    check_page_support(stream.manifest)
    if missing := stream.manifest.num_packets - len(stream.packets):
        raise InvalidValueError(f"{name}: {missing:,} of {stream.manifest.num_packets:,} packets are missing")


def _player_folder() -> str:
    """Returns the name of the folder of the player's files, with version and content hash."""
    digest = hashlib.sha256("\0".join(map(web_file, (SCRIPT, RENDERER, STYLE))).encode()).hexdigest()
    return f"splatwire-{__version__}-{digest[:HASH_DIGITS]}"


def _hashed_path(stem: str, data: bytes, suffix: str) -> str:
    return f"{stem}.{hashlib.sha256(data).hexdigest()[:HASH_DIGITS]}.{suffix}"


def _viewer_attributes(preview: Mapping[str, str]) -> dict[str, str]:
    """Returns a scene's HTML attributes with the attribute `data` renamed to `preview`, as the viewer element expects.

    Args:
        preview: HTML attributes from `preview_attributes`.
    """
    return {("preview" if name == "data" else name): value for name, value in preview.items()}


def _link_preview(name: str, url: str | None, page: str, picture: str | None) -> str:
    """Returns the HTML elements from which messengers build a preview of a link to a page.

    Args:
        name: Name of the scene.
        url: Address of the site; None for no link previews.
        page: Relative path of the page.
        picture: Relative path of the picture; None without a picture.
    """
    if url is None:
        return ""
    tags = {"og:title": name, "og:type": "website", "og:url": f"{url}/{quote(page)}"}
    if picture is not None:
        tags |= {"og:image": f"{url}/{quote(picture)}", "twitter:card": "summary_large_image"}
    return "".join(f'<meta property="{key}" content="{html.escape(value)}">\n' for key, value in tags.items())


def _header_rules(player_folder: str) -> dict[str, dict[str, str]]:
    """Returns the HTTP response headers that a web host must send for a static site.

    Args:
        player_folder: Name of the folder with the scripts and style sheets of the player.

    Returns:
        For each URL pattern, the header values by header name.
    """
    shared = {"Access-Control-Allow-Origin": "*", "Cross-Origin-Resource-Policy": "cross-origin"}
    return {
        "/*": {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"},
        f"/{player_folder}/*": {"Cache-Control": FOREVER, **shared},
        "/streams/*": {
            "Cache-Control": f"{FOREVER}, no-transform",
            "Content-Type": "application/octet-stream",
            "Access-Control-Expose-Headers": "Content-Encoding, Content-Range, ETag",
            **shared,
        },
        "/thumbnails/*": {"Cache-Control": FOREVER},
        "/streams.json": {"Cache-Control": REVALIDATED, **shared},
        "/*.html": {"Cache-Control": REVALIDATED},
        "/": {"Cache-Control": REVALIDATED},
    }


def _netlify_headers(player_folder: str) -> str:
    """Returns the text of the file `_headers`, which sets the HTTP headers of a site at Netlify and Cloudflare Pages.

    Args:
        player_folder: Name of the folder with the scripts and style sheets of the player.
    """
    blocks = [
        "\n".join([path, *(f"  {key}: {value}" for key, value in rule.items())])
        for path, rule in _header_rules(player_folder).items()
    ]
    return "\n".join([*blocks, ""])


def _vercel_headers(player_folder: str) -> str:
    """Returns the text of the file `vercel.json`, from which the web host Vercel takes the HTTP headers of a site.

    Args:
        player_folder: Name of the folder with the scripts and style sheets of the player.
    """
    rules = [
        {
            "source": re.escape(path).replace(r"\*", "(.*)").replace(r"\.", ".").replace(r"\-", "-"),
            "headers": [{"key": key, "value": value} for key, value in rule.items()],
        }
        for path, rule in _header_rules(player_folder).items()
    ]
    return json.dumps({"headers": rules}, indent=2) + "\n"
