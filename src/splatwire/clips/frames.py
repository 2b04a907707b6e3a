"""Sequences of scene files: a folder with a file a frame."""

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError
from splatwire.files.kinds import STREAMS, file_kind
from splatwire.formats import format_of, read_rows
from splatwire.scene.rows import rows_of_splats
from splatwire.scene.splats import Splats

FAINTEST = 1 / 1024
"""A Gaussian that is less opaque is not there: no picture of eight bits shows it."""


def frame_files(folder: str | os.PathLike[str]) -> list[Path]:
    """Files of explicit Gaussians in a folder, sorted by name, numbers in names by their value.

    Args:
        folder: With a file (or a folder of an unbundled SOG) for each frame; what is no scene of explicit Gaussians is
            passed over.

    Raises:
        DatasetError: If there is no such folder, or none of its files is a frame.
    """
    source = Path(folder)
    if not source.is_dir():
        raise DatasetError(f"{source} is not a folder with a file for each frame")
    found = [path for path in sorted(source.iterdir(), key=by_number) if is_frame(path)]
    if not found:
        raise DatasetError(f"{source} has no file of explicit Gaussians (PLY, SPZ, SOG, .splat, .ksplat, .glb)")
    return found


def is_sequence(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a folder that holds frames and is no scene or stream itself."""
    source = Path(path)
    if not source.is_dir():
        return False
    kind = file_kind(source)
    if kind in STREAMS or format_of(kind) is not None:
        return False
    return any(is_frame(child) for child in source.iterdir())


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame as its file has it.

    Attributes:
        splats: All rows.
        drawn: Rows that draw something, bool (M).
    """

    splats: Splats
    drawn: np.ndarray

    @staticmethod
    def of(splats: Splats, where: object = "a frame") -> "Frame":
        """A frame of some Gaussians; what cannot be drawn is told."""
        rows = rows_of_splats(splats)
        rows.tell(where, "Gaussians")
        visible = rows.kept & (splats.opacities >= FAINTEST)
        return Frame(splats, visible.numpy())


def read_frames(files: list[Path]) -> Iterator[Frame]:
    """Reads frames one at a time.

    Raises:
        DatasetError: If a file is damaged, or its harmonics have another degree than those of the first.
    """
    degree: int | None = None
    for path in files:
        splats, _ = read_rows(path)
        if degree is None:
            degree = splats.degree
        if splats.degree != degree:
            raise DatasetError(
                f"{path} has harmonics of degree {splats.degree}, {files[0].name} of {degree}: frames share one"
            )
        yield Frame.of(splats, path)


def is_frame(path: Path) -> bool:
    """Whether a file holds explicit Gaussians."""
    return format_of(file_kind(path)) is not None


def by_number(path: Path) -> list[tuple[int, str]]:
    """What files are sorted by: their names, numbers in them by their value."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name)]
