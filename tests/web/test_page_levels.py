"""A scene with levels in a browser: visible tiles are loaded first by byte ranges, invisible ones never."""

import asyncio
from collections.abc import Iterable
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from scenes import tiny_cameras
from splatwire.bitstream import Packetization, SceneStream, stream_from_bytes, stream_to_bytes
from splatwire.codec import with_section
from splatwire.codec.initial_view import SECTION, initial_view_section
from splatwire.lod import encode_levels
from splatwire.transport import ServerLimits
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.server import PageServer
from splatwire.transport.protocol import served_stream
from splatwire.types import Cameras, SplatScene
from transport.chromium import executable, isolated_page
from web.pictures import ELEMENT, check_pictures

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport.quic.certificate import self_signed
from splatwire.transport.quic.common import WEBTRANSPORT_PATH
from splatwire.transport.quic.server import QuicServer

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
STATUS = f"{ELEMENT}?.status"
SAID = f"{ELEMENT}.shadowRoot.querySelector('.panel').innerText"


def ball(count: int) -> SplatScene:
    """View around the origin."""
    splats = some_splats(count)
    return SplatScene(replace(splats, means=splats.means - splats.means.mean(axis=0)))


def seen_from(stream: SceneStream, distance: float) -> bytes:
    """The stream with an initial view off its centre."""
    cameras = tiny_cameras(2, 240, 180)
    poses = cameras.viewmats.copy()
    poses[:, :3, :3] = np.eye(3)
    poses[:, :3, 3] = (0, 0, distance)
    moved = Cameras(poses, cameras.Ks, cameras.width, cameras.height, cameras.names)
    return stream_to_bytes(with_section(stream, SECTION, initial_view_section(moved)))


async def packets_of(url: str, names: Iterable[str], way: str) -> dict[str, int]:
    """Packets of each stream in a browser that has all visible tiles, and their transport."""

    def drive() -> dict[str, int]:
        came = {}
        with isolated_page() as page:
            for name in names:
                page.open("about:blank")
                page.open(f"{url}?stream={name}")
                page.wait_for(f"{STATUS}?.finished || {SAID}.includes('this view needs')")
                came[name] = page.evaluate(f"{STATUS}.packets")
                assert page.evaluate(f"{STATUS}.transport") == way
                assert not page.evaluate(f"{STATUS}.failed")
                assert 0 < page.evaluate(f"{STATUS}.gaussians") <= 40_000
        return came

    return await asyncio.to_thread(drive)


def test_browser_fetches_visible_tiles() -> None:
    stream = encode_levels(ball(40_000), Packetization(block_size=400, lanes=2))
    contents = {"far": seen_from(stream, 500.0), "near": seen_from(stream, 1.5)}

    async def work() -> None:
        async with PageServer(PageContent(contents)) as server:
            came = await packets_of(server.url, contents, "HTTP, by ranges")
        assert 0 < came["far"] < came["near"] <= len(stream.packets)

    asyncio.run(asyncio.wait_for(work(), 1800))


def test_finest_level_is_rendered_at_the_end() -> None:
    stream = encode_levels(ball(900), Packetization(block_size=40, lanes=2))

    async def work() -> None:
        async with PageServer(PageContent({"ball": stream_to_bytes(stream)})) as server:

            def drive() -> None:
                with isolated_page() as page:
                    page.open(server.url)
                    page.wait_for(f"{STATUS}?.finished === 'complete' && {STATUS}.gaussians === 900")
                    assert page.resolve(f"{ELEMENT}.verify()") is True
                    check_pictures(page, stream, 38)

            await asyncio.to_thread(drive)

    asyncio.run(asyncio.wait_for(work(), 1800))


def test_datagrams_deliver_visible_tiles() -> None:
    stream = encode_levels(ball(40_000), Packetization(block_size=400, lanes=1, grouping="hashed", packet_bytes=1150))
    contents = {name: stream_from_bytes(seen_from(stream, away))[0] for name, away in (("far", 500.0), ("near", 1.5))}
    with patch.object(served_stream, "OPENING_BYTES", 20_000):
        programs = {name: served_stream.make_served_stream(content) for name, content in contents.items()}
    identity = self_signed("127.0.0.1")

    async def work() -> None:
        quic = QuicServer(programs, "127.0.0.1", 0, identity=identity)
        async with PageServer(PageContent(programs, WebTransportEndpoint((await quic.start()).port, WEBTRANSPORT_PATH,
                                                         identity.fingerprint))) as server:  # fmt: skip
            came = await packets_of(server.url, contents, "WebTransport datagrams")
        quic.close()
        assert 0 < came["far"] < came["near"] <= len(stream.packets)

    asyncio.run(asyncio.wait_for(work(), 1800))


def test_visible_tiles_are_fetched_over_http_when_the_session_breaks() -> None:
    stream = encode_levels(ball(40_000), Packetization(block_size=400, lanes=1, grouping="hashed", packet_bytes=1150))
    near = stream_from_bytes(seen_from(stream, 1.5))[0]
    with patch.object(served_stream, "OPENING_BYTES", 20_000):
        programs = {"near": served_stream.make_served_stream(near)}
    identity, slowly = self_signed(), ServerLimits(fixed_rate=60e3)

    async def work() -> None:
        quic = QuicServer(programs, "127.0.0.1", 0, identity=identity, limits=slowly)
        link = WebTransportEndpoint((await quic.start()).port, WEBTRANSPORT_PATH, identity.fingerprint)
        loop = asyncio.get_running_loop()
        async with PageServer(PageContent(programs, link)) as server:

            def drive() -> None:
                with isolated_page() as page:
                    page.open(server.url)
                    page.wait_for(f"{STATUS}?.packets > 30")
                    loop.call_soon_threadsafe(quic.close)
                    page.wait_for(f"{STATUS}?.finished || {SAID}.includes('this view needs')")
                    assert page.evaluate(f"{STATUS}.transport") == "HTTP, by ranges"
                    assert page.evaluate(f"{STATUS}.packets") > 30
                    assert not page.evaluate(f"{STATUS}.failed")

            await asyncio.to_thread(drive)

    asyncio.run(asyncio.wait_for(work(), 1800))
