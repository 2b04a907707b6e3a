"""Servers on the command line: addresses, counts, shutdown, and errors that belong to no client."""

import asyncio
import contextlib
import errno
import json
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from urllib.request import urlopen

import pytest

from splatwire.cli._background import wait_for_work
from splatwire.cli._listening import (
    REPORT_S,
    LoopErrors,
    check_listening,
    open_server,
    print_ready,
    reload_on_hangup,
    stop_on_signals,
    url_host,
)
from splatwire.cli._options import Listening
from splatwire.errors import InvalidValueError
from splatwire.transport import ServerLimits, make_served_stream
from splatwire.transport.address import parse_url
from splatwire.transport.daemon_thread import start_thread
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.server import PageServer
from splatwire.transport.running_server import RunningServer
from splatwire.transport.udp import UdpServer
from transport.network import datagram_stream

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("host", ["::1", "::", "fe80::1", "127.0.0.1", "localhost", "[::1]"])
@pytest.mark.parametrize("quic", [False, True])
def test_receive_accepts_the_address_that_serve_prints(capsys, host, quic):
    print_ready(Listening(host=host, quic=quic), 48900, {}, "serving")
    address = parse_url(capsys.readouterr().out.split()[-1])
    assert (address.host, address.port) == (host.strip("[]"), 48900)
    assert url_host(host) == (f"[{host.strip('[]')}]" if ":" in host else host)


@pytest.mark.parametrize("rate", [0.0, 1e-9, 0.1, float("nan"), 2e6])
def test_a_total_rate_at_which_transfers_never_end_is_refused(rate):
    check_listening(Listening(total_rate=0.15))
    with pytest.raises(InvalidValueError, match=r"--total-rate is 0\.15 to 1000000"):
        check_listening(Listening(total_rate=rate))


def test_downloads_over_http_are_counted():
    pytest.importorskip("raptorq", reason="the package raptorq is not installed")
    program = make_served_stream(datagram_stream(num_anchors=400, side_bytes=2000))

    async def work() -> RunningServer:
        server = UdpServer({"scene": program}, "127.0.0.1", 0, limits=ServerLimits())
        try:
            async with PageServer(PageContent({"scene": program}, None, "127.0.0.1")) as page:
                opened = RunningServer(server, {}, page)
                await asyncio.to_thread(lambda: urlopen(f"{page.url}streams/scene.swz", timeout=600).read())
                return opened
        finally:
            server.close()

    opened = asyncio.run(asyncio.wait_for(work(), 240))
    assert opened.page.bytes_sent > sum(map(len, program.packets))
    assert opened.served() == f"served 0 clients, 0 bytes, and 1 requests over HTTP, {opened.page.bytes_sent:,} bytes"


def test_exhausted_file_descriptors_are_logged_once_in_a_while(capsys):
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


def test_server_writes_errors_of_the_loop_and_renewed_certificates_into_its_log(capsys):
    pytest.importorskip("aioquic", reason="the package aioquic is not installed")
    from splatwire.cli._quic import _log_renewed
    from splatwire.transport.quic.certificate import self_signed

    async def work() -> None:
        async with contextlib.AsyncExitStack() as stack:
            await open_server({}, Listening(port=0, log_format="json"), ServerLimits(), stack)
            loop = asyncio.get_running_loop()
            loop.call_exception_handler(
                {"message": "accept", "exception": OSError(errno.EMFILE, "Too many open files")}
            )
            loop.call_exception_handler({"message": "odd", "exception": KeyError("lost")})
            _log_renewed(identity)

    identity = self_signed()
    asyncio.run(asyncio.wait_for(work(), 120))
    first, second, third = map(json.loads, capsys.readouterr().err.splitlines())
    assert first["event"] == "server error"
    assert first["error"].startswith("Too many open files; no more connections")
    assert (second["message"], second["traceback"].splitlines()[-1]) == ("odd", "KeyError: 'lost'")
    assert (third["event"], third["fingerprint"]) == ("certificate renewed", identity.fingerprint)


def test_hanging_thread_does_not_block_exit():
    hangs = threading.Event()

    async def work() -> float:
        stop, began = asyncio.Event(), time.monotonic()
        future = start_thread(hangs.wait, "hangs")
        asyncio.get_running_loop().call_later(0.05, stop.set)
        await wait_for_work(future, stop, 0.1)
        assert not future.done()
        return time.monotonic() - began

    try:
        assert asyncio.run(asyncio.wait_for(work(), 120)) < 60  # the interpreter would wait for an executor
    finally:
        hangs.set()


@pytest.mark.parametrize("fails", [False, True])
def test_finished_thread_returns_its_result_or_error(fails):
    async def work():
        future = start_thread(lambda: 1 // (not fails), "ends")
        await wait_for_work(future, asyncio.Event(), 1.0)
        return future.result()

    if fails:
        with pytest.raises(ZeroDivisionError):
            asyncio.run(work())
    else:
        assert asyncio.run(work()) == 1


def test_second_signal_ends_a_verb_immediately():
    async def work() -> None:
        with stop_on_signals() as stop:
            signal.raise_signal(signal.SIGINT)
            await asyncio.wait_for(stop.wait(), 120)
            signal.raise_signal(signal.SIGINT)
            await asyncio.sleep(10)

    with pytest.raises(KeyboardInterrupt):
        asyncio.run(work())


def test_the_second_signal_has_its_earlier_action():
    """With the system's default action, SIGTERM would leave temporary files and processes of the server."""
    received: list[int] = []

    async def work() -> None:
        with stop_on_signals() as stop:
            signal.raise_signal(signal.SIGTERM)
            await asyncio.wait_for(stop.wait(), 120)
            signal.raise_signal(signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, lambda number, _: received.append(number))
    try:
        asyncio.run(work())
    finally:
        signal.signal(signal.SIGTERM, before)
    assert received == [signal.SIGTERM]


def test_a_server_ignores_signals_that_were_ignored_before():
    """A script's background job must not end at the Ctrl-C that is meant for another program."""

    async def work() -> None:
        with stop_on_signals() as stop:
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
            signal.raise_signal(signal.SIGTERM)
            await asyncio.wait_for(stop.wait(), 120)

    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        asyncio.run(work())
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no SIGHUP")
@pytest.mark.parametrize("numbers", [(signal.SIGINT, signal.SIGTERM), (getattr(signal, "SIGHUP", signal.SIGTERM),)])
def test_signals_have_their_earlier_action_after_a_server_that_no_signal_ended(numbers, monkeypatch):
    """With the system's default action, a signal soon after leaves temporary files of the command."""
    monkeypatch.setattr("sys.stdin", None)
    received: list[int] = []

    async def work() -> None:
        with stop_on_signals(), reload_on_hangup():
            pass
        for number in numbers:
            signal.raise_signal(number)

    before = {number: signal.signal(number, lambda number, _: received.append(number)) for number in numbers}
    try:
        asyncio.run(work())
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert received == list(numbers)


STUCK = """
import os, signal, sys, threading
from concurrent.futures import ThreadPoolExecutor
from splatwire.cli import _run_live as live
from splatwire.cli.main import main

def run(self):
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
    with ThreadPoolExecutor(1) as pool:
        pool.submit(threading.Event().wait).result()

live.LiveIngest.run = run
live.STOP_TIMEOUT_S = 0.3
main(["live", sys.argv[1], "--port", "0"])
"""


def test_ctrl_c_ends_live_despite_a_hanging_encoder(tmp_path):
    """The interpreter waits for threads of an executor, forever if one hangs in a read or a kernel."""
    words = [sys.executable, "-c", STUCK, str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 1
    assert "did not end within 0.3 s" in done.stderr
    assert "0 frames, 0 skipped, 0 dropped" in done.stderr


COMPILES = """
import os, signal, sys, threading
from splatwire.cli import _run_live as live
from splatwire.cli.main import main
from splatwire.ops import compiled

def run(self):
    compiled._COMPILATIONS.num_running += 1
    os.kill(os.getpid(), signal.SIGINT)
    threading.Event().wait()

live.LiveIngest.run = run
live.COMPILING_TIMEOUT_S = 0.3
main(["live", sys.argv[1], "--port", "0"])
"""


def run_script(script: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    """Runs a Python script, with a folder as its argument, and returns its exit status and output."""
    words = [sys.executable, "-c", script, str(folder)]
    return subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)


def test_ctrl_c_ends_live_while_kernels_are_compiled(tmp_path):
    done = run_script(COMPILES, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "stopped while kernels were compiled" in done.stderr
    assert "0 frames, 0 skipped, 0 dropped" in done.stderr


WAITS = """
import os, signal, sys, threading
from pathlib import Path
from splatwire.cli import _run_live as live
from splatwire.cli.main import main
from splatwire.ops import compiled

def run(self):
    path = Path(sys.argv[1], "kernel.lock")
    with compiled._file_lock(path, "kernel"):
        threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()
        with compiled._file_lock(path, "kernel"):  # a second handle, as that of another process
            pass

live.LiveIngest.run = run
live.COMPILING_TIMEOUT_S = 0.3
main(["live", sys.argv[1], "--port", "0"])
"""


def test_ctrl_c_ends_live_while_another_process_compiles(tmp_path):
    done = run_script(WAITS, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "waiting for another process that compiles kernel" in done.stderr
    assert "stopped while kernels were compiled" in done.stderr
