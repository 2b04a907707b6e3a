"""A scene with levels in a browser: what is looked at comes first, by ranges of bytes, and nothing that nobody sees."""

import asyncio
from collections.abc import Iterable
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from codec.gaussians.test_gaussians import some_splats
from scenes import tiny_cameras
from splatwire.codec import add_concealment
from splatwire.codec.viewpoint import SECTION, viewpoint_section
from splatwire.levels import encode_levels
from splatwire.model import SplatScene
from splatwire.packets import Packetization, SceneStream, stream_from_bytes, stream_to_bytes
from splatwire.scene import Cameras
from splatwire.transport import ServerLimits, program
from splatwire.transport.page import PageServer
from splatwire.transport.page_content import Link, PageContent
from transport.chromium import browser, executable
from web.pictures import ELEMENT, check_pictures

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport.certificate import self_signed
from splatwire.transport.quic import WEBTRANSPORT_PATH
from splatwire.transport.quic_server import QuicServer

pytestmark = pytest.mark.skipif(executable() is None, reason="Chromium is not installed")
STATUS = f"{ELEMENT}?.status"
SAID = f"{ELEMENT}.shadowRoot.querySelector('.panel').innerText"


def ball(count: int) -> SplatScene:
    """Around the origin."""
    splats = some_splats(count)
    return SplatScene(replace(splats, means=splats.means - splats.means.mean(axis=0)))


def seen_from(stream: SceneStream, distance: float) -> bytes:
    """The stream, looked at first from so many units beside its middle."""
    cameras = tiny_cameras(2, 240, 180)
    poses = cameras.viewmats.copy()
    poses[:, :3, :3] = np.eye(3)
    poses[:, :3, 3] = (0, 0, distance)
    moved = Cameras(poses, cameras.Ks, cameras.width, cameras.height, cameras.names)
    return stream_to_bytes(add_concealment(stream, SECTION, viewpoint_section(moved)))


async def packets_of(url: str, names: Iterable[str], way: str) -> dict[str, int]:
    """Packets of each stream that a browser has when it sees all that it looks at, and came this way."""

    def drive() -> dict[str, int]:
        came = {}
        with browser() as page:
            for name in names:
                page.open("about:blank")
                page.open(f"{url}?stream={name}")
                page.wait_for(f"{STATUS}?.finished || {SAID}.includes('this view needs')", 60)
                came[name] = page.evaluate(f"{STATUS}.packets")
                assert page.evaluate(f"{STATUS}.way") == way
                assert not page.evaluate(f"{STATUS}.failed")
                assert 0 < page.evaluate(f"{STATUS}.gaussians") <= 40_000
        return came

    return await asyncio.to_thread(drive)


def test_a_browser_fetches_what_is_looked_at() -> None:
    stream = encode_levels(ball(40_000), Packetization(block_size=400, lanes=2))
    contents = {"far": seen_from(stream, 500.0), "near": seen_from(stream, 1.5)}

    async def work() -> None:
        async with PageServer(PageContent(contents)) as server:
            came = await packets_of(server.url, contents, "HTTP, by ranges")
        assert 0 < came["far"] < came["near"] <= len(stream.packets)

    asyncio.run(asyncio.wait_for(work(), 200))


def test_what_is_drawn_in_the_end_is_the_finest_level() -> None:
    stream = encode_levels(ball(900), Packetization(block_size=40, lanes=2))

    async def work() -> None:
        async with PageServer(PageContent({"ball": stream_to_bytes(stream)})) as server:

            def drive() -> None:
                with browser() as page:
                    page.open(server.url)
                    page.wait_for(f"{STATUS}?.finished === 'complete' && {STATUS}.gaussians === 900", 60)
                    assert page.resolve(f"{ELEMENT}.verify()") is True
                    check_pictures(page, stream, 38)

            await asyncio.to_thread(drive)

    asyncio.run(asyncio.wait_for(work(), 200))


def test_datagrams_bring_what_is_looked_at() -> None:
    stream = encode_levels(ball(40_000), Packetization(block_size=400, lanes=1, grouping="hashed", packet_bytes=1150))
    contents = {name: stream_from_bytes(seen_from(stream, away))[0] for name, away in (("far", 500.0), ("near", 1.5))}
    with patch.object(program, "OPENING_BYTES", 20_000):
        programs = {name: program.make_program(content) for name, content in contents.items()}
    identity = self_signed("127.0.0.1")

    async def work() -> None:
        quic = QuicServer(programs, "127.0.0.1", 0, identity=identity)
        async with PageServer(PageContent(programs, Link((await quic.start()).port, WEBTRANSPORT_PATH,
                                                         identity.fingerprint))) as server:  # fmt: skip
            came = await packets_of(server.url, contents, "WebTransport datagrams")
        quic.close()
        assert 0 < came["far"] < came["near"] <= len(stream.packets)

    asyncio.run(asyncio.wait_for(work(), 200))


def test_what_is_looked_at_comes_another_way_where_the_session_breaks() -> None:
    stream = encode_levels(ball(40_000), Packetization(block_size=400, lanes=1, grouping="hashed", packet_bytes=1150))
    near = stream_from_bytes(seen_from(stream, 1.5))[0]
    with patch.object(program, "OPENING_BYTES", 20_000):
        programs = {"near": program.make_program(near)}
    identity, slowly = self_signed(), ServerLimits(fixed_rate=60e3)

    async def work() -> None:
        quic = QuicServer(programs, "127.0.0.1", 0, identity=identity, limits=slowly)
        link = Link((await quic.start()).port, WEBTRANSPORT_PATH, identity.fingerprint)
        loop = asyncio.get_running_loop()
        async with PageServer(PageContent(programs, link)) as server:

            def drive() -> None:
                with browser() as page:
                    page.open(server.url)
                    page.wait_for(f"{STATUS}?.packets > 30", 60)
                    loop.call_soon_threadsafe(quic.close)
                    page.wait_for(f"{STATUS}?.finished || {SAID}.includes('this view needs')", 60)
                    assert page.evaluate(f"{STATUS}.way") == "HTTP, by ranges"
                    assert page.evaluate(f"{STATUS}.packets") > 30
                    assert not page.evaluate(f"{STATUS}.failed")

            await asyncio.to_thread(drive)

    asyncio.run(asyncio.wait_for(work(), 200))
