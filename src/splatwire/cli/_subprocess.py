"""Runs subcommands in a new process."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splatwire.anchors.scene_file import load_partial
from splatwire.bitstream import SceneStream, write_stream
from splatwire.cli._processes import OWN_PROGRAM, end_process
from splatwire.errors import DesyncError, SplatwireError
from splatwire.types import ReceivedScene
from splatwire.types.scene_digest import scene_digest

_WARNING = "splatwire: warning: "


def decode_in_fresh_process(stream: SceneStream) -> ReceivedScene:
    """Decodes a stream in a new Python interpreter.

    Args:
        stream: The received stream.

    Raises:
        SplatwireError: If the other process failed, with the message of that process.
        DesyncError: If the digest of the scene differs from that printed by the other process.
    """
    with tempfile.TemporaryDirectory(prefix="splatwire-") as name:
        sent, decoded = Path(name) / "received.swz", Path(name) / "decoded.scene"
        write_stream(stream, sent)
        with in_fresh_process("decode", sent, "-o", decoded) as answer:
            digest = answer()["digest"]
        received = load_partial(decoded)
    if scene_digest(received.scene.anchors) != digest:
        raise DesyncError("the scene that a fresh process decoded is not the one that was read back")
    return received


@contextmanager
def in_fresh_process(verb: str, *arguments: object) -> Iterator[Callable[[], dict[str, Any]]]:
    """Context that runs a subcommand in a separate process.

    Args:
        verb: Name of the subcommand.
        *arguments: Command-line arguments of the subcommand.

    Yields:
        Function that waits for the process, prints its warnings, and returns the JSON object that it printed.

    Raises:
        SplatwireError: From the yielded function, if the process failed.
    """
    # The process ends with the `with` block at the latest.
    command = [*OWN_PROGRAM, verb, *map(str, arguments), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def answer() -> dict[str, Any]:
        printed, errors = process.communicate()
        if process.returncode != 0:
            raise SplatwireError(f"{verb} in a fresh process failed: {' '.join(errors.split())[-500:]}")
        for line in errors.splitlines():
            if line.startswith(_WARNING):
                print(line, file=sys.stderr, flush=True)
        content: dict[str, Any] = json.loads(printed)
        return content

    with process:
        try:
            yield answer
        finally:
            end_process(process)
