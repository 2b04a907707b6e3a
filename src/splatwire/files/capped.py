"""Reading within a limit: no pipe that blocks, no device without an end, no file that fills the memory."""

import json
import stat
from io import BufferedReader
from pathlib import Path
from typing import Any

from splatwire.errors import SplatwireError
from splatwire.files.kinds import is_not

MAX_JSON_BYTES = 64 << 20
"""The poses of some 50,000 photos; what is parsed takes up to 25 times the memory."""


def open_regular(path: Path, error: type[SplatwireError]) -> BufferedReader:
    """Opens an ordinary file for reading.

    Args:
        path: The file.
        error: What is raised: the kind of error that the caller's room speaks of.

    Raises:
        SplatwireError: An `error` if it is missing, a folder, a pipe or a device, or cannot be read.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise error(is_not(path, "an ordinary file"))
        return path.open("rb")
    except FileNotFoundError as problem:
        raise error(is_not(path, "an ordinary file")) from problem
    except (OSError, ValueError) as problem:  # ValueError: a name with a zero byte
        raise error(f"{path} cannot be read: {getattr(problem, 'strerror', None) or problem}") from problem


def read_at_most(path: Path, size: int, error: type[SplatwireError]) -> bytes:
    """Reads the first `size` bytes of an ordinary file, or all if it has fewer.

    Raises:
        SplatwireError: An `error` as `open_regular`.
    """
    with open_regular(path, error) as file:
        try:
            return file.read(size)
        except OSError as problem:
            raise error(f"{path} cannot be read: {problem.strerror or problem}") from problem


def read_capped(path: Path, limit: int, error: type[SplatwireError]) -> bytes:
    """Reads an ordinary file of at most `limit` bytes.

    Raises:
        SplatwireError: An `error` as `open_regular`, or if the file is larger.
    """
    data = read_at_most(path, limit + 1, error)
    if len(data) > limit:
        raise error(f"{path}: larger than {limit:,} bytes")
    return data


def read_json(path: Path, error: type[SplatwireError]) -> Any:
    """Reads a JSON file of at most `MAX_JSON_BYTES`.

    Raises:
        SplatwireError: An `error` as `read_capped`, or if it is not JSON.
    """
    data = read_capped(path, MAX_JSON_BYTES, error)
    try:
        return json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as problem:
        raise error(is_not(path, "readable JSON", str(problem))) from problem
