"""Child process that reads one OpenUSD scene with usd-core, and sends the result to the parent process.

The memory and the time of the process are limited. The command is `python -m splatwire.io.formats._usd_worker TASK
FILE`, where TASK is `scene`, `times` or `frames`. Each message is a line of JSON: an object with one key. The float32
arrays of the Gaussians follow after a message with the key `content`.
"""

import faulthandler
import json
import logging
import os
import sys
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from pxr import Usd

from splatwire.errors import DatasetError
from splatwire.io.formats._usd_limits import Limits
from splatwire.io.formats._usd_process import FRAMES, SCENE, TIMES
from splatwire.io.formats._usd_stage import Stage, as_dataset_errors, first_line
from splatwire.io.formats.content import FileContent
from splatwire.types.metadata import metadata_to_json

_NO_MEMORY = "std::bad_alloc"
"""Name of the C++ exception for a failed memory allocation, as in messages of usd-core."""


class _Sender(logging.Handler):
    """Sends results and log records to the parent process; used in the child process that reads an OpenUSD scene.

    Args:
        sink: Output that the parent process reads.
        limits: Limits on the memory and time of the current process. The limit on wall-clock time is suspended while a
            message is written.
    """

    def __init__(self, sink: BinaryIO, limits: Limits) -> None:
        super().__init__()
        self._sink, self._limits = sink, limits

    def send(self, key: str, value: Any, arrays: tuple[np.ndarray, ...] = ()) -> None:
        """Writes a message to the parent process: a line of JSON, followed by the values of arrays as float32.

        Args:
            key: Key of the message.
            value: Value of the message, JSON-serialisable.
            arrays: Arrays that follow the line.
        """
        self._limits.pause()  # the receiver may take any time
        self._sink.write(json.dumps({key: value}).encode() + b"\n")
        for array in arrays:
            self._sink.write(np.ascontiguousarray(array, np.float32).reshape(-1).view(np.uint8).data)
        self._sink.flush()
        self._limits.resume()

    def send_content(self, content: FileContent) -> None:
        """Writes a message with Gaussians and scene properties to the parent process, then restarts the time limits."""
        splats = content.splats
        message = {
            "count": splats.num_gaussians,
            "degree": splats.degree,
            "origin": list(content.origin),
            "metadata": metadata_to_json(content.metadata),
        }
        self.send("content", message, tuple(getattr(splats, field.name) for field in fields(splats)))
        self._limits.restart()

    def emit(self, record: logging.LogRecord) -> None:
        self.send("log", [record.name, record.levelno, record.getMessage()])


def read_messages(task: str, path: Path, limits: Limits) -> Iterator[tuple[str, Any]]:
    """Reads a scene in this process and yields the results as messages.

    Args:
        task: Content to read: `SCENE`, `FRAMES` or `TIMES`.
        path: The scene.
        limits: Limits on the memory and time of the current process.

    Yields:
        Keys and values of messages: `content` with a FileContent, or `frames` with the result of `Stage.frames`.
    """
    with as_dataset_errors(path):
        stage = Stage(path, limits)
        if task != TIMES:
            stage.warn_of_left_out()
        if task == SCENE:
            stage.warn_of_motion()
            yield "content", stage.content(Usd.TimeCode.EarliestTime())
            return
        frames = stage.frames()
        yield "frames", frames
        for time in frames[0] if frames is not None and task == FRAMES else ():
            yield "content", stage.content(Usd.TimeCode(time), may_be_empty=True)


def main(task: str, path: Path, sink: BinaryIO) -> None:
    """Reads a scene under limits on memory and time, and sends the results or an error as messages.

    Args:
        task: Content to read: `SCENE`, `FRAMES` or `TIMES`.
        path: The scene.
        sink: Output to which the messages are written.
    """
    limits = Limits(are_set=True)
    sender = _Sender(sink, limits)
    logging.getLogger().addHandler(sender)
    logging.getLogger().setLevel(logging.DEBUG)
    try:
        for key, value in read_messages(task, path, limits):
            if key == "content":
                sender.send_content(value)
            else:
                sender.send(key, value)
    except (DatasetError, MemoryError) as error:
        text = str(error)
        if isinstance(error, MemoryError) or _NO_MEMORY in text:
            memory = f"more than {limits.memory / 1e9:.1f} GB of memory"
            text = f"{path}: usd-core cannot read it: it needs {memory}, so that it is probably damaged"
        sender.send("refused", text)
    except BrokenPipeError:
        raise
    except OSError as error:
        sender.send("refused", f"{path}: {error}")
    except Exception as error:  # usd-core may raise anything in a damaged file
        sender.send("refused", f"{path}: usd-core cannot read it: {type(error).__name__}: {first_line(error)}")
    sender.send("end", None)


if __name__ == "__main__":
    faulthandler.enable()
    results = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # usd-core may print
    main(sys.argv[1], Path(sys.argv[2]), results)
    results.flush()
    os._exit(0)  # a damaged scene may crash the release of its memory
