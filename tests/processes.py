"""Servers in separate processes."""

import contextlib
import json
import subprocess
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def server_process(command: list[str], *, polite: bool = True) -> Iterator[dict[str, Any]]:
    """Runs a server, yields the JSON object that it prints first, and ends it.

    Args:
        command: The command.
        polite: True if the server must exit with status 0 after a signal.
    """
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert server.stdout is not None
    try:
        yield json.loads(server.stdout.readline())
    finally:
        server.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            server.wait(120)
        if server.poll() is None:
            server.kill()
            server.wait(120)
        server.stdout.close()
    assert server.returncode == 0 or not polite
