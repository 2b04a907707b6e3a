"""Reading of OpenUSD scenes in a separate process, because usd-core may crash on damaged files."""

import json
import logging
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Generator, Iterator
from dataclasses import fields
from pathlib import Path
from typing import IO, Any

import numpy as np

from splatwire.errors import DatasetError
from splatwire.io.formats.content import FileContent
from splatwire.types.metadata import metadata_from_json
from splatwire.types.splats import Splats

SCENE, TIMES, FRAMES = "scene", "times", "frames"
"""Tasks: read the first frame with all warnings, the times of the frames, or all frames."""
_WORKER = "splatwire.io.formats._usd_worker"
_ONE_THREAD = ("PXR_WORK_THREAD_LIMIT", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables for the number of threads: each thread takes address space, which is limited."""


def read_in_process(task: str, path: Path) -> Generator[Any, None, None]:
    """Reads an OpenUSD scene in a separate process, and logs the warnings of that process.

    Args:
        task: Content to read: `SCENE`, `FRAMES` or `TIMES`.
        path: Path of the scene.

    Yields:
        * For `SCENE`: one `FileContent`.
        * For `TIMES`: the timeline, which is a list of time codes and the number of frames per second; None for a still
          scene.
        * For `FRAMES`: the timeline, then a `FileContent` for each frame.

    Raises:
        DatasetError: If the scene cannot be read, the process takes too much memory or time, or it crashes.
        OSError: If the file does not exist, or the process cannot be started.
    """
    path.stat()
    folders = os.pathsep.join(folder or os.getcwd() for folder in sys.path)  # as imported here
    environment = os.environ | dict.fromkeys(_ONE_THREAD, "1") | {"PYTHONPATH": folders}
    command = [sys.executable, "-P", "-m", _WORKER, task, str(path)]
    with tempfile.TemporaryFile() as printed:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=printed, env=environment
        )
        assert process.stdout is not None
        try:
            yield from _received(path, process.stdout)
        except EOFError:
            process.wait()
            printed.seek(0)
            text = printed.read().decode(errors="replace")
            raise DatasetError(f"{path}: usd-core cannot read it: {_exit_reason(process.returncode, text)}") from None
        finally:
            process.kill()
            process.stdout.close()
            process.wait()


def _received(path: Path, source: IO[bytes]) -> Iterator[Any]:
    """Yields the messages of the process that reads an OpenUSD scene, and logs the warnings of this process.

    Args:
        path: Path of the scene, for messages.
        source: Standard output of that process.

    Raises:
        DatasetError: If the process reported an error in the scene.
        EOFError: If the process ended early.
    """
    while line := source.readline():
        if not line.endswith(b"\n"):
            raise EOFError
        ((key, value),) = json.loads(line).items()
        if key == "end":
            return
        if key == "refused":
            raise DatasetError(value)
        if key == "log":
            name, level, text = value
            logging.getLogger(name).log(level, "%s", text)
        elif key == "content":
            yield _content(value, source)
        else:
            yield value
    raise EOFError


def _content(message: dict[str, Any], source: IO[bytes]) -> FileContent:
    """Receives the Gaussians of a message from the process that reads an OpenUSD scene.

    Args:
        message: Content of the message: number and degree of the Gaussians, origin and metadata.
        source: Standard output of the process, from which the arrays are read.
    """
    splats = Splats.empty(message["count"], message["degree"])
    for field in fields(splats):
        rest = memoryview(getattr(splats, field.name).reshape(-1).view(np.uint8))
        while len(rest):
            count = source.readinto(rest)  # type: ignore[attr-defined]
            if not count:
                raise EOFError
            rest = rest[count:]
    return FileContent(splats, tuple(message["origin"]), metadata=metadata_from_json(message["metadata"]))


def _exit_reason(status: int, printed: str) -> str:
    """Describes why a process ended, as part of an error message.

    Args:
        status: Exit status, negative for a signal.
        printed: Error output of the process.
    """
    if -status == getattr(signal, "SIGXCPU", None) or re.search(r"^Timeout \(", printed, re.MULTILINE):
        return "it takes too much time for its size, so that it is probably damaged"
    if status >= 0:
        return f"its process ended with status {status}: {(printed.strip().splitlines() or [''])[-1]:.200}"
    name = signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
    return f"its process was ended by {name}, so that it is probably damaged"
