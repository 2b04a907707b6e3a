"""Training arguments in the folders of models: `cfg_args` of programs based on 3DGS, and files of gsplat and others."""

import os
import re
from pathlib import Path

from splatwire.errors import DatasetError
from splatwire.files.read_limited import read_limited
from splatwire.io.formats.ply_comments import states_antialiasing, warn_of_unclear_antialiasing
from splatwire.types.background import BLACK, WHITE, Background

ARGUMENTS = "cfg_args"
"""Name of the file of 3DGS."""
_TRAINED_PLY = re.compile(r"iteration_\d+/point_cloud\.ply")
"""Pattern of the end of the path of a PLY that 3DGS has trained."""
_MODEL_DEPTH = 3
"""Number of folders from a trained PLY up to its model folder: `iteration_N`, `point_cloud`, the model."""
_MAX_BYTES = 1 << 20
_ARGUMENT = re.compile(r"\b(\w+)=('[^']*'|\"[^\"]*\"|[^\s,()]+)")
"""Pattern of an argument with its value, such as `eval=True`."""
_OTHERS = (
    (re.compile(r"ply/point_cloud_\d+\.ply"), 2, "cfg.yml", re.compile(r"^(\w+): *(\S.*)$", re.MULTILINE)),
    (
        re.compile(r".*/splat_\d+\.ply"), 1, "training_config.json",
        re.compile(r'^ *"(\w+)": *([^\s{\[].*?),?$', re.MULTILINE),
    ),
)  # fmt: skip
"""Training arguments of gsplat and of LichtFeld Studio: pattern of the end of a PLY's path, number of folders up to the
file of the arguments, its name, and the pattern of an argument in it, such as `antialiased: true`."""
_PATH = re.compile(r"path|dir|images|name", re.I)
"""Pattern of the names of arguments whose values are paths."""


def read_arguments(path: Path) -> str:
    """Returns the content of the file in which training software stores its arguments, such as `cfg_args`.

    Raises:
        DatasetError: If it cannot be read, or is too large.
    """
    return read_limited(path, _MAX_BYTES, DatasetError).decode("utf-8", "replace")


def model_folder_of(ply: Path) -> Path | None:
    """Returns the model folder of a PLY that 3DGS has trained, by the names `iteration_N/point_cloud.ply`.

    The result is None for any other file.
    """
    absolute = Path(os.path.abspath(ply))
    is_trained = _TRAINED_PLY.fullmatch("/".join(absolute.parts[-2:])) and len(absolute.parents) >= _MODEL_DEPTH
    return absolute.parents[_MODEL_DEPTH - 1] if is_trained else None


def load_background(model_dir: Path) -> Background:
    """Returns the background colour of the training: white if `cfg_args` sets `white_background`, else black.

    Raises:
        DatasetError: If `cfg_args` cannot be read.
    """
    path = model_dir / ARGUMENTS
    text = read_arguments(path) if path.is_file() else ""
    return WHITE if re.search(r"\bwhite_background=True\b", text) else BLACK


def load_antialiasing(ply: Path) -> bool:
    """True if the training arguments near a trained PLY state antialiasing; logs a warning about unclear arguments.

    Args:
        ply: The PLY. Its place shows the model folder: `iteration_N/point_cloud.ply` of 3DGS,
            `ply/point_cloud_N.ply` of gsplat, or `splat_N.ply` of LichtFeld Studio. For any other place the result is
            False.

    Raises:
        DatasetError: If the arguments cannot be read.
    """
    path, pattern = _arguments_of(ply)
    text = read_arguments(path) if path is not None and path.is_file() else ""
    arguments = [f"{match[1][:80]}: {match[2][:80]}" for match in pattern.finditer(text) if not _PATH.search(match[1])]
    if path is not None:
        warn_of_unclear_antialiasing(path, arguments, "argument")
    return states_antialiasing(arguments)


def _arguments_of(ply: Path) -> tuple[Path | None, re.Pattern[str]]:
    """Returns the path of the training arguments of a trained PLY, and the pattern of an argument in this file.

    The path is None for any other PLY.
    """
    if (folder := model_folder_of(ply)) is not None:
        return folder / ARGUMENTS, _ARGUMENT
    absolute = Path(os.path.abspath(ply))
    for place, depth, name, argument in _OTHERS:
        if place.fullmatch("/".join(absolute.parts[-2:])):
            return absolute.parents[depth - 1] / name, argument
    return None, _ARGUMENT
