"""Verbs that serve: addresses, counts, what ends them, errors that belong to no client."""

import asyncio
import errno
import signal
import subprocess
import sys
import threading
import time
from urllib.request import urlopen

import pytest

from splatwire.cli._background import first_of, start_thread
from splatwire.cli._listening import REPORT_S, Listening, LoopErrors, Opened, stop_on_signals, url_host
from splatwire.transport import ServerLimits, make_program
from splatwire.transport.address import parse_url
from splatwire.transport.page import PageServer
from splatwire.transport.page_content import PageContent
from splatwire.transport.udp import UdpServer
from transport.network import datagram_stream


@pytest.mark.parametrize("host", ["::1", "::", "fe80::1", "127.0.0.1", "localhost", "[::1]"])
@pytest.mark.parametrize("quic", [False, True])
def test_a_printed_address_is_one_that_receive_takes(capsys, host, quic):
    Listening(host=host, quic=quic).tell_ready(48900, {}, "serving")
    address = parse_url(capsys.readouterr().out.split()[-1])
    assert (address.host, address.port) == (host.strip("[]"), 48900)
    assert url_host(host) == (f"[{host.strip('[]')}]" if ":" in host else host)


def test_downloads_over_http_are_counted():
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    program = make_program(datagram_stream(num_anchors=400, side_bytes=2000))

    async def work() -> Opened:
        server = UdpServer({"scene": program}, "127.0.0.1", 0, limits=ServerLimits())
        try:
            async with PageServer(PageContent({"scene": program}, None, "127.0.0.1")) as page:
                opened = Opened(server, {}, page)
                await asyncio.to_thread(lambda: urlopen(f"{page.url}streams/scene.swz", timeout=20).read())
                return opened
        finally:
            server.close()

    opened = asyncio.run(asyncio.wait_for(work(), 30))
    assert opened.page.bytes_sent > sum(map(len, program.packets))
    assert opened.served() == f"served 0 clients, 0 bytes, and 1 requests over HTTP, {opened.page.bytes_sent:,} bytes"


def test_file_descriptors_that_run_out_are_one_line_now_and_then(capsys):
    now = [0.0]
    errors, loop = LoopErrors(lambda: now[0]), asyncio.new_event_loop()
    context = {
        "message": "socket.accept() out of system resource",
        "exception": OSError(errno.EMFILE, "Too many open files"),
    }
    for _ in range(1000):
        errors(loop, context)
    now[0] = REPORT_S
    errors(loop, context)
    loop.close()
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert said[0].startswith("splatwire: error: Too many open files; no more connections")
    assert "ulimit -n" in said[0]


def test_work_that_hangs_does_not_keep_a_verb_from_ending():
    hangs = threading.Event()

    async def work() -> float:
        stop, began = asyncio.Event(), time.monotonic()
        future = start_thread(hangs.wait, "hangs")
        asyncio.get_running_loop().call_later(0.05, stop.set)
        await first_of(future, stop, 0.1)
        assert not future.done()
        return time.monotonic() - began

    try:
        assert asyncio.run(asyncio.wait_for(work(), 20)) < 10  # an executor would be waited for
    finally:
        hangs.set()


@pytest.mark.parametrize("fails", [False, True])
def test_work_that_ends_gives_its_result_or_its_error(fails):
    async def work():
        future = start_thread(lambda: 1 // (not fails), "ends")
        await first_of(future, asyncio.Event(), 1.0)
        return future.result()

    if fails:
        with pytest.raises(ZeroDivisionError):
            asyncio.run(work())
    else:
        assert asyncio.run(work()) == 1


def test_the_second_signal_ends_a_verb_whatever_it_waits_for():
    async def work() -> None:
        stop = stop_on_signals()
        signal.raise_signal(signal.SIGINT)
        await asyncio.wait_for(stop.wait(), 10)
        signal.raise_signal(signal.SIGINT)
        await asyncio.sleep(10)

    with pytest.raises(KeyboardInterrupt):
        asyncio.run(work())


STUCK = """
import os, signal, sys, threading
from concurrent.futures import ThreadPoolExecutor
from splatwire.cli import live
from splatwire.cli.main import main

def run(self):
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    with ThreadPoolExecutor(1) as pool:
        pool.submit(threading.Event().wait).result()

live.LiveEncoding.run = run
live.STOP_S = 0.3
main(["live", sys.argv[1], "--port", "0"])
"""


def test_live_ends_at_ctrl_c_though_its_encoder_hangs(tmp_path):
    """A thread of an executor is waited for by the interpreter, for ever if it hangs in a read or a kernel."""
    words = [sys.executable, "-c", STUCK, str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "did not end within 0.3 s" in done.stderr
    assert "0 frames, 0 skipped, 0 dropped" in done.stderr
