"""A real sender and receiver in a network namespace; its loopback loses, delays and reorders (tc netem).

The tests are skipped if the kernel has no netem; `benchmarks/with_netem.sh` runs them under one that has.
"""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from processes import server_process
from splatwire.bitstream import read_stream, write_stream
from transport.network import datagram_stream

pytestmark = pytest.mark.slow

pytest.importorskip("raptorq", reason="the package raptorq is not installed")


def tool(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)


@pytest.fixture
def namespace() -> Iterator[str]:
    """A fresh network namespace with loopback; skips without the necessary privileges."""
    if not (shutil.which("ip") and shutil.which("tc")):
        pytest.skip("ip and tc (iproute2) are not installed; the lossy relay of test_udp.py stands in")
    name = f"splatwire-{uuid.uuid4().hex[:8]}"
    made = tool("ip", "netns", "add", name)
    if made.returncode:
        pytest.skip(f"no right to make network namespaces ({made.stderr.strip()[:80]}); test_udp.py's relay stands in")
    try:
        tool("ip", "netns", "exec", name, "ip", "link", "set", "lo", "up")
        yield name
    finally:
        tool("ip", "netns", "del", name)


@contextlib.contextmanager
def serving(namespace: str, stream: Path) -> Iterator[int]:
    """A server process in a namespace; yields its port."""
    words = ["ip", "netns", "exec", namespace, sys.executable, "-m", "splatwire"]
    command = [*words, "serve", str(stream), "--port", "0", "--json"]
    with server_process(command, polite=False) as ready:
        yield int(ready["port"])


@pytest.mark.parametrize(
    "netem",
    [
        "delay 5ms 2ms loss random 20% duplicate 1%",
        "delay 5ms loss gemodel 1.25% 5% 100% 0%",
        "delay 5ms rate 20mbit loss 20%",
    ],
)
def test_serve_and_receive_work_over_netem(namespace: str, netem: str, tmp_path: Path):
    made = tool("ip", "netns", "exec", namespace, "tc", "qdisc", "add", "dev", "lo", "root", "netem", *netem.split())
    if made.returncode:
        pytest.skip(f"netem is not available ({made.stderr.strip()[:80]}); the relay of test_udp.py stands in")
    stream, target = datagram_stream(), tmp_path / "got.swz"
    write_stream(stream, tmp_path / "scene.swz")
    with serving(namespace, tmp_path / "scene.swz") as port:
        words = ["ip", "netns", "exec", namespace, sys.executable, "-m", "splatwire", "receive"]
        command = [*words, f"udp://127.0.0.1:{port}", "-o", str(target), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=dict(os.environ))
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["finished"] == "complete"
    assert read_stream(target)[0] == stream
