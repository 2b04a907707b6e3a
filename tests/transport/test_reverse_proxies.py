"""nginx and Caddy before the page server, with the configurations in deploy/."""

import asyncio
import contextlib
import http.client
import logging
import os
import random
import shutil
import socket
import ssl
import subprocess
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest

pytest.importorskip("cryptography", reason="the package cryptography is not installed")
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.messages import Response, make_response
from splatwire.transport.http.proxies import parse_networks
from splatwire.transport.http.publish import FOREVER, REVALIDATED
from splatwire.transport.http.server import PageServer
from splatwire.transport.quic.certificate import self_signed

NGINX = shutil.which("nginx", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
CADDY = shutil.which("caddy")
pytestmark = pytest.mark.slow
DEPLOY = Path(__file__).parents[2] / "deploy"
DOCUMENT = DEPLOY.parent / "docs" / "cdn.md"
NAME = "splats.example.org"
VISITOR = "127.0.0.2"
BODY = random.Random(0).randbytes(600_000)
MAIN = """
daemon off;
{user}
pid {folder}/pid;
error_log stderr;
events {{}}
http {{
    access_log off;
    proxy_read_timeout 1s;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    include {folder}/site.conf;
}}
"""


class Answer(NamedTuple):
    status: int
    headers: dict[str, str]
    body: bytes


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def replaced(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


def write_certificate(folder: Path) -> tuple[Path, Path]:
    """Writes a certificate for the name of the site, and its key."""
    identity, certificate, key = self_signed([NAME]), folder / "cert.pem", folder / "key.pem"
    certificate.write_bytes(identity.certificate.public_bytes(Encoding.PEM))
    key.write_bytes(identity.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return certificate, key


def nginx_command(folder: Path, page: int, plain: int, secure: int) -> list[str]:
    """Writes the configuration with the ports and paths of the test; returns the command that runs nginx."""
    certificate, key = write_certificate(folder)
    site = (DEPLOY / "nginx.conf").read_text(encoding="utf-8")
    for old, new in {
        "listen 80;": f"listen 127.0.0.1:{plain};",
        "listen 443 ssl;": f"listen 127.0.0.1:{secure} ssl;",
        "127.0.0.1:8080": f"127.0.0.1:{page}",
        f"/etc/letsencrypt/live/{NAME}/fullchain.pem": str(certificate),
        f"/etc/letsencrypt/live/{NAME}/privkey.pem": str(key),
        "/var/cache/nginx/splatwire": str(folder / "cache"),
        "/var/log/nginx/splatwire.log": str(folder / "access.log"),
    }.items():
        site = replaced(site, old, new)
    (folder / "site.conf").write_text(site)
    user = "user root;" if os.geteuid() == 0 else ""
    (folder / "nginx.conf").write_text(MAIN.format(folder=folder, user=user))
    return nginx_words(folder)


def nginx_words(folder: Path) -> list[str]:
    return [str(NGINX), "-p", str(folder), "-e", "stderr", "-c", str(folder / "nginx.conf")]


def caddy_command(folder: Path, page: int, secure: int) -> list[str]:
    """Writes the configuration with the ports and paths of the test; returns the command that runs Caddy."""
    certificate, key = write_certificate(folder)
    site = (DEPLOY / "Caddyfile").read_text(encoding="utf-8")
    for old, new in {
        f"\n{NAME} {{\n": f"\nhttps://{NAME}:{secure} {{\n\tbind 127.0.0.1\n\ttls {certificate} {key}\n",
        "127.0.0.1:8080": f"127.0.0.1:{page}",
    }.items():
        site = replaced(site, old, new)
    options = f"{{\n\tadmin off\n\tauto_https disable_redirects\n\tstorage file_system {folder}/data\n}}\n"
    (folder / "Caddyfile").write_text(options + site)
    return [str(CADDY), "run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")]


@contextlib.asynccontextmanager
async def running(command: list[str], ports: Sequence[int], folder: Path) -> AsyncIterator[None]:
    """Runs a proxy until its ports accept connections, and ends it afterwards."""
    environment = {**os.environ, "HOME": str(folder), "XDG_CONFIG_HOME": str(folder), "XDG_DATA_HOME": str(folder)}
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(command, stderr=log, env=environment)
    try:
        for port in ports:
            for _ in range(1500):
                assert process.poll() is None, (folder / "log").read_text()
                with contextlib.suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port)):
                    break
                await asyncio.sleep(0.02)
        yield
    finally:
        process.terminate()
        process.wait(240)


def ask(port: int, path: str, authority: Path | None, **headers: str) -> Answer:
    """Requests a path as a visitor of the name, over TLS if a trusted certificate is given."""
    connection = http.client.HTTPConnection(NAME)
    plain = socket.create_connection(("127.0.0.1", port), 20, source_address=(VISITOR, 0))
    context = None if authority is None else ssl.create_default_context(cafile=str(authority))
    with plain if context is None else context.wrap_socket(plain, server_hostname=NAME) as connected:
        connection.sock = connected
        connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        response = connection.getresponse()
        return Answer(response.status, dict(response.getheaders()), response.read())


@pytest.mark.skipif(NGINX is None, reason="nginx is not installed")
def test_page_and_streams_behind_nginx(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    caplog.set_level(logging.INFO, "splatwire.transport")
    plain, secure = free_port(), free_port()
    content = PageContent(
        {"ball": BODY}, WebTransportEndpoint(4840, "/splatwire", None), public_origin=f"https://{NAME}"
    )

    async def work() -> None:
        async with PageServer(content, proxies=parse_networks(["127.0.0.1"])) as server:
            command = nginx_command(tmp_path, server.port, plain, secure)
            async with running(command, (plain, secure), tmp_path):
                moved = await asyncio.to_thread(ask, plain, "/?stream=ball", None)
                assert (moved.status, moved.headers["Location"]) == (301, f"https://{NAME}/?stream=ball")

                async def asked(path: str, **headers: str) -> Answer:
                    return await asyncio.to_thread(ask, secure, path, tmp_path / "cert.pem", **headers)

                page = await asked("/", X_Forwarded_For="203.0.113.9")
                assert page.status == 200
                assert b'session=":4840/splatwire"' in page.body
                path = page.body.split(b'src="streams/')[1].split(b'"')[0].decode()
                first = await asked(f"/streams/{path}")
                assert (first.status, first.body) == (200, BODY)
                assert first.headers["Access-Control-Allow-Origin"] == "*"
                before = server.num_responses
                again = await asked(f"/streams/{path}")
                part = await asked(f"/streams/{path}", Range="bytes=300000-300099")
                assert (again.body, again.headers["X-Cache"], again.headers["ETag"]) == (
                    BODY,
                    "HIT",
                    first.headers["ETag"],
                )
                assert (part.status, part.body) == (206, BODY[300_000:300_100])
                assert part.headers["Content-Range"] == f"bytes 300000-300099/{len(BODY)}"
                assert server.num_responses == before
                current = await asked("/streams/ball.swz")
                assert (current.body, current.headers["X-Cache"]) == (BODY, "MISS")
                assert (await asked("/streams/ball.swz")).headers["X-Cache"] == "MISS"
                assert server.num_responses > before
                await asked("/private/ball.swz?token=secret")
                await asyncio.to_thread(ask, plain, "/?stream=ball&token=secret", None)

    asyncio.run(asyncio.wait_for(work(), 60))
    assert logged_clients(caplog) == {VISITOR}
    log = (tmp_path / "access.log").read_text()
    assert "/private/ball.swz" in log
    assert "secret" not in log


class SlowContent:
    """Content that takes longer than the timeout of `MAIN`, as a download that is made first."""

    host = "127.0.0.1"

    async def respond(self, head: bytes) -> Response:
        await asyncio.sleep(2)
        return self.respond_now(head)

    def respond_now(self, head: bytes) -> Response:
        return make_response("200 OK", body=b"made")

    def busy(self, head: bytes) -> Response:
        return make_response("503 Service Unavailable")


@pytest.mark.skipif(NGINX is None, reason="nginx is not installed")
def test_nginx_waits_until_a_download_is_made(tmp_path: Path):
    plain, secure = free_port(), free_port()

    async def work() -> None:
        async with (
            PageServer(SlowContent()) as server,
            running(nginx_command(tmp_path, server.port, plain, secure), (plain, secure), tmp_path),
        ):
            answer = await asyncio.to_thread(ask, secure, "/ball.sog", tmp_path / "cert.pem")
            assert (answer.status, answer.body) == (200, b"made")

    asyncio.run(asyncio.wait_for(work(), 60))


@pytest.mark.skipif(NGINX is None, reason="nginx is not installed")
@pytest.mark.parametrize("below", ["", "splats/"])
def test_nginx_sends_the_headers_of_a_published_site_in_any_folder(tmp_path: Path, below: str):
    port, site = free_port(), tmp_path / "site" / below
    (site / "streams").mkdir(parents=True)
    for name in ("index.html", "ball.html", "streams.json", "streams/ball.123456789abc.swz"):
        (site / name).write_bytes(BODY)
    block = DOCUMENT.read_text(encoding="utf-8").split("```nginx\n")[1].split("```")[0]
    nginx_command(tmp_path, port, port, port)
    server = f"server {{ listen 127.0.0.1:{port}; root {tmp_path / 'site'}; index index.html; {block} }}"
    (tmp_path / "site.conf").write_text(server)

    async def work() -> None:
        async with running(nginx_words(tmp_path), (port,), tmp_path):
            for name in ("", "ball.html", "streams.json"):
                page = await asyncio.to_thread(ask, port, f"/{below}{name}", None)
                assert (page.status, page.headers["Cache-Control"]) == (200, REVALIDATED)
            stream = await asyncio.to_thread(ask, port, f"/{below}streams/ball.123456789abc.swz", None)
            assert (stream.status, stream.headers["Cache-Control"]) == (200, f"{FOREVER}, no-transform")
            assert stream.headers["Access-Control-Allow-Origin"] == "*"

    asyncio.run(asyncio.wait_for(work(), 60))


@pytest.mark.skipif(CADDY is None, reason="Caddy is not installed")
def test_page_and_streams_behind_caddy(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    caplog.set_level(logging.INFO, "splatwire.transport")
    secure = free_port()
    content = PageContent(
        {"ball": BODY}, WebTransportEndpoint(4840, "/splatwire", None), public_origin=f"https://{NAME}"
    )

    async def work() -> None:
        async with PageServer(content, proxies=parse_networks(["127.0.0.1"])) as server:
            command = caddy_command(tmp_path, server.port, secure)
            async with running(command, (secure,), tmp_path):

                async def asked(path: str, **headers: str) -> Answer:
                    return await asyncio.to_thread(ask, secure, path, tmp_path / "cert.pem", **headers)

                page = await asked("/", X_Forwarded_For="203.0.113.9")
                assert page.status == 200
                assert b'session=":4840/splatwire"' in page.body
                whole = await asked("/streams/ball.swz")
                assert (whole.status, whole.body) == (200, BODY)
                assert whole.headers["Access-Control-Allow-Origin"] == "*"
                part = await asked("/streams/ball.swz", Range="bytes=300000-300099", If_Range=whole.headers["Etag"])
                assert (part.status, part.body) == (206, BODY[300_000:300_100])
                same = await asked("/streams/ball.swz", If_None_Match=whole.headers["Etag"])
                assert same.status == 304

    asyncio.run(asyncio.wait_for(work(), 90))
    assert logged_clients(caplog) == {VISITOR}


def logged_clients(caplog: pytest.LogCaptureFixture) -> set[str]:
    return {record.splatwire_fields["client"] for record in caplog.records if hasattr(record, "splatwire_fields")}
