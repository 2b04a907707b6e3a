"""Training arguments (`cfg_args`), which programs based on 3DGS write into their model folders."""

import re
from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.files.read_limited import read_limited
from splatwire.io.formats.ply_comments import states_antialiasing, warn_of_unclear_antialiasing
from splatwire.types.background import BLACK, WHITE, Background

ARGUMENTS = "cfg_args"
"""Name of the file."""
MODEL_DEPTH = 3
"""Number of folders from a trained PLY up to its model folder: `iteration_N`, `point_cloud`, the model."""
_MAX_BYTES = 1 << 20
_ARGUMENT = re.compile(r"\b(\w+)=('[^']*'|\"[^\"]*\"|[^\s,()]+)")
"""Pattern of an argument with its value, such as `eval=True`."""
_PATH = re.compile(r"path|dir|images|name", re.I)
"""Pattern of the names of arguments whose values are paths."""


def read_arguments(path: Path) -> str:
    """Returns the content of the file in which training software stores its arguments, such as `cfg_args`.

    Raises:
        DatasetError: If it cannot be read, or is too large.
    """
    return read_limited(path, _MAX_BYTES, DatasetError).decode("utf-8", "replace")


def load_background(model_dir: Path) -> Background:
    """Returns the background colour of the training: white if `cfg_args` sets `white_background`, else black.

    Raises:
        DatasetError: If `cfg_args` cannot be read.
    """
    path = model_dir / ARGUMENTS
    text = read_arguments(path) if path.is_file() else ""
    return WHITE if re.search(r"\bwhite_background=True\b", text) else BLACK


def load_antialiasing(model_dir: Path) -> bool:
    """True if `cfg_args` states that the training used antialiasing; logs a warning about unclear arguments.

    Raises:
        DatasetError: If `cfg_args` cannot be read.
    """
    path = model_dir / ARGUMENTS
    text = read_arguments(path) if path.is_file() else ""
    arguments = [
        f"{match[1][:80]}: {match[2][:80]}" for match in _ARGUMENT.finditer(text) if not _PATH.search(match[1])
    ]
    warn_of_unclear_antialiasing(path, arguments, "argument")
    return states_antialiasing(arguments)
