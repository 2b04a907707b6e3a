"""The receiver in Firefox: the same integers from another engine."""

import asyncio
import base64
import io

import numpy as np
import pytest
from PIL import Image

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
