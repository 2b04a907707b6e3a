"""The receiver in Firefox: the same integers from another engine."""

import asyncio
import base64
import io
import json
import socket
import threading

import numpy as np
import pytest
from PIL import Image

from browser_driver import NavigatedError
from explicit import encode_splats
from scenes import tiny_causal_scene
from splatwire.bitstream import Packetization
from splatwire.codec import encode_scene
from splatwire.transport import make_served_stream
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.server import PageServer
from transport.firefox import Firefox, executable, firefox
from web.pictures import ELEMENT
from web.test_page import ball, run

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.codec.gaussians.quality import Quality
from splatwire.transport.quic.certificate import self_signed
from splatwire.transport.quic.common import WEBTRANSPORT_PATH
from splatwire.transport.quic.server import QuicServer

pytestmark = pytest.mark.slow

STATUS = f"{ELEMENT}?.status"
SMALL = Packetization(block_size=600, lanes=1, grouping="hashed", packet_bytes=700)


@pytest.mark.skipif(executable() is None, reason="Firefox is not installed")
def test_firefox_decodes_the_integers_of_python() -> None:
    """Covers explicit Gaussians and anchors over every transport, with and without WebGL."""
    streams = {
        "ball": encode_splats(ball(), SMALL, background=(0.2, 0.5, 0.8), quality=Quality(10.0)),
        "anchors": encode_scene(tiny_causal_scene(seed=6, num_anchors=400), SMALL),
    }
    programs = {name: make_served_stream(stream) for name, stream in streams.items()}
    identity = self_signed()

    def check(page: Firefox, name: str) -> None:
        assert page.wait_for(f"{STATUS}?.finished") == "complete"
        assert page.evaluate(f"{STATUS}.packets") == len(streams[name].packets)
        assert page.evaluate(f"{ELEMENT}.verify()") is True

    async def work() -> None:
        server = QuicServer(programs, "127.0.0.1", 0, identity=identity)
        await server.start()
        link = WebTransportEndpoint(server.port, WEBTRANSPORT_PATH, identity.fingerprint)
        async with PageServer(PageContent(programs, link)) as pages:

            def drive() -> None:
                with firefox() as page:
                    for name in streams:
                        page.open(f"{pages.url}?stream={name}")
                        check(page, name)
                        picture = Image.open(io.BytesIO(base64.b64decode(page.screenshot())))
                        assert np.asarray(picture.convert("L")).std() > 5, "an empty page"

            await asyncio.to_thread(drive)
        server.close()

    run(work())


def test_expressions_are_evaluated_again_after_a_navigation() -> None:
    """Another server answers in place of Firefox."""
    unloaded = {"error": "javascript error", "message": "Document was unloaded", "stacktrace": ""}
    replaced = {"error": "unknown error", "message": "AbortError: Actor 'A' destroyed before query 'B' was resolved"}
    other = {"error": "javascript error", "message": "ReferenceError: x is not defined"}
    answers = [None, None, unloaded, replaced, None, unloaded, other]

    def answer(server: socket.socket) -> None:
        connection, _ = server.accept()
        with connection:
            messages = [{"marionetteProtocol": 3}]
            messages += [[1, i, error, {"value": 7}] for i, error in enumerate(answers, 1)]
            for message in messages:
                text = json.dumps(message)
                connection.sendall(f"{len(text)}:{text}".encode())
            while connection.recv(1 << 16):
                pass

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=answer, args=(server,), daemon=True)
        thread.start()
        page = Firefox(server.getsockname()[1], 60)
        assert page.wait_for("x", 60) == 7
        with pytest.raises(NavigatedError):
            page.evaluate("x")
        with pytest.raises(RuntimeError, match="x is not defined") as raised:
            page.evaluate("x")
        assert not isinstance(raised.value, NavigatedError)
        page.close()
        thread.join(60)
