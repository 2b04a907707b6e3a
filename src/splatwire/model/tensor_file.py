"""Tensors behind a JSON header in one safetensors file, written all or nothing."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from splatwire.errors import BitstreamError, UnsupportedVersionError


def write_tensors(tensors: Mapping[str, Tensor], header: dict[str, Any], path: Path) -> None:
    """Writes tensors with a JSON header beside the old file, which it then replaces.

    Args:
        tensors: Tensors of any shape and device; they may share memory.
        header: What `json` can write; it becomes the only metadata entry, because safetensors writes several in no
            fixed order.
        path: The file. It gets the permissions of any new file; safetensors itself would make it private.

    Raises:
        OSError: If the file cannot be written.
    """
    # Cloned: safetensors refuses tensors that share memory, and views of a larger tensor are common here.
    plain = {name: value.detach().cpu().clone(memory_format=torch.contiguous_format) for name, value in tensors.items()}
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        unfinished.touch()
        permissions = unfinished.stat().st_mode & 0o777
        save_file(plain, unfinished, metadata={"splatwire": json.dumps(header, sort_keys=True)})
        unfinished.chmod(permissions)
        os.replace(unfinished, path)
    except SafetensorError as error:
        raise OSError(f"{path}: cannot be written: {error}") from error
    finally:
        unfinished.unlink(missing_ok=True)


def read_tensors(path: Path, form: str, version: int) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Reads what `write_tensors` wrote.

    Raises:
        UnsupportedVersionError: If it is of a version that this release does not read.
        BitstreamError: If it is absent, damaged or something else.
    """
    try:
        with safe_open(path, framework="pt") as file:
            text = (file.metadata() or {}).get("splatwire")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dictionary
        header = json.loads(text or "null")
    except FileNotFoundError as error:
        raise BitstreamError(f"{path}: no such file") from error
    except (SafetensorError, OSError, ValueError) as error:
        raise BitstreamError(f"{path}: not a file of {form}: {error}") from error
    if not isinstance(header, dict) or header.get("format") != form:
        raise BitstreamError(f"{path}: not a file of {form}")
    if header.get("version") != version:
        raise UnsupportedVersionError(f"{path}: version {header.get('version')} of {form} is not read")
    return tensors, header


def load_tensors(network: torch.nn.Module, tensors: dict[str, Tensor], where: str) -> None:
    """Puts tensors into a network, strictly.

    Raises:
        BitstreamError: If one is missing, too many, of another size, or not finite.
    """
    wanted = network.state_dict()
    if set(tensors) != set(wanted):
        odd = sorted(set(tensors) ^ set(wanted))
        raise BitstreamError(f"{where}tensors of the network are missing or unknown: {', '.join(odd[:3])}")
    for name, value in wanted.items():
        found = tensors[name]
        if found.shape != value.shape or not found.dtype.is_floating_point:
            raise BitstreamError(f"{where}'{name}' is {found.dtype} {tuple(found.shape)}, not {tuple(value.shape)}")
        if not bool(found.isfinite().all()):
            raise BitstreamError(f"{where}'{name}' of the network is not finite")
    network.load_state_dict({name: value.float() for name, value in tensors.items()})


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
