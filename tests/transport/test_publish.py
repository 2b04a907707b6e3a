"""The folder of a static site: its files, their names, references and headers."""

import hashlib
import html.parser
import json
import re
from dataclasses import replace
from urllib.parse import unquote

import pytest

from explicit import ball_of_gaussians, encode_splats
from splatwire.bitstream import Packetization, stream_from_bytes
from splatwire.errors import InvalidValueError
from splatwire.transport.http.publish import FOREVER, PublishedScene, published_files


@pytest.fixture(scope="module")
def stream():
    return encode_splats(ball_of_gaussians(), Packetization(block_size=100, lanes=2))


class References(html.parser.HTMLParser):
    """Relative addresses in a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found = set()

    def handle_starttag(self, tag, attributes):
        self.found |= {unquote(value) for name, value in attributes if name in ("src", "href")}


def test_every_reference_of_a_page_is_a_file_and_every_file_has_its_use(stream):
    files = published_files({"a room": PublishedScene(stream, b"jpeg"), "two & three": PublishedScene(stream)})
    assert {path for path in files if path.endswith(".html")} == {"index.html", "two & three.html"}
    referenced = set()
    for path in ("index.html", "two & three.html"):
        page = References()
        page.feed(files[path].decode())
        page.feed("".join(re.findall(r"<noscript>(.*?)</noscript>", files[path].decode())))
        referenced |= {address for address in page.found if not address.startswith("data:")}
    assert referenced <= set(files)
    loaded_by_scripts = {path for path in files if path.endswith("/splatwire-view.js")}
    for_hosts = {"_headers", "vercel.json", "streams.json"}
    assert set(files) == referenced | loaded_by_scripts | for_hosts


def test_names_of_immutable_files_contain_the_hash_of_their_content(stream):
    files = published_files({"room": PublishedScene(stream, b"jpeg")})
    for path, data in files.items():
        if path.startswith(("streams/", "thumbnails/")):
            assert path.split(".")[-2] == hashlib.sha256(data).hexdigest()[:12]
    (streamed,) = (data for path, data in files.items() if path.startswith("streams/"))
    assert stream_from_bytes(streamed)[0].manifest.stream_id == stream.manifest.stream_id
    assert list(files)[-1] == "index.html"


def test_hosts_get_the_same_headers(stream):
    files = published_files({"room": PublishedScene(stream, b"jpeg")})
    blocks = [block.splitlines() for block in re.split(r"\n(?=/)", files["_headers"].decode().strip())]
    netlify = {path: dict(line.strip().split(": ", 1) for line in lines) for path, *lines in blocks}
    rules = json.loads(files["vercel.json"])["headers"]
    vercel = {rule["source"]: {each["key"]: each["value"] for each in rule["headers"]} for rule in rules}
    assert {path.replace("*", "(.*)"): headers for path, headers in netlify.items()} == vercel

    def headers(path):
        found = {}
        for pattern, rule in vercel.items():
            if re.fullmatch(pattern, f"/{path}"):
                found |= rule
        return found

    for path in files:
        if path.startswith(("splatwire-", "streams/")):
            assert headers(path)["Cache-Control"].startswith(FOREVER)
            assert headers(path)["Access-Control-Allow-Origin"] == "*"
        if path.endswith((".html", ".json")) and path != "vercel.json":
            assert "must-revalidate" in headers(path)["Cache-Control"]


def test_previews_of_links_need_the_address_of_the_site(stream):
    scenes = {"room": PublishedScene(stream, b"jpeg")}
    assert "og:image" not in published_files(scenes)["index.html"].decode()
    page = published_files(scenes, "https://example.org/splats/")["index.html"].decode()
    assert re.search(r'og:image" content="https://example.org/splats/thumbnails/room.[0-9a-f]{12}.jpg"', page)


def test_names_that_differ_only_in_case_are_refused(stream):
    with pytest.raises(InvalidValueError, match="only in case"):
        published_files({"Room": PublishedScene(stream), "room": PublishedScene(stream)})


@pytest.mark.parametrize("name", ["", "a/b", ".hidden", "index", "404", "a\nb"])
def test_impossible_names_are_refused(stream, name):
    with pytest.raises(InvalidValueError, match="rename it"):
        published_files({name: PublishedScene(stream)})


def test_an_incomplete_stream_is_refused(stream):
    with pytest.raises(InvalidValueError, match="1 of"):
        published_files({"room": PublishedScene(replace(stream, packets=stream.packets[1:]))})
    with pytest.raises(InvalidValueError, match="at least one"):
        published_files({})
