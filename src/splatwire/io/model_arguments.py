"""Training arguments (`cfg_args`), which programs based on 3DGS write into their model folders."""

import re
from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.files.read_limited import read_limited
from splatwire.types.background import BLACK, WHITE, Background

ARGUMENTS = "cfg_args"
"""Name of the file."""
_MAX_BYTES = 1 << 20


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
