"""The receiver in a real browser: WebTransport to our server, its page driven over the DevTools protocol."""

import asyncio
import base64
import hashlib
import io
import random
import shutil
import subprocess
import zlib
from contextlib import AsyncExitStack
from typing import Any

import numpy as np
import pytest
from PIL import Image

from splatwire.transport.layout import head_object
from splatwire.transport.page import PageServer, response
from transport.chromium import Browser, browser, executable
from transport.network import bernoulli
from transport.relay import Relay
from transport.test_quic import IDENTITY, OTHER, PROGRAMS, STREAM, run, serving

needs_browser = pytest.mark.skipif(executable() is None, reason="Chromium is not installed")


def digests(name: str) -> dict[str, str]:
    stream, program = {"scene": STREAM, "other": OTHER}[name], PROGRAMS[name]
    head = head_object(stream.manifest, stream.side_info, program.packets[: program.carried])
    parts = {"head": head, "packets": b"".join(program.packets), "preview": program.preview}
    return {key: hashlib.sha256(value).hexdigest() for key, value in parts.items()}


def opened(page: Browser, url: str) -> dict[str, Any]:
    page.open("about:blank")
    page.open(url)
    return page.wait_for("window.result")


@needs_browser
def test_a_browser_receives_every_byte_and_shows_it():
    """Over a clean path, then over one that loses 20 %; a wrong fingerprint and a wrong name are told."""

    async def work() -> None:
        async with AsyncExitStack() as stack:
            server = await stack.enter_async_context(serving())
            page = await stack.enter_async_context(PageServer())
            rng = random.Random(5)
            relay = Relay(server.port, bernoulli(0.2, rng), bernoulli(0.2, rng), delay_s=0.003)
            stack.callback(relay.close)

            def drive() -> None:
                with browser() as chrome:
                    asked = {"fingerprint": IDENTITY.fingerprint, "go": "1"}
                    clean, lossy = (f"https://127.0.0.1:{port}/splatwire" for port in (server.port, relay.port))
                    for url in (clean, lossy):
                        result = opened(chrome, page.url(url=url, **asked))
                        assert result["finished"] == "complete", result
                        assert {key: result[key] for key in ("head", "packets", "preview")} == digests("scene")
                        assert result["counts"]["packets"] == len(STREAM.packets)
                        assert result["counts"]["rejected"] == 0
                    text = chrome.evaluate("document.body.innerText")
                    assert "Over: complete." in text
                    assert f"{len(STREAM.packets)} of {len(STREAM.packets)}" in text
                    picture = Image.open(io.BytesIO(base64.b64decode(chrome.screenshot())))
                    assert np.asarray(picture.convert("L")).std() > 5, "an empty page"
                    other = opened(chrome, page.url(url=clean, name="other", **asked))
                    assert {key: other[key] for key in ("head", "packets", "preview")} == digests("other")
                    assert opened(chrome, page.url(url=clean, name="no", **asked))["finished"] == "no such stream"
                    wrong = opened(chrome, page.url(url=clean, fingerprint="0" * 64, go="1"))
                    assert wrong["finished"].startswith("failed")

            await asyncio.to_thread(drive)
            assert relay.num_lost > 20
            assert server.num_malformed == 0

    run(work())


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_page_reads_frames_as_the_core_writes_them(tmp_path):
    """The same bytes, without a browser: a welcome, a symbol, a packet; and what the page writes, read by the core."""
    script = tmp_path / "check.mjs"
    source = response(b"GET /receiver.js HTTP/1.1\r\n").partition(b"\r\n\r\n")[2]
    (tmp_path / "receiver.mjs").write_bytes(source)
    script.write_text(
        'import { crc32, Transfer } from "./receiver.mjs";\n'
        'console.log(crc32(new TextEncoder().encode("123456789")).toString(16));\n'
        'console.log(Buffer.from(new Transfer("scène", 7n, 0).request()).toString("hex"));\n'
        "for (const word of process.argv.slice(2)) {\n"
        '  const transfer = new Transfer("", 7n, 0);\n'
        '  transfer.receive(Uint8Array.from(Buffer.from(word, "hex")), 0);\n'
        "  console.log(transfer.welcome ? Buffer.from(transfer.welcome.preview).toString() : transfer.finished);\n"
        "}\n"
    )
    from splatwire.transport.frames import Request, TierHead, Welcome
    from splatwire.transport.wire import encode

    tiers = (TierHead(1, 0, 0),) * 3
    welcome = encode(Welcome(7, 2, 3, 400, bytes(32), 256, 3, 1150, 0, tiers, b"preview"))[:-4]
    bodies = (welcome, welcome[:-1], welcome + b"x", welcome[:69], welcome[:69] + b"\0" + welcome[70:])
    words = [(body + zlib.crc32(body).to_bytes(4, "little")).hex() for body in bodies]
    done = subprocess.run(["node", str(script), *words], capture_output=True, text=True, timeout=30, check=True)
    lines = ["cbf43926", encode(Request(7, bytes(16), "scène")).hex(), "preview"]
    assert done.stdout.splitlines() == lines + ["the server announces something impossible"] * 4


def test_the_page_server_gives_its_files_and_nothing_else():
    for request, status in (
        (b"GET / HTTP/1.1\r\n", b"200"),
        (b"GET /receiver.js?x HTTP/1.1\r\n", b"200"),
        (b"HEAD / HTTP/1.0\r\n", b"200"),
        (b"GET /../page.py HTTP/1.1\r\n", b"404"),
        (b"GET //etc/passwd HTTP/1.1\r\n", b"404"),
        (b"POST / HTTP/1.1\r\n", b"405"),
        (b"\xff\xfe", b"400"),
        (b"GET / HTTP/2\r\n", b"400"),
    ):
        assert response(request).startswith(b"HTTP/1.1 " + status), request

    async def work() -> None:
        async with PageServer() as page:
            reader, writer = await asyncio.open_connection("127.0.0.1", page.port)
            writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
            answer = await reader.read()
            assert b"splatwire receiver" in answer
            writer.close()
            for noise in (b"x" * 20_000, b""):
                reader, writer = await asyncio.open_connection("127.0.0.1", page.port)
                writer.write(noise)
                writer.write_eof()
                assert await reader.read() == b""
                writer.close()

    run(work())
