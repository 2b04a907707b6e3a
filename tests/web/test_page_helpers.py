"""Helper threads of the page's worker: packets of a large scene are decoded by all cores but one."""

import asyncio
import time
from collections.abc import Callable

import pytest

from explicit import encode_splats
from splatwire.bitstream import Packetization, SceneStream, stream_to_bytes
from splatwire.codec.gaussians.quality import Quality
from transport.chromium import Browser, executable, isolated_page
from web.host import Host, hosting
from web.pictures import ELEMENT
from web.test_page import ball, run

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
PAGE = '{policy}<script type="module" src="splatwire.js"></script>\
<splat-wire src="scene.swz" style="height: 12rem"></splat-wire>'
POLICY = "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'self' 'unsafe-inline'; worker-src {}\">"
NO_HELPERS = "<script>const Plain = Blob; window.Blob = class extends Plain { constructor(parts, options) { super(\
['self.Worker = class { constructor() { throw new DOMException(`denied`, `SecurityError`) } };', ...parts], options) }\
};</script>"
TRUSTED_TYPES = '<meta http-equiv="Content-Security-Policy" content="require-trusted-types-for \'script\'">'
PAGES = {
    "no_workers": PAGE.format(policy=POLICY.format("'none'")),
    "trusted_types": PAGE.format(policy=TRUSTED_TYPES),
    "plain": PAGE.format(policy=""),
    "no_wasm": PAGE.format(policy=POLICY.format("blob:")),
    "no_helpers": PAGE.format(policy=NO_HELPERS),
}
STATUS = f"{ELEMENT}.status"
COUNT = 24_000


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_splats(ball(COUNT, 0), Packetization(block_size=3000, lanes=8), quality=Quality(10.0))


def threads(page: Browser) -> int:
    """Number of threads of the page's workers."""
    return page.alive()["WorkerGlobalScopes"]


def test_a_page_that_forbids_workers_shows_the_reason(stream: SceneStream) -> None:
    def work(host: Host, page: Browser) -> None:
        for name, reason in (("trusted_types", "Worker"), ("no_workers", "worker-src blob:")):
            page.open(f"{host.url}{name}")
            assert reason in page.wait_for(f"{ELEMENT}?.status?.failed")

    hosted(stream, work)


@pytest.mark.parametrize("name", ["plain", "no_wasm", "no_helpers"])
def test_large_scenes_are_complete_and_verified_on_pages_that_allow_or_forbid_helpers(
    stream: SceneStream, name: str
) -> None:
    def work(host: Host, page: Browser) -> None:
        page.open(f"{host.url}{name}")
        page.wait_for(f"{ELEMENT}?.status?.verified !== undefined && {STATUS}.verified !== null")
        assert page.evaluate(f"[{STATUS}.complete, {STATUS}.verified, {STATUS}.gaussians, {STATUS}.failed]") == [
            True, True, COUNT, None,
        ]  # fmt: skip
        page.evaluate(f"{ELEMENT}.remove()")
        wait_for_threads(page, 0)

    hosted(stream, work)


def test_helpers_are_one_fewer_than_cores_and_end_with_the_element_or_its_stream(stream: SceneStream) -> None:
    def work(host: Host, page: Browser) -> None:
        host.deliver = lambda request, body: len(body) // 2
        page.open(f"{host.url}plain")
        page.wait_for(f"{ELEMENT}?.status?.gaussians > 0")
        most = min(page.evaluate("navigator.hardwareConcurrency") - 1, 4)
        helpers = most if most > 1 else 0
        wait_for_threads(page, 1 + helpers + sorters(page))
        page.evaluate(f"{ELEMENT}.src = 'none.swz'; 0")
        wait_for_threads(page, 1 + sorters(page))  # the stream has no head, so its size is unknown
        page.evaluate(f"{ELEMENT}.remove()")
        wait_for_threads(page, 0)
        host.cut.set()

    hosted(stream, work)


def wait_for_threads(page: Browser, expected: int) -> None:
    """Waits for a number of threads, because browsers end them late."""
    end = time.monotonic() + 600
    while threads(page) != expected:
        assert time.monotonic() < end, f"{threads(page)} threads instead of {expected}"
        time.sleep(0.1)


def sorters(page: Browser) -> int:
    """Number of workers that sort for the renderer."""
    return int(page.evaluate("workers")) - 1


def hosted(stream: SceneStream, work: Callable[[Host, Browser], None]) -> None:
    """Runs work in a browser on a site that has the stream as `scene.swz`."""

    async def serve() -> None:
        async with hosting(PAGES, {"scene.swz": stream_to_bytes(stream)}) as host:

            def drive() -> None:
                with isolated_page() as page:
                    work(host, page)

            await asyncio.to_thread(drive)

    run(serve())
