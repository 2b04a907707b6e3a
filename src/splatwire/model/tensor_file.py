"""Tensors behind a JSON header in one safetensors file, written all or nothing."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.files.capped import open_regular
from splatwire.files.kinds import is_not
from splatwire.files.whole import written_whole
from splatwire.ops.arrays import to_numpy


def write_tensors(tensors: Mapping[str, Any], header: dict[str, Any], path: Path) -> None:
    """Writes tensors with a JSON header beside the old file, which it then replaces.

    Args:
        tensors: Numpy arrays, or torch tensors on any device; they may share memory.
        header: What `json` can write; it becomes the only metadata entry, because safetensors writes several in no
            fixed order.
        path: The file. It gets the permissions of any new file; safetensors itself would make it private.

    Raises:
        OSError: If the file cannot be written.
    """
    plain = {name: np.ascontiguousarray(to_numpy(value)) for name, value in tensors.items()}
    with written_whole(path) as unfinished:
        unfinished.touch()
        permissions = unfinished.stat().st_mode & 0o777
        try:
            save_file(plain, unfinished, metadata={"splatwire": json.dumps(header, sort_keys=True)})
        except SafetensorError as error:
            raise OSError(f"{path}: cannot be written: {error}") from error
        unfinished.chmod(permissions)


def read_tensors(path: Path, form: str, version: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Reads what `write_tensors` wrote.

    Args:
        path: The file.
        form: The header's `format`.
        version: The header's `version`.

    Returns:
        The arrays, and the header.

    Raises:
        UnsupportedVersionError: If it is of a version that this release does not read.
        BitstreamError: If it is absent, damaged or something else.
    """
    open_regular(path, BitstreamError).close()
    try:
        with safe_open(path, framework="np") as file:
            header = parse_header((file.metadata() or {}).get("splatwire"))
            if header.get("format") != form:
                raise BitstreamError(is_not(path, f"a file of {form}"))
            if header.get("version") != version:
                raise UnsupportedVersionError(f"{path}: version {header.get('version')!s:.20} of {form} is not read")
            return {name: file.get_tensor(name) for name in file.keys()}, header  # noqa: SIM118 - not a dictionary
    except (SafetensorError, OSError) as error:
        raise BitstreamError(is_not(path, f"a file of {form}", str(error))) from error


def parse_header(text: str | None) -> dict[str, Any]:
    """The JSON header; empty if it is none."""
    try:
        header = json.loads(text or "null")
    except (ValueError, RecursionError):
        header = None
    return header if isinstance(header, dict) else {}


def tensor_bytes(path: Path) -> dict[str, int]:
    """Bytes of the tensors of a scene file by the first word of their name; the rest of the file is `header`."""
    parts: dict[str, int] = {}
    with safe_open(path, framework="np") as file:
        for name in file.keys():  # noqa: SIM118 - not a mapping
            tensor = file.get_tensor(name)
            group = name.split(".")[0]
            parts[group] = parts.get(group, 0) + tensor.nbytes
    parts["header"] = path.stat().st_size - sum(parts.values())
    return parts
