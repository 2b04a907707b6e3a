"""Pages whose Content Security Policy forbids what the element needs: the error names the directive and the address."""

import asyncio

import pytest

from explicit import encode_splats
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.codec.gaussians.quality import Quality
from transport.chromium import executable, isolated_page
from web.host import hosting
from web.pictures import ELEMENT
from web.test_page import SMALL, ball, run

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
PAGE = """<meta http-equiv="Content-Security-Policy" content="{policy}">
<script type="module" src="splatwire.js"></script>
<splat-wire src="ball.swz" {attributes} style="height: 12rem"></splat-wire>"""
OTHERS = "script-src 'self' 'unsafe-inline'; worker-src blob:"
SESSION = "https://127.0.0.1:9/splatwire"


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return encode_splats(ball(), SMALL, quality=Quality(10.0))


@pytest.mark.parametrize(
    ("policy", "attributes", "directive", "address"),
    [
        (f"{OTHERS}; connect-src 'none'", "", "connect-src", "ball.swz"),
        (f"{OTHERS}; connect-src 'none'", f'session="{SESSION}"', "connect-src", "ball.swz"),
        ("script-src 'self' 'unsafe-inline'; worker-src 'none'", "", "worker-src", "blob:"),
        ("script-src {url}splatwire.js 'unsafe-inline'; worker-src blob:", "", "script-src", "splatwire-view.js"),
    ],
    ids=["file", "file and session", "worker", "renderer"],
)
def test_error_names_the_directive_and_the_address(
    stream: SceneStream, policy: str, attributes: str, directive: str, address: str
) -> None:
    async def work() -> None:
        async with hosting({}, {"ball.swz": stream_to_bytes(stream)}) as host:
            host.pages["page"] = PAGE.format(policy=policy.format(url=host.url), attributes=attributes)

            def drive() -> None:
                with isolated_page() as page:
                    page.open(f"{host.url}page")
                    reason = page.wait_for(f"{ELEMENT}?.status?.failed", 60)
                    assert directive in reason
                    assert address in reason
                    errors = page.evaluate(
                        "events.filter(([kind]) => kind === 'error').map(([, detail]) => detail.message)"
                    )
                    assert errors == [reason]

            await asyncio.to_thread(drive)

    run(work())


def test_a_forbidden_session_is_no_error_if_the_file_is_allowed(stream: SceneStream) -> None:
    policy = f"{OTHERS}; connect-src 'self'"

    async def work() -> None:
        async with hosting({}, {"ball.swz": stream_to_bytes(stream)}) as host:
            host.pages["page"] = PAGE.format(policy=policy, attributes=f'session="{SESSION}"')

            def drive() -> None:
                with isolated_page() as page:
                    page.open(f"{host.url}page")
                    page.wait_for(f"{ELEMENT}?.status?.verified", 60)
                    assert page.evaluate("events.some(([kind]) => kind === 'error' || kind === 'lost')") is False

            await asyncio.to_thread(drive)

    run(work())


def test_the_session_of_a_stream_without_a_file_is_named(stream: SceneStream) -> None:
    policy = f"{OTHERS}; connect-src 'self'"

    async def work() -> None:
        async with hosting({"page": PAGE.format(policy=policy, attributes=f'session="{SESSION}"')}, {}) as host:

            def drive() -> None:
                with isolated_page() as page:
                    page.open(f"{host.url}page")
                    reason = page.wait_for(f"{ELEMENT}?.status?.failed", 60)
                    assert f"forbids {SESSION}: allow it in connect-src" in reason
                    assert "404" in reason

            await asyncio.to_thread(drive)

    run(work())
