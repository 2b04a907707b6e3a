"""Operation of servers: liveness, readiness, metrics, logs, and clients behind proxies."""

import asyncio
import json
import logging
import re
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest

from splatwire.errors import InvalidValueError
from splatwire.transport import ServerLimits, make_served_stream
from splatwire.transport.event_log import JsonFormatter, TextFormatter, log_event
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.proxies import client_address, parse_networks
from splatwire.transport.http.server import PageLimits, PageServer
from splatwire.transport.protocol.admission import network_of, network_text
from splatwire.transport.protocol.messages import Bye, Hello, Welcome
from splatwire.transport.protocol.messages import Request as Asked
from splatwire.transport.protocol.sender import Server
from splatwire.transport.protocol.wire import decode, encode
from transport.network import SECRET, datagram_stream

HEAD = "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n{}\r\n"


def get(url: str, **headers: str) -> tuple[int, str]:
    try:
        with urlopen(Request(url, headers=headers), timeout=600) as answer:
            return answer.status, answer.read().decode("latin-1")
    except HTTPError as error:
        return error.code, error.read().decode("latin-1")


def run(work) -> None:
    asyncio.run(asyncio.wait_for(work, 60))


@pytest.mark.parametrize(
    ("address", "text"),
    [("192.0.2.7", "192.0.2.7"), ("::ffff:192.0.2.7", "192.0.2.7"), ("2001:db8:1:2:3::4", "2001:db8:1:2::/64")],
)
def test_network_is_shown_as_ipv4_address_or_ipv6_prefix(address, text):
    assert network_text(network_of((address, 4840))) == text


def test_network_without_address_is_shown_in_short():
    assert network_text(network_of("x" * 1000)) == "x" * 64


@pytest.mark.parametrize("form", [TextFormatter(), JsonFormatter()])
def test_log_event_is_one_line_whatever_its_fields_hold(caplog, form):
    logger = logging.getLogger("splatwire.transport.test")
    with caplog.at_level(logging.INFO, logger.name):
        log_event(logger, logging.INFO, "transfer refused", stream='a"b\r\nERROR x\x85\u2028', bytes=7)
        log_event(logger, logging.DEBUG, "nothing")
    (record,) = caplog.records
    line = form.format(record)
    assert len(line.splitlines()) == 1
    assert line.isascii()
    if isinstance(form, JsonFormatter):
        found = json.loads(line)
        assert (found["event"], found["level"], found["bytes"]) == ("transfer refused", "info", 7)
        assert found["stream"] == 'a"b\r\nERROR x\x85\u2028'
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", found["time"])
    else:
        assert line.split(" ", 1)[1] == 'INFO transfer refused stream="a\\"b\\r\\nERROR x\\u0085\\u2028" bytes=7'


def test_other_log_records_have_a_message_in_json():
    record = logging.LogRecord("splatwire.transport", logging.ERROR, "", 0, "broken: %s", ("x",), None)
    found = json.loads(JsonFormatter().format(record))
    assert (found["level"], found["message"]) == ("error", "broken: x")


def test_traceback_of_an_exception_is_in_the_log():
    try:
        raise KeyError("lost")
    except KeyError as error:
        record = logging.LogRecord(
            "asyncio", logging.ERROR, "", 0, "broken", (), (KeyError, error, error.__traceback__)
        )
    assert json.loads(JsonFormatter().format(record))["traceback"].endswith("KeyError: 'lost'")
    assert TextFormatter().format(record).endswith("KeyError: 'lost'")


def test_start_end_and_refusal_of_transfers_are_logged_and_counted(caplog):
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    program = make_served_stream(datagram_stream(num_anchors=400, side_bytes=2000))
    server = Server({"scene": program}, secret=SECRET, random=lambda count: b"\7" * count, limits=ServerLimits())
    client = ("192.0.2.7", 5000)
    caplog.set_level(logging.INFO, "splatwire.transport")

    def asked(nonce: int, name: str, now: float):
        token = decode(server.receive(client, encode(Hello(nonce, name)), now)).token
        return decode(server.receive(client, encode(Asked(nonce, token, name)), now))

    welcome = asked(1, "scene", 1.0)
    assert isinstance(welcome, Welcome)
    server.receive(client, encode(Bye(welcome.session)), 3.5)
    asked(2, "other", 4.0)
    asked(3, "", 5.0)
    server.poll(100.0)
    events = [record.splatwire_fields for record in caplog.records]
    assert [fields["event"] for fields in events] == [
        "transfer started", "transfer ended", "transfer refused", "transfer started", "transfer ended",
    ]  # fmt: skip
    assert {fields["client"] for fields in events} == {"192.0.2.7"}
    assert (events[1]["reason"], events[1]["seconds"]) == ("left", 2.5)
    assert (events[2]["stream"], events[2]["reason"]) == ("other", "no such stream")
    assert (events[3]["stream"], events[4]["reason"]) == ("scene", "silent")
    assert (server.num_served, server.num_refused, server.num_transfers) == (2, 1, 0)


def test_http_responses_are_logged_and_counted_by_status(caplog):
    caplog.set_level(logging.INFO, "splatwire.transport")

    async def work() -> None:
        async with PageServer(PageContent({"ball": bytes(5000)})) as server:
            for path in ("streams/ball.swz?tag", "none"):
                await asyncio.to_thread(get, server.url + path)
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(b"nonsense\r\n\r\n")
            await reader.read()
            writer.close()
            assert server.statuses == {200: 1, 404: 1, 400: 1}

    run(work())
    found = [record.splatwire_fields for record in caplog.records]
    assert [(fields["method"], fields["path"], fields["status"]) for fields in found] == [
        ("GET", "/streams/ball.swz", 200), ("GET", "/none", 404), ("", "", 400),
    ]  # fmt: skip
    assert found[0]["bytes"] > 5000
    assert found[0]["client"] == "127.0.0.1"
    assert all(fields["complete"] for fields in found)


@pytest.mark.parametrize(
    ("peer", "header", "client"),
    [
        ("127.0.0.1", "203.0.113.9", "203.0.113.9"),
        ("127.0.0.1", "1.1.1.1, 203.0.113.9", "203.0.113.9"),
        ("127.0.0.1", "203.0.113.9, 10.1.2.3", "203.0.113.9"),
        ("127.0.0.1", "2001:db8::1", "2001:db8::1"),
        ("127.0.0.1", "203.0.113.9:50123", "203.0.113.9"),  # such as Azure Application Gateway
        ("127.0.0.1", "203.0.113.9, 10.1.2.3:443", "203.0.113.9"),
        ("127.0.0.1", "[2001:db8::1]:50123", "2001:db8::1"),
        ("127.0.0.1", "[2001:db8::1]", "2001:db8::1"),
        ("127.0.0.1", "203.0.113.9:x", "127.0.0.1"),
        ("::ffff:127.0.0.1", "203.0.113.9", "203.0.113.9"),
        ("127.0.0.1", "10.0.0.1, 10.0.0.2", "10.0.0.1"),
        ("127.0.0.1", "203.0.113.9, unknown", "127.0.0.1"),
        ("127.0.0.1", "203.0.113.9, nonsense, 10.0.0.2", "10.0.0.2"),
        ("127.0.0.1", "", "127.0.0.1"),
        ("198.51.100.1", "203.0.113.9", "198.51.100.1"),
    ],
)
def test_client_is_the_last_forwarded_address_outside_of_trusted_proxies(peer, header, client):
    proxies = parse_networks(["127.0.0.1", "10.0.0.0/8"])
    head = HEAD.format(f"X-Forwarded-For: {header}\r\n").encode()
    assert client_address((peer, 1), head, proxies) == (client,)
    assert client_address((peer, 1), HEAD.format("").encode(), proxies) == (peer,)
    assert client_address((peer, 1), b"nonsense\r\n\r\n", proxies) == (peer,)


@pytest.mark.parametrize("text", ["example.org", "10.0.0.1/8", "", "1.2.3.4:80"])
def test_invalid_proxy_is_refused(text):
    with pytest.raises(InvalidValueError, match="a proxy is an IP address or a network"):
        parse_networks([text])


@pytest.mark.parametrize(("trusted", "statuses"), [(True, [200, 503, 200]), (False, [503, 503, 503])])
def test_limits_behind_a_trusted_proxy_are_those_of_its_clients(trusted, statuses):
    """A client that reads nothing occupies its only slot; another client of the same proxy is served."""
    content = PageContent({"big": bytes(8 << 20)})
    limits = PageLimits(per_network=1, request_s=60.0, chunk_s=60.0)
    proxies = parse_networks(["127.0.0.1"] if trusted else ["192.0.2.1"])

    async def work() -> None:
        async with PageServer(content, limits=limits, proxies=proxies) as server:
            _, slow = await asyncio.open_connection("127.0.0.1", server.port, limit=1)
            slow.write(b"GET /streams/big.swz HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Forwarded-For: 203.0.113.9\r\n\r\n")
            while not server.num_active:
                await asyncio.sleep(0.01)
            found = [
                (await asyncio.to_thread(get, f"{server.url}streams.json", **{"X-Forwarded-For": address}))[0]
                for address in ("203.0.113.10", "203.0.113.9", "198.51.100.1")
            ]
            slow.transport.abort()
            assert found == statuses

    run(work())


def test_monitoring_reports_liveness_readiness_and_metrics():
    pytest.importorskip("prometheus_client", reason="the package prometheus-client is not installed")
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    from prometheus_client.parser import text_string_to_metric_families

    from splatwire.transport.monitoring import MonitoringContent
    from splatwire.transport.running_server import RunningServer
    from splatwire.transport.udp import UdpServer

    program = make_served_stream(datagram_stream(num_anchors=400, side_bytes=2000))

    async def work() -> None:
        server = UdpServer({}, "127.0.0.1", 0)
        try:
            async with PageServer(PageContent({"scene": program})) as page:
                opened = RunningServer(server, {}, page)
                async with PageServer(MonitoringContent(opened), logged=False) as monitor:

                    async def asked(path: str) -> tuple[int, str]:
                        return await asyncio.to_thread(get, monitor.url + path)

                    assert await asked("readyz") == (503, "no stream is available yet\n")
                    server.set_stream("scene", program)
                    assert await asked("readyz") == (200, "ready\n")
                    server.core.draining = True
                    assert await asked("readyz") == (503, "the server is stopping\n")
                    assert await asked("healthz") == (200, "ok\n")
                    assert (await asked("secret"))[0] == 404
                    await asyncio.to_thread(get, f"{page.url}streams/scene.swz")
                    await asyncio.to_thread(get, f"{page.url}none")
                    status, text = await asked("metrics")
        finally:
            server.close()
        assert status == 200
        families = {family.name: family for family in text_string_to_metric_families(text)}
        found = {(s.name, *s.labels.values()): s.value for family in families.values() for s in family.samples}
        assert found["splatwire_ready",] == 0
        assert found["splatwire_streams",] == 1
        assert found["splatwire_transfers",] == 0
        assert found["splatwire_http_responses_total", "200"] == found["splatwire_http_responses_total", "404"] == 1
        assert found["splatwire_sent_bytes_total", "http"] == page.bytes_sent > sum(map(len, program.packets))
        assert all(family.documentation for family in families.values())

    run(work())
