"""Tensors behind a JSON header in one safetensors file, written all or nothing."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor


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
