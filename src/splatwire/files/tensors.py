"""What `torch.save` wrote, looked at before PyTorch reads it: a size, and a description of plain tensors alone."""

import re
import zipfile
from pathlib import Path
from pickletools import genops
from typing import BinaryIO

from splatwire.errors import SplatwireError
from splatwire.files.archive import open_archive
from splatwire.files.capped import open_regular

MAX_TENSOR_FILE_BYTES = 256 << 20
_MAX_DESCRIPTION_BYTES = 1 << 20
_OLD_DESCRIPTIONS = 5
"""Before PyTorch 1.6 a file began with so many of them, one behind the other, and was no archive."""
_PLAIN = re.compile(r"collections OrderedDict|torch\._utils _rebuild_(tensor_v2|parameter)|torch \w{1,20}Storage")
"""What `torch.save` names in the description of plain tensors. PyTorch itself lets a description also make byte arrays
and sets of any size."""


def check_tensor_file(path: Path, error: type[SplatwireError], limit: int = MAX_TENSOR_FILE_BYTES) -> None:
    """Checks that a file may be given to `torch.load`, with `weights_only`: then it takes no more memory than bytes.

    Args:
        path: The file.
        error: What is raised: the kind of error that the caller's room speaks of.
        limit: Most bytes that it may have.

    Raises:
        SplatwireError: An `error` if it is absent, too large, packed, or asks for anything but plain tensors.
    """
    if not path.is_file():
        raise error(f"{path}: missing")
    if path.stat().st_size > limit:
        raise error(f"{path}: larger than {limit >> 20} MiB")
    try:
        if zipfile.is_zipfile(path):
            with open_archive(path, error) as archive:
                archive.refuse_packed()
                for name in archive.sizes:
                    if name.endswith("data.pkl"):
                        _refuse_calls(archive.read(name, _MAX_DESCRIPTION_BYTES))
        else:
            with open_regular(path, error) as file:
                for _ in range(_OLD_DESCRIPTIONS):
                    _refuse_calls(file)
    except ValueError as problem:
        raise error(f"{path}: not a readable file of plain tensors: {str(problem)[:200]}") from problem


def _refuse_calls(description: bytes | BinaryIO) -> None:
    """Checks that a description names nothing but what plain tensors are made of."""
    for code, argument, _ in genops(description):
        odd = code.name == "GLOBAL" and not _PLAIN.fullmatch(str(argument))
        if odd or code.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
            raise ValueError(f"it asks for {str(argument or code.name)[:80]}")
