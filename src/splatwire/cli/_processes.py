"""Processes that a command starts, and ends with itself."""

import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress

GRACE_S = 5.0
"""Time for a process to remove its temporary files after SIGTERM, seconds."""
OWN_PROGRAM = (sys.executable, "-P", "-m", "splatwire")
"""Command that runs splatwire in another process. It imports no module from the current folder, such as a `random.py`.
"""


class Processes:
    """Runs commands in processes that can all be ended at the same time. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[str]] = set()
        self._ended = False

    def run(self, command: Sequence[str]) -> "subprocess.CompletedProcess[str]":
        """Runs a command without standard input, and waits until the process ends.

        Args:
            command: Program and arguments.

        Returns:
            The finished process, with its exit status, standard output and standard error.

        Raises:
            KeyboardInterrupt: If the method `end` was called before.
        """
        pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
        with self._lock:
            if self._ended:
                raise KeyboardInterrupt
            process = subprocess.Popen(command, stdin=nothing, stdout=pipe, stderr=pipe, text=True)
            self._running.add(process)
        try:
            printed, errors = process.communicate()
        finally:
            with self._lock:
                self._running.discard(process)
        return subprocess.CompletedProcess(command, process.returncode, printed, errors)

    def end(self) -> None:
        """Ends all running processes, and prevents new ones.

        The processes get `GRACE_S` seconds to remove their temporary files.
        """
        with self._lock:
            self._ended = True
            running = list(self._running)
        for process in running:
            process.terminate()
        end = time.monotonic() + GRACE_S
        for process in running:
            # their threads wait for them at the same time, which `Popen.wait` permits
            with suppress(subprocess.TimeoutExpired):
                process.wait(max(end - time.monotonic(), 0))
            process.kill()


def end_process(process: "subprocess.Popen[str]") -> None:
    """Ends a process if it still runs. The process gets `GRACE_S` seconds to remove its temporary files."""
    if process.poll() is None:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(GRACE_S)
    process.kill()
