"""Signals of `serve`: reloading of streams and certificates, and stopping after running transfers."""

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest

from scenes import tiny_scene
from splatwire.bitstream import PRESETS, write_stream
from splatwire.codec import encode_scene

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
pytestmark = pytest.mark.slow
PROGRAM = [sys.executable, "-m", "splatwire"]


@dataclass
class Served:
    process: subprocess.Popen[str]
    facts: dict[str, Any]

    def next_event(self, event: str) -> dict[str, Any]:
        """Skips log lines up to the next event of a name, and returns that event."""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            with contextlib.suppress(json.JSONDecodeError):
                found = json.loads(line)
                if found.get("event") == event:
                    return found
        raise AssertionError(f"no {event}")

    def reload(self, event: str = "reloaded") -> dict[str, Any]:
        self.process.send_signal(signal.SIGHUP)
        return self.next_event(event)


@contextlib.contextmanager
def serving(*words: object) -> Iterator[Served]:
    command = [
        *PROGRAM,
        "serve",
        *map(str, words),
        "--port",
        "0",
        "--json",
        "--log-level",
        "info",
        "--log-format",
        "json",
    ]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe, text=True)
    assert process.stdout is not None
    try:
        yield Served(process, json.loads(process.stdout.readline()))
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=600)


def receiving(url: str, target: Path, *words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([*PROGRAM, "receive", url, "-o", str(target), *words], stdout=subprocess.DEVNULL)


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    """Two streams."""
    path = tmp_path_factory.mktemp("two") / "scene.swz"
    found = []
    for seed in (1, 2):
        write_stream(encode_scene(tiny_scene(seed=seed, num_anchors=400), PRESETS["datagram"]), path)
        found.append(path.read_bytes())
    return found[0], found[1]


def seconds_to_send(content: bytes, seconds: float) -> str:
    """Sending rate at which a stream takes some seconds, as text for `--rate`."""
    return str(len(content) * 8e-6 / seconds)


def test_hangup_reloads_streams_and_running_transfers_continue(contents: tuple[bytes, bytes], tmp_path: Path):
    path, (old, new) = tmp_path / "scene.swz", contents
    path.write_bytes(old)
    with serving(path, "--rate", seconds_to_send(old, 2.0)) as server:
        url = f"udp://127.0.0.1:{server.facts['port']}"
        before = receiving(url, tmp_path / "before.swz")
        server.next_event("transfer started")
        path.write_bytes(new)
        assert server.reload()["streams"] == 1
        assert receiving(url, tmp_path / "after.swz").wait(240) == 0
        assert before.wait(240) == 0
        path.write_bytes(new[:100])
        assert "scene.swz" in server.reload("reload failed")["error"]
        assert receiving(url, tmp_path / "still.swz").wait(240) == 0
    assert (tmp_path / "before.swz").read_bytes() == old
    assert (tmp_path / "after.swz").read_bytes() == (tmp_path / "still.swz").read_bytes() == new


@pytest.mark.parametrize("kept", [100, -100])
def test_a_file_that_was_refused_at_a_reload_does_not_change_the_exit_status(contents, tmp_path: Path, kept: int):
    path = tmp_path / "scene.swz"
    path.write_bytes(contents[0])
    with serving(path) as server:
        path.write_bytes(contents[1][:kept])
        server.reload("reload failed")
        server.process.terminate()
        _, said = server.process.communicate(timeout=600)
        assert server.process.returncode == 0
    assert "intact parts" not in said


def test_hangup_reloads_the_certificate_and_the_streams_of_the_page(contents: tuple[bytes, bytes], tmp_path: Path):
    pytest.importorskip("aioquic", reason="the package aioquic is not installed")
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    from splatwire.transport.quic.certificate import self_signed

    path, certificate, key = tmp_path / "scene.swz", tmp_path / "cert.pem", tmp_path / "key.pem"

    def renew() -> str:
        identity = self_signed()
        certificate.write_bytes(identity.certificate.public_bytes(Encoding.PEM))
        key.write_bytes(identity.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
        return identity.fingerprint

    old = renew()
    path.write_bytes(contents[0])
    with serving(path, "--page", 0, "--certificate", certificate, "--key", key) as server:
        url, page = f"quic://127.0.0.1:{server.facts['port']}", f"{server.facts['page']}streams/scene.swz"
        assert server.facts["fingerprint"] == old
        new = renew()
        path.write_bytes(contents[1])
        before = urlopen(page, timeout=600)
        server.reload()
        after = urlopen(page, timeout=600)
        assert before.headers["ETag"] != after.headers["ETag"]
        assert len(before.read()) == len(contents[0])
        assert receiving(url, tmp_path / "got.swz", "--fingerprint", new).wait(240) == 0
        key.write_bytes(b"nonsense")
        path.write_bytes(contents[0])
        server.reload("reload failed")
        assert receiving(url, tmp_path / "got.swz", "--fingerprint", new).wait(240) == 0
        assert urlopen(page, timeout=600).headers["ETag"] == after.headers["ETag"]
    assert (tmp_path / "got.swz").read_bytes() == contents[1]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_stopping_server_finishes_transfers(contents: tuple[bytes, bytes], tmp_path: Path, number: signal.Signals):
    path = tmp_path / "scene.swz"
    path.write_bytes(contents[0])
    with serving(path, "--rate", seconds_to_send(contents[0], 2.0), "--drain", "600") as server:
        client = receiving(f"udp://127.0.0.1:{server.facts['port']}", tmp_path / "got.swz")
        server.next_event("transfer started")
        server.process.send_signal(number)
        assert client.wait(120) == 0
        assert server.process.wait(120) == 0
    assert (tmp_path / "got.swz").read_bytes() == contents[0]


def test_stopping_server_refuses_new_transfers_and_is_not_ready(contents: tuple[bytes, bytes], tmp_path: Path):
    pytest.importorskip("prometheus_client", reason="the package prometheus-client is not installed")
    path = tmp_path / "scene.swz"
    path.write_bytes(contents[0])
    with serving(path, "--rate", "0.001", "--drain", "600", "--monitor", "0") as server:
        url = f"udp://127.0.0.1:{server.facts['port']}"
        client = receiving(url, tmp_path / "never.swz", "--deadline", "600s")
        server.next_event("transfer started")
        server.process.terminate()
        assert receiving(url, tmp_path / "late.swz").wait(120) == 2
        assert server.next_event("transfer refused")["reason"] == "the server stopped"
        with pytest.raises(HTTPError, match="503"):
            urlopen(f"{server.facts['monitor']}readyz", timeout=600)
        client.kill()
        client.wait(240)


def test_stopping_server_ends_after_the_given_time(contents: tuple[bytes, bytes], tmp_path: Path):
    path = tmp_path / "scene.swz"
    path.write_bytes(contents[0])
    with serving(path, "--rate", "0.001", "--drain", "0.2") as server:
        client = receiving(f"udp://127.0.0.1:{server.facts['port']}", tmp_path / "never.swz", "--deadline", "600s")
        server.next_event("transfer started")
        server.process.terminate()
        assert server.process.wait(240) == 0
        client.kill()
        client.wait(240)


@pytest.mark.parametrize("trusted", [True, False])
def test_visitors_behind_a_trusted_proxy_are_logged_by_their_address(contents, tmp_path: Path, trusted: bool):
    pytest.importorskip("aioquic", reason="the package aioquic is not installed")
    path = tmp_path / "scene.swz"
    path.write_bytes(contents[0])
    with serving(path, "--page", 0, "--proxy", "127.0.0.1" if trusted else "192.0.2.1") as server:
        request = Request(f"{server.facts['page']}streams.json", headers={"X-Forwarded-For": "203.0.113.9"})
        assert urlopen(request, timeout=600).status == 200
        found = server.next_event("response")
        assert (found["client"], found["path"]) == ("203.0.113.9" if trusted else "127.0.0.1", "/streams.json")
