"""Verbs in a fresh process: to prove that a stream's bytes are all that a decoder needs, and to use both processors."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.errors import DesyncError, SplatwireError

if TYPE_CHECKING:
    from splatwire.model import Partial
    from splatwire.packets import SceneStream


def decode_in_fresh_process(stream: "SceneStream") -> "Partial":
    """Writes a stream to a file, has a new interpreter decode it, and reads the scene back.

    Args:
        stream: What arrived.

    Raises:
        SplatwireError: If the other process failed; the message is its own.
        DesyncError: If the scene read back is not the one whose digest the other process printed.
    """
    from splatwire.model.scene_digest import scene_digest
    from splatwire.model.scene_file import load_partial
    from splatwire.packets import write_stream

    with tempfile.TemporaryDirectory(prefix="splatwire-") as name:
        sent, decoded = Path(name) / "received.swz", Path(name) / "decoded.scene"
        write_stream(stream, sent)
        with in_fresh_process("decode", sent, "-o", decoded) as answer:
            digest = answer()["digest"]
        partial = load_partial(decoded)
    if scene_digest(partial.scene.anchors) != digest:
        raise DesyncError("the scene that a fresh process decoded is not the one that was read back")
    return partial


@contextmanager
def in_fresh_process(verb: str, *arguments: object) -> Iterator[Callable[[], dict[str, Any]]]:
    """Runs a verb in a process of its own, which ends with the block at the latest.

    Args:
        verb: Which one.
        arguments: Its words.

    Yields:
        What waits for the process and returns the JSON object that it prints.

    Raises:
        SplatwireError: By what is yielded, if the process failed; the message is its own.
    """
    command = [sys.executable, "-m", "splatwire", verb, *map(str, arguments), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def answer() -> dict[str, Any]:
        printed, errors = process.communicate()
        if process.returncode != 0:
            raise SplatwireError(f"{verb} in a fresh process failed: {' '.join(errors.split())[-500:]}")
        content: dict[str, Any] = json.loads(printed)
        return content

    with process:
        try:
            yield answer
        finally:
            process.kill()
