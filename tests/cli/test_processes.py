"""Processes of a command end with it."""

import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from splatwire.cli._processes import Processes

PYTHON = (sys.executable, "-c")


def test_a_process_that_ends_by_itself_gives_its_status_and_output():
    done = Processes().run([*PYTHON, "import sys; print('out'); print('err', file=sys.stderr); sys.exit(3)"])
    assert (done.returncode, done.stdout.strip(), done.stderr.strip()) == (3, "out", "err")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no exit status of a signal")
def test_running_processes_are_ended_and_waiting_ones_are_not_started(tmp_path):
    processes, begun = Processes(), tmp_path / "begun"
    command = [*PYTHON, f"import pathlib, time; pathlib.Path({str(begun)!r}).touch(); time.sleep(300)"]
    with ThreadPoolExecutor(1) as pool:
        first, second = (pool.submit(processes.run, command) for _ in range(2))
        deadline = time.monotonic() + 300
        while not begun.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        processes.end()
    assert first.result().returncode == -signal.SIGTERM
    with pytest.raises(KeyboardInterrupt):
        second.result()
