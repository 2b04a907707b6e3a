"""Tensors with a JSON header in one safetensors file, written atomically."""

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import save_file

from splatwire.anchors.safetensors_file import open_tensor_file
from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.files.atomic_write import atomic_output
from splatwire.files.kinds import CHECKPOINT, SCENE_FILES, file_kind, format_error
from splatwire.ops.arrays import to_numpy

_SYSTEM_ERROR = re.compile(r"\(os error ([0-9]+)\)")
_HAS_ERRNO = os.name != "nt"
"""True if the system numbers its errors as the module `errno` does; Windows does not."""


def write_tensors(tensors: Mapping[str, Any], header: dict[str, Any], path: Path) -> None:
    """Writes tensors with a JSON header; atomically replaces an existing file.

    Args:
        tensors: Arrays by name: numpy arrays, or torch tensors on any device.
        header: JSON-serialisable header.
        path: Path of the file.

    Raises:
        OSError: If the file cannot be written.
    """
    plain = {name: np.ascontiguousarray(to_numpy(value)) for name, value in tensors.items()}
    with atomic_output(path) as unfinished:
        unfinished.touch()
        # default permissions; safetensors would make the file private to its owner
        permissions = unfinished.stat().st_mode & 0o777
        try:
            # one metadata entry only, because safetensors does not keep the order of several
            save_file(plain, unfinished, metadata={"splatwire": json.dumps(header, sort_keys=True)})
        except SafetensorError as error:
            raise _system_error(error, path) from error
        unfinished.chmod(permissions)


def _system_error(error: SafetensorError, path: Path) -> OSError:
    """Converts an error of safetensors to OSError.

    If the text of the error states an error of the operating system, such as a full disk, the result is that error.

    Args:
        error: Error of safetensors.
        path: Path of the file, for the message.
    """
    found = _SYSTEM_ERROR.search(str(error)) if _HAS_ERRNO else None
    if found is None:
        return OSError(f"{path}: cannot be written: {error}")
    return OSError(int(found[1]), os.strerror(int(found[1])), str(path))


def read_tensors(path: Path, format_name: str, version: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads a file written by `write_tensors`.

    Args:
        path: The file.
        format_name: Expected `format` of the header.
        version: Expected `version` of the header.

    Returns:
        The arrays, and the header.

    Raises:
        UnsupportedVersionError: If this release does not support the file's version.
        BitstreamError: If the file is absent, damaged or of another format.
    """
    if file_kind(path) not in (*SCENE_FILES, CHECKPOINT):
        raise BitstreamError(format_error(path, f"a file of {format_name}"))
    with open_tensor_file(path) as file:
        header = parse_header(file.metadata.get("splatwire"))
        if header.get("format") != format_name:
            raise BitstreamError(format_error(path, f"a file of {format_name}"))
        if header.get("version") != version:
            raise UnsupportedVersionError(f"{path}: version {header.get('version')!s:.20} of {format_name} is not read")
        return {name: file.tensor(name) for name in file.names}, header


def parse_header(text: str | None) -> dict[str, Any]:
    """Parses the JSON header of a tensor file.

    Returns an empty dictionary for an invalid header.
    """
    try:
        header = json.loads(text or "null")
    except (ValueError, RecursionError):
        header = None
    return header if isinstance(header, dict) else {}


def tensor_bytes(path: Path) -> dict[str, int]:
    """Returns the number of bytes that each group of tensors takes in a scene file.

    Tensors whose names are equal up to the first dot form a group. This part of their names is the name of the group.
    All other bytes of the file are counted under the name `header`.
    """
    parts: dict[str, int] = {}
    with open_tensor_file(path) as file:
        for name in file.names:
            group = name.split(".")[0]
            parts[group] = parts.get(group, 0) + file.num_bytes(name)
        return {**parts, "header": file.header_bytes}
