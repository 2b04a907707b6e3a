"""Self-signed certificates of a server, and their renewal during operation."""

import datetime
import json
from typing import Any

import pytest

pytest.importorskip("aioquic", reason="the package aioquic is not installed")
from cryptography.x509 import DNSName, SubjectAlternativeName

from splatwire.transport import ReceiverOptions
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.quic.certificate import DAYS, RENEWED_DAYS, Identity, RenewedIdentity, self_signed
from splatwire.transport.quic.client import Trust
from splatwire.transport.quic.server import QuicServer
from transport.test_quic import OTHER, PROGRAMS, fetch, run

BEGAN = datetime.datetime(2030, 1, 1, tzinfo=datetime.UTC)


class Clock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now = BEGAN

    def __call__(self) -> datetime.datetime:
        return self.now


def test_certificate_is_valid_for_browsers_at_any_time():
    """Checked hourly for two months: within its dates, with an hour of margin, for less than 14 days."""
    clock, renewals = Clock(), list[Identity]()
    identity, seen = RenewedIdentity(clock=clock, on_renewed=renewals.append), set()
    for hours in range(24 * 60):
        clock.now = BEGAN + datetime.timedelta(hours=hours)
        shown = identity().certificate
        early, late = (clock.now - shown.not_valid_before_utc, shown.not_valid_after_utc - clock.now)
        assert min(early, late) >= datetime.timedelta(hours=1)
        assert early + late < datetime.timedelta(days=14)
        seen.add(identity().fingerprint)
    assert len(seen) == 60 // RENEWED_DAYS == len(renewals) + 1
    assert RENEWED_DAYS < DAYS


def test_certificate_has_names_of_any_script_as_in_the_dns() -> None:
    names = self_signed(("münchen.example", "b.example", "::1", "x" * 64 + "é")).certificate.extensions
    found = names.get_extension_for_class(SubjectAlternativeName).value
    assert found.get_values_for_type(DNSName) == ["xn--mnchen-3ya.example", "b.example"]


def test_renewed_certificate_is_served_and_announced_by_the_page():
    """Covers sessions of pages loaded after the renewal, and the address that open pages request again."""

    async def work() -> None:
        clock = Clock()
        identity = RenewedIdentity(clock=clock)
        server = QuicServer(PROGRAMS, "127.0.0.1", 0, identity=identity)
        await server.start()
        try:
            content = PageContent(
                {"big": b""}, lambda: WebTransportEndpoint(server.port, "/splatwire", identity().fingerprint)
            )

            def page_fingerprint() -> tuple[str, str]:
                page, facts = (asked(content, target) for target in ("/", "/streams.json"))
                return page.partition('fingerprint="')[2][:64], json.loads(facts)["fingerprint"]

            async def received(fingerprint: str) -> Any:
                return await fetch(server.port, ReceiverOptions(name="other"), Trust(fingerprint=fingerprint))

            first, same = page_fingerprint()
            assert first == same
            assert (await received(first)).stream() == OTHER
            clock.now += datetime.timedelta(days=RENEWED_DAYS)
            assert "another fingerprint" in (await received(first)).finished.reason
            second, same = page_fingerprint()
            assert first != second == same
            assert (await received(second)).stream() == OTHER
        finally:
            server.close()

    run(work())


def asked(content: PageContent, target: str) -> str:
    _, body = content.respond_now(f"GET {target} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    assert isinstance(body, bytes)
    return body.decode()
