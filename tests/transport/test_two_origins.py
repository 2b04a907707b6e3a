"""Two servers that encode one live source, behind nginx with the configuration in deploy/: transfers are shared, and
new ones work while one server is down."""

import asyncio
import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from moving_sequences import moving_frames
from splatwire.io import open_scene
from splatwire.io.formats import write_splats
from transport.test_reverse_proxies import DEPLOY, NGINX, free_port, replaced, running

MODULE = Path("/usr/lib/nginx/modules/ngx_stream_module.so")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(NGINX is None or not MODULE.is_file(), reason="nginx with its stream module is not installed"),
]
FRAMES = 6
MAIN = """
daemon off;
load_module {module};
{user}
pid {folder}/pid;
error_log stderr;
events {{}}
stream {{ include {folder}/site.conf; }}
"""


@contextlib.contextmanager
def splatwire(*words: object) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "splatwire", *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


async def frame_of(folder: Path, number: int) -> Path:
    """Waits for a received frame."""
    path = folder / f"frame_{number:06}.ply"
    for _ in range(12_000):
        if path.exists():
            return path
        await asyncio.sleep(0.05)
    raise AssertionError(f"{path.name} did not arrive; there are {list(folder.glob('*'))}")


async def bound(port: int) -> None:
    """Waits until a process listens on a UDP port."""
    for _ in range(12_000):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            try:
                other.bind(("127.0.0.1", port))
            except OSError:
                return
        await asyncio.sleep(0.01)
    raise AssertionError(f"no process listens on port {port}")


def nginx_words(folder: Path, listening: int, origins: list[int]) -> list[str]:
    site = (DEPLOY / "nginx-origins.conf").read_text(encoding="utf-8")
    site = replaced(site, "listen 4840 udp", f"listen 127.0.0.1:{listening} udp")
    for n, port in enumerate(origins, 1):
        site = replaced(site, f"10.0.0.{n}:4840", f"127.0.0.1:{port}")
    (folder / "site.conf").write_text(site)
    user = "user root;" if os.geteuid() == 0 else ""
    (folder / "nginx.conf").write_text(MAIN.format(module=MODULE, user=user, folder=folder))
    return [str(NGINX), "-p", str(folder), "-e", "stderr", "-c", str(folder / "nginx.conf")]


@pytest.mark.parametrize("scheme", ["udp", "quic"])
def test_transfers_are_shared_and_go_to_the_server_that_is_left(tmp_path: Path, scheme: str):
    if scheme == "quic":
        pytest.importorskip("aioquic", reason="aioquic is not installed")
    source = tmp_path / "source"
    source.mkdir()
    for number, frame in enumerate(moving_frames(200, FRAMES)):
        write_splats([frame], tmp_path / f"frame_{number}.ply")

    def give(numbers: range) -> None:
        for number in numbers:
            shutil.move(tmp_path / f"frame_{number}.ply", source / f"frame_{number}.ply")

    async def work() -> None:
        async with contextlib.AsyncExitStack() as stack:
            options = ["--group", 2, "--fps", 100, "--port", 0, "--clients-per-address", 64, "--json"]
            options += ["--quic"] if scheme == "quic" else []
            servers = [stack.enter_context(splatwire("live", source, *options)) for _ in range(2)]
            ports = [json.loads(server.stdout.readline())["port"] for server in servers]
            listening = free_port()
            await stack.enter_async_context(running(nginx_words(tmp_path, listening, ports), (), tmp_path))
            await bound(listening)
            url = f"{scheme}://127.0.0.1:{listening}"
            trust = ("--insecure",) if scheme == "quic" else ()  # each server has its own certificate
            for name in ("first", "second"):
                stack.enter_context(splatwire("receive", url, "-o", tmp_path / name, "--json", *trust))
            give(range(4))
            for name in ("first", "second"):
                await frame_of(tmp_path / name, 3)  # clients that join late get the last group
            servers[0].send_signal(signal.SIGINT)
            _, report = await asyncio.to_thread(servers[0].communicate)
            assert "served 1 clients" in report
            stack.enter_context(splatwire("receive", url, "-o", tmp_path / "third", "--json", *trust))
            give(range(4, FRAMES))
            last = await frame_of(tmp_path / "third", FRAMES - 1)
            assert open_scene(last).num_elements > 100
            servers[1].send_signal(signal.SIGINT)
            _, report = await asyncio.to_thread(servers[1].communicate)
            assert "served 2 clients" in report

    asyncio.run(asyncio.wait_for(work(), 1800))
