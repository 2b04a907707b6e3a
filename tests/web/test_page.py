"""The page: answers of its server, and the receiver in a real browser through the DevTools protocol."""

import asyncio
import base64
import gzip
import io
import json
import random
import struct
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from close import unit
from explicit import encode_splats
from random_numbers import Numbers
from scenes import tiny_scene
from splatwire.bitstream import PRESETS, Packetization, SceneStream, stream_from_bytes, stream_to_bytes
from splatwire.codec import encode_scene, with_section
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.initial_view import SECTION
from splatwire.errors import InvalidValueError
from splatwire.transport import ServedStream, make_served_stream
from splatwire.transport.http.content import FILES, PageContent, WebTransportEndpoint, served_stream_file, web_file
from splatwire.transport.http.pack import pack_stream
from splatwire.transport.http.server import PageServer
from splatwire.types.splat_scene import SplatScene
from splatwire.types.splats import Splats
from transport.chromium import Browser, executable, isolated_page
from transport.network import bernoulli
from transport.relay import Relay
from web.pictures import ELEMENT, check_concealed, check_pictures, half_of
from web.sketched import with_copies

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport.quic.certificate import self_signed
from splatwire.transport.quic.common import WEBTRANSPORT_PATH
from splatwire.transport.quic.server import QuicServer

pytestmark = pytest.mark.slow

STATUS = f"{ELEMENT}?.status"
SMALL = Packetization(block_size=600, lanes=1, grouping="hashed", packet_bytes=700)


def ball(count: int = 1500, degree: int = 2) -> Splats:
    rng = Numbers(4)
    directions = unit(rng.randn(count, 3))
    sh = rng.randn(count, (degree + 1) ** 2, 3) * 0.1
    sh[:, 0] += directions
    quats, sizes = (rng.randn(count, number) for number in (4, 3))
    opacities = rng.rand(count) * 0.9 + 0.05
    return Splats(directions, unit(quats), np.exp(sizes * 0.4 - 3), opacities, sh)


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0))


@pytest.fixture(scope="module")
def programs(stream: SceneStream) -> dict[str, ServedStream]:
    anchors = encode_scene(tiny_scene(seed=2, num_anchors=200), PRESETS["datagram"])
    return {"ball": make_served_stream(stream), "anchors": make_served_stream(anchors)}


def answered(content: PageContent, request: bytes) -> bytes:
    """The complete answer."""
    head, body = content.respond_now(request)
    assert isinstance(body, bytes | memoryview)
    return head + body


def run(work: Any) -> None:
    asyncio.run(asyncio.wait_for(work, 1800))


def status(page: Browser, key: str) -> Any:
    return page.evaluate(f"{STATUS}.{key}")


def opened(page: Browser, url: str) -> str:
    """Opens an address and returns how the stream ended, or its error."""
    page.open("about:blank")
    page.open(url)
    return str(page.wait_for(f"{STATUS} && ({STATUS}.finished || {STATUS}.failed)"))


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_redundant_copies_count_neither_as_received_nor_as_lost(stream: SceneStream, tmp_path: Path) -> None:
    """A complete stream shows no loss and its number of Gaussians; the reference picture has no copies."""
    packed = tmp_path / "packed.html"
    packed.write_bytes(pack_stream(with_copies(stream), "a ball with copies"))
    rows = f"[...{ELEMENT}.shadowRoot.querySelectorAll('dt')]"
    psnr_text = f"{rows}.find((dt) => dt.textContent === 'PSNR')?.nextSibling.textContent"
    with isolated_page() as page:
        assert opened(page, packed.as_uri()) == "complete"
        page.wait_for(f"{ELEMENT}.view && {ELEMENT}.controlPanel.settings.concealer === 'sketch'")
        page.wait_for(f"{psnr_text} === 'no loss'")
        assert status(page, "gaussians") == stream.manifest.num_elements
        check_pictures(page, stream, 40, "sketch")
        page.evaluate(f"{ELEMENT}.controlPanel.set({{show: 'lossless'}})")
        check_pictures(page, stream, 40)


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_browser_receives_decodes_and_renders(
    stream: SceneStream, programs: dict[str, ServedStream], tmp_path: Path
) -> None:
    """Covers 20 % loss, a packed file, HTTP without a session, and refusals."""
    identity, packed = self_signed(), tmp_path / "packed.html"
    packed.write_bytes(pack_stream(stream, "a <ball>"))

    async def work() -> None:
        async with AsyncExitStack() as stack:
            server = QuicServer(programs, "127.0.0.1", 0, identity=identity)
            stack.callback(server.close)
            await server.start()
            rng = random.Random(5)
            relay = Relay(server.port, bernoulli(0.2, rng), bernoulli(0.2, rng), delay_s=0.003)
            stack.callback(relay.close)
            lossy, broken = [
                await stack.enter_async_context(
                    PageServer(PageContent(programs, WebTransportEndpoint(relay.port, WEBTRANSPORT_PATH, digits)))
                )
                for digits in (identity.fingerprint, "0" * 64)
            ]
            links = iter(
                [WebTransportEndpoint(relay.port, WEBTRANSPORT_PATH, "1" * 64)] * 2
            )  # of a page before the renewal
            renewed = WebTransportEndpoint(relay.port, WEBTRANSPORT_PATH, identity.fingerprint)
            older = await stack.enter_async_context(PageServer(PageContent(programs, lambda: next(links, renewed))))
            half = half_of(with_copies(stream))
            gaps = await stack.enter_async_context(PageServer(PageContent({"half": stream_to_bytes(half)})))

            def drive() -> None:
                with isolated_page() as page:
                    assert opened(page, lossy.url) == "complete"
                    check_stream(page, stream, "WebTransport datagrams")
                    check_pictures(page, stream, 40)
                    check_settings(page)
                    check_concealed(page, gaps.url, half, 40)
                    assert opened(page, packed.as_uri()) == "complete"
                    check_stream(page, stream, "in this file")
                    assert opened(page, older.url) == "complete"
                    check_stream(page, stream, "WebTransport datagrams")
                    # Last: after failed handshakes, browsers delay the next ones.
                    assert opened(page, broken.url) == "complete"
                    check_stream(page, stream, "HTTP, in order and without loss")
                    assert "browsers cannot decode" in opened(page, f"{lossy.url}?stream=anchors")
                    assert "no such stream" in opened(page, f"{lossy.url}?stream=none") or "404" in status(
                        page, "failed"
                    )

            await asyncio.to_thread(drive)
            assert relay.num_lost > 10
            assert server.num_malformed == 0

    run(work())


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_subpixel_gaussians_follow_the_antialiasing_flag(tmp_path: Path) -> None:
    """The page renders like the renderer with and without antialiasing, and the two pictures differ."""
    splats, means = ball(4000), []
    small = replace(splats, scales=splats.scales * 0.06, opacities=splats.opacities.clip(0.7))
    with isolated_page() as page:
        for antialiased in (False, True):
            stream = encode_scene(SplatScene(small, antialiased=antialiased), SMALL, quality=Quality(10.0))
            packed = tmp_path / f"{antialiased}.html"
            packed.write_bytes(pack_stream(stream, "dots"))
            assert opened(page, packed.as_uri()) == "complete"
            picture = check_pictures(page, stream, 36.0)
            means.append(np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")).mean())
    assert means[1] < 0.6 * means[0]


SLOW_SORTER = """
globalThis.Worker = class extends Worker {
  addEventListener(type, listener) {
    super.addEventListener(type, (event) => event.data?.order ? setTimeout(listener, 600, event) : listener(event));
  }
};
"""
"""Script that delays each result of a sorting worker by 0.6 s, as on a busy machine."""


@pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
def test_a_picture_waits_for_the_depth_sort_of_its_camera(stream: SceneStream, tmp_path: Path) -> None:
    """Requests a picture while the Gaussians of another concealer are still sorted for the camera before."""
    packed = tmp_path / "packed.html"
    packed.write_bytes(pack_stream(stream, "a ball"))
    with isolated_page() as page:
        page.prepare(SLOW_SORTER)
        assert opened(page, packed.as_uri()) == "complete"
        for concealer in ("drop", "grow", "drop"):
            check_pictures(page, stream, 40, concealer)


def check_stream(page: Browser, stream: SceneStream, way: str) -> None:
    """Every integer in the browser equals Python's."""
    assert status(page, "packets") == len(stream.packets)
    assert status(page, "transport") == status(page, "way") == way  # the former name still works
    assert page.resolve(f"{ELEMENT}.verify()") is True
    page.wait_for(f"{STATUS}.gaussians === {stream.manifest.num_elements}")


def check_settings(page: Browser) -> None:
    """Packets that the user drops lower the quality, which the panel shows."""
    panel = f"{ELEMENT}.shadowRoot.querySelector('.panel')"
    assert "Concealer" not in page.evaluate(f"{panel}.innerText"), "the laboratory is open"
    page.evaluate(f"{ELEMENT}.controlPanel.open = true")
    assert page.evaluate(f"{ELEMENT}.controlPanel.concealers.join()") == "drop,grow,scene_free"
    assert page.evaluate(f"{panel}.querySelector('option[disabled]').innerText") == "sketch (not in this stream)"
    assert page.evaluate(f"/In bursts of 1 packet\\s/.test({panel}.innerText)")
    page.evaluate(f"{ELEMENT}.controlPanel.set({{lossRate: 0.3, show: 'difference', concealer: 'drop'}})")
    page.wait_for(f"/PSNR\\s+[0-9.]+ dB/.test({panel}.innerText)")
    assert page.evaluate(f"{ELEMENT}.shadowRoot.querySelector('.over').classList.contains('shown')")
    assert not page.evaluate(f"/dropped on purpose\\s+0 packets/.test({panel}.innerText)")
    picture = Image.open(io.BytesIO(base64.b64decode(page.screenshot())))
    assert np.asarray(picture.convert("L")).std() > 5, "an empty page"


def test_page_server_serves_only_its_files_and_streams(programs: dict[str, ServedStream], stream: SceneStream) -> None:
    content = PageContent(programs, WebTransportEndpoint(4840, "/splatwire", "ab" * 32), host="scenes.local")
    for request, code in (
        ("GET / HTTP/1.1\r\nHost: 127.0.0.1:80", b"200"),
        ("GET /?stream=other HTTP/1.1\r\nHost: localhost", b"200"),
        ("GET / HTTP/1.1\r\nhost: scenes.local:80", b"200"),
        ("GET / HTTP/1.1\r\nHost: [::1]:80", b"200"),
        ("HEAD /splatwire.js HTTP/1.0\r\nHost: 10.0.0.1", b"200"),
        ("GET /page.css?x HTTP/1.1\r\nHost: 10.0.0.1", b"200"),
        ("GET /streams/ball.swz HTTP/1.1\r\nHost: 10.0.0.1", b"200"),
        ("GET /streams/none.swz HTTP/1.1\r\nHost: 10.0.0.1", b"404"),
        ("GET /../page.py HTTP/1.1\r\nHost: 10.0.0.1", b"404"),
        ("GET //etc/passwd HTTP/1.1\r\nHost: 10.0.0.1", b"404"),
        ("POST / HTTP/1.1\r\nHost: 10.0.0.1", b"405"),
        ("GET / HTTP/1.1\r\nHost: rebound.example", b"403"),
        ("GET / HTTP/1.1", b"400"),
        ("\xff\xfe", b"400"),
        ("GET / HTTP/2\r\nHost: 10.0.0.1", b"400"),
    ):
        assert answered(content, request.encode("latin-1")).startswith(b"HTTP/1.1 " + code), request
    file = answered(content, b"GET /streams/ball.swz HTTP/1.1\r\nHost: 10.0.0.1").partition(b"\r\n\r\n")[2]
    assert file == served_stream_file(programs["ball"])
    assert stream_from_bytes(file)[0] == stream
    page = answered(content, b"GET /?stream=%22%3E%3Cscript%3E HTTP/1.1\r\nHost: 10.0.0.1:80").decode()
    assert "<script>" not in page
    assert "connect-src 'self' https://*:4840;" in page
    assert 'session=":4840/splatwire"' in page
    assert "10.0.0.1" not in page
    listing = json.loads(answered(content, b"GET /streams.json HTTP/1.1\r\nHost: 10.0.0.1").partition(b"\r\n\r\n")[2])
    assert listing["streams"] == ["/streams/ball.swz", "/streams/anchors.swz"]
    assert listing["port"] == 4840


def test_range_request_returns_that_part_of_a_stream(programs: dict[str, ServedStream]) -> None:
    content, file = PageContent(programs), served_stream_file(programs["ball"])
    size = len(file)
    for words, code, first, end in (
        ("bytes=100-", 206, 100, size),
        ("bytes=100-199", 206, 100, 200),
        ("bytes=100-99999999", 206, 100, size),
        ("bytes=-64", 206, size - 64, size),
        ("bytes=-0", 416, 0, 0),
        (f"bytes={size}-", 416, 0, 0),
        ("bytes=200-100", 200, 0, size),
        ("bytes=0-1,5-6", 200, 0, size),
        ("bytes=-", 200, 0, size),
        ("packets=0-", 200, 0, size),
    ):
        request = f"GET /streams/ball.swz HTTP/1.1\r\nHost: 10.0.0.1\r\nRange: {words}"
        head, _, body = answered(content, request.encode()).partition(b"\r\n\r\n")
        assert head.startswith(f"HTTP/1.1 {code} ".encode()), words
        assert b"Accept-Ranges: bytes" in head
        if code == 416:
            assert f"Content-Range: bytes */{size}".encode() in head
        else:
            assert body == file[first:end], words
        if code == 206:
            assert f"Content-Range: bytes {first}-{end - 1}/{size}".encode() in head


def test_stream_answers_are_cacheable_until_changed(programs: dict[str, ServedStream]) -> None:
    content, other = PageContent(programs, host="scenes.local"), PageContent({"ball": b"another"}, host="scenes.local")
    ask = "GET /streams/ball.swz{} HTTP/1.1\r\nHost: 10.0.0.1\r\n{}"

    def asked(content: PageContent, query: str = "", headers: str = "") -> tuple[bytes, dict[str, str]]:
        head, _, _ = answered(content, ask.format(query, headers).rstrip("\r\n").encode()).partition(b"\r\n\r\n")
        lines = head.decode().split("\r\n")
        return lines[0].encode(), dict(line.split(": ", 1) for line in lines[1:])

    status, headers = asked(content)
    tag = headers["ETag"]
    assert (status[9:12], headers["Cache-Control"]) == (b"200", "no-cache")
    assert "immutable" in asked(content, f"?{tag[1:-1]}")[1]["Cache-Control"]
    assert asked(other, f"?{tag[1:-1]}")[1]["Cache-Control"] == "no-cache"
    assert asked(content, "", f"If-None-Match: {tag}\r\n")[0][9:12] == b"304"
    assert asked(other, "", f"If-None-Match: {tag}\r\n")[0][9:12] == b"200"
    for server, got in ((content, b"206"), (other, b"200")):
        assert asked(server, "", f"Range: bytes=0-3\r\nIf-Range: {tag}\r\n")[0][9:12] == got
    page = answered(content, b"GET / HTTP/1.1\r\nHost: 10.0.0.1")
    assert f"streams/ball.swz?{tag[1:-1]}".encode() in page
    assert b"Cache-Control: no-cache\r\n" in page, "browsers would not keep the page for the back button"


@pytest.mark.parametrize("coding", ["", "gzip"])
def test_script_etags_identify_content_and_encoding(programs: dict[str, ServedStream], coding: str) -> None:
    content = PageContent(programs, host="10.0.0.1")

    def asked(name: str, tag: str = "") -> tuple[bytes, str]:
        lines = ["GET /{} HTTP/1.1", "Host: 10.0.0.1", f"Accept-Encoding: {coding}", f"If-None-Match: {tag}"]
        head, _, body = answered(content, "\r\n".join(lines).format(name).encode()).partition(b"\r\n\r\n")
        return body, head.decode()

    tags = set[str]()
    for name in FILES:
        body, head = asked(name)
        tag = head.partition('ETag: "')[2].partition('"')[0]
        tags.add(tag)
        assert (gzip.decompress(body) if coding else body).decode() == web_file(name)
        assert ("Content-Encoding: gzip" in head) == bool(coding)
        assert "Cache-Control: no-cache" in head
        assert "Vary: Accept-Encoding" in head
        assert tag.endswith("-gzip") == bool(coding)
        body, head = asked(name, f'"{tag}"')
        assert (head[9:12], body) == ("304", b"")
        assert asked(name, '"other"')[1][9:12] == "200"
    assert len(tags) == len(FILES)


def test_other_origins_can_read_validation_headers(programs: dict[str, ServedStream]) -> None:
    request = b"GET /streams/ball.swz HTTP/1.1\r\nHost: 10.0.0.1\r\nOrigin: https://a.example\r\nRange: bytes=0-3"
    head = answered(PageContent(programs, host="10.0.0.1", origins=("https://a.example",)), request).decode("latin-1")
    exposed = head.partition("Access-Control-Expose-Headers: ")[2].partition("\r\n")[0].split(", ")
    assert {"Content-Range", "ETag", "Content-Encoding"} <= set(exposed)


def test_packed_page_contains_the_stream_and_blocks_other_requests(stream: SceneStream) -> None:
    page = pack_stream(stream, "</title><script>").decode()
    assert "</title><script>" not in page
    held = page.partition('id="stream">')[2].partition("<")[0]
    assert base64.b64decode(held) == stream_to_bytes(stream)
    assert "default-src 'none'" in page
    with pytest.raises(InvalidValueError, match="format 1"):
        pack_stream(encode_scene(tiny_scene(seed=2, num_anchors=100), Packetization()), "")


def test_requests_without_an_end_get_an_error_or_no_response(programs: dict[str, ServedStream]) -> None:
    async def work() -> None:
        async with PageServer(PageContent(programs)) as page:
            reader, writer = await asyncio.open_connection("127.0.0.1", page.port)
            writer.write(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            assert b"<splat-wire" in await reader.read()
            writer.close()
            for noise, expected in ((b"x" * 20_000, b"HTTP/1.1 414"), (b"GET / HTTP/1.1\r\n", b""), (b"", b"")):
                reader, writer = await asyncio.open_connection("127.0.0.1", page.port)
                writer.write(noise)
                writer.write_eof()
                assert (await reader.read())[:12] == expected
                writer.close()

    run(work())


def test_scripts_are_compressed_on_request_and_the_page_contains_a_preview(stream: SceneStream) -> None:
    content = PageContent({"ball": make_served_stream(stream, preview=b"<seen>")})
    request = b"GET /splatwire-view.js HTTP/1.1\r\nHost: 127.0.0.1"
    plain = answered(content, request).partition(b"\r\n\r\n")[2]
    head, _, packed = answered(content, request + b"\r\nAccept-Encoding: br, gzip").partition(b"\r\n\r\n")
    assert b"Content-Encoding: gzip" in head
    assert gzip.decompress(packed) == plain
    assert b'preview="PHNlZW4+"' in answered(content, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nAccept-Encoding: gzip")
    begins = with_section(stream, SECTION, struct.pack("<9f", 1, 2.5, -3, 0, 0, 0, 0, -1, 0))
    content = PageContent({"ball": make_served_stream(begins, preview=b"<seen>")})
    assert b'viewpoint="1 2.5 -3 0 0 0 0 -1 0"' in answered(content, b"GET / HTTP/1.1\r\nHost: 127.0.0.1")
