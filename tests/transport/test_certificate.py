"""Certificates that a server makes for itself, and makes again while it serves."""

import datetime
import json
from typing import Any

import pytest

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from splatwire.transport import ReceiverOptions
from splatwire.transport.certificate import DAYS, RENEWED_DAYS, Identity, RenewedIdentity
from splatwire.transport.page_content import Link, PageContent
from splatwire.transport.quic_client import Trust
from splatwire.transport.quic_server import QuicServer
from transport.test_quic import OTHER, PROGRAMS, fetch, run

BEGAN = datetime.datetime(2030, 1, 1, tzinfo=datetime.UTC)


class Clock:
    """A clock that is turned by hand."""

    def __init__(self) -> None:
        self.now = BEGAN

    def __call__(self) -> datetime.datetime:
        return self.now


def test_browsers_find_a_certificate_valid_whenever_they_come():
    """For two months, every hour: within its dates, an hour to spare for other clocks, for less than 14 days."""
    clock, told = Clock(), list[Identity]()
    identity, seen = RenewedIdentity(clock=clock, told=told.append), set()
    for hours in range(24 * 60):
        clock.now = BEGAN + datetime.timedelta(hours=hours)
        shown = identity().certificate
        early, late = (clock.now - shown.not_valid_before_utc, shown.not_valid_after_utc - clock.now)
        assert min(early, late) >= datetime.timedelta(hours=1)
        assert early + late < datetime.timedelta(days=14)
        seen.add(identity().fingerprint)
    assert len(seen) == 60 // RENEWED_DAYS == len(told) + 1
    assert RENEWED_DAYS < DAYS


def test_a_server_shows_the_new_certificate_and_its_page_tells_of_it():
    """Sessions of pages that are fetched after the renewal, and the address that running pages ask once more."""

    async def work() -> None:
        clock = Clock()
        identity = RenewedIdentity(clock=clock)
        server = QuicServer(PROGRAMS, "127.0.0.1", 0, identity=identity)
        await server.start()
        try:
            content = PageContent({"big": b""}, lambda: Link(server.port, "/splatwire", identity().fingerprint))

            def told() -> tuple[str, str]:
                page, facts = (asked(content, target) for target in ("/", "/streams.json"))
                return page.partition('fingerprint="')[2][:64], json.loads(facts)["fingerprint"]

            async def received(fingerprint: str) -> Any:
                return await fetch(server.port, ReceiverOptions(name="other"), Trust(fingerprint=fingerprint))

            first, same = told()
            assert first == same
            assert (await received(first)).stream() == OTHER
            clock.now += datetime.timedelta(days=RENEWED_DAYS)
            assert "another fingerprint" in (await received(first)).finished.reason
            second, same = told()
            assert first != second == same
            assert (await received(second)).stream() == OTHER
        finally:
            server.close()

    run(work())


def asked(content: PageContent, target: str) -> str:
    _, body = content.answer(f"GET {target} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    assert isinstance(body, bytes)
    return body.decode()
