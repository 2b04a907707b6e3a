"""Bounded reading of ordinary files: never blocks on pipes or devices, never exceeds a size limit."""

import json
import stat
from io import BufferedReader
from pathlib import Path
from typing import Any

from splatwire.errors import SplatwireError
from splatwire.files.kinds import format_error
from splatwire.files.opened import OpenedFile

MAX_JSON_BYTES = 64 << 20
"""Maximum size of a JSON file, bytes: enough for the camera poses of about 50,000 photos. Parsing takes up to 25 times
the memory.
"""


def open_regular(path: Path, error: type[SplatwireError]) -> BufferedReader:
    """Opens an ordinary file (no pipe or device) for reading.

    Args:
        path: The file; a path that is already open is not opened again.
        error: Exception class to raise if the path is not an ordinary file.

    Raises:
        SplatwireError: An exception of class `error` if the file is missing, cannot be read, or is a folder, a pipe or
            a device.
    """
    if isinstance(path, OpenedFile) and (file := path.reader()) is not None:
        return file
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise error(format_error(path, "an ordinary file"))
        return path.open("rb")
    except FileNotFoundError as problem:
        raise error(format_error(path, "an ordinary file")) from problem
    except (OSError, ValueError) as problem:  # ValueError: the path contains a zero byte
        raise error(f"{path} cannot be read: {getattr(problem, 'strerror', None) or problem}") from problem


def read_at_most(path: Path, size: int, error: type[SplatwireError]) -> bytes:
    """Reads the first `size` bytes of an ordinary file, or the whole file if it is shorter.

    Raises:
        SplatwireError: An exception of class `error` if the path is not an ordinary file, or the file cannot be read.
    """
    with open_regular(path, error) as file:
        try:
            return file.read(size)
        except OSError as problem:
            raise error(f"{path} cannot be read: {problem.strerror or problem}") from problem


def read_limited(path: Path, limit: int, error: type[SplatwireError]) -> bytes:
    """Reads an ordinary file of at most `limit` bytes.

    Raises:
        SplatwireError: An exception of class `error` if the path is not an ordinary file, or the file cannot be read or
            is larger than the limit.
    """
    data = read_at_most(path, limit + 1, error)
    if len(data) > limit:
        raise error(f"{path}: larger than {limit:,} bytes")
    return data


def read_json(path: Path, error: type[SplatwireError]) -> Any:
    """Reads a JSON file of at most `MAX_JSON_BYTES`.

    Raises:
        SplatwireError: An exception of class `error` if the path is not an ordinary file, or the file is too large or
            is not JSON.
    """
    data = read_limited(path, MAX_JSON_BYTES, error)
    try:
        return json.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as problem:
        raise error(format_error(path, "readable JSON", str(problem))) from problem
