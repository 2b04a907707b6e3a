"""Sequences of scene files: folders with one file per frame, and `.splatv` files."""

import itertools
import logging
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.arguments import checked
from splatwire.bitstream.limits import MAX_FRAMES
from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.atomic_write import is_unfinished
from splatwire.files.kinds import (
    FOURDGS,
    SEQUENCE_FILES,
    SPLAT4D,
    SPLATV,
    STREAMS,
    USD,
    Kind,
    file_kind,
    format_error,
    opened,
)
from splatwire.files.names import path_of
from splatwire.io.formats import format_of, read_rows_with_origin, read_splatv
from splatwire.io.formats.content import FileContent, coarse_positions
from splatwire.io.formats.splatv import MovingSplats
from splatwire.reprs import summary_repr
from splatwire.types import SplatScene
from splatwire.types.background import BLACK, Background
from splatwire.types.origin import Origin
from splatwire.types.splats import Splats
from splatwire.types.validity import ElementValidity, validity_of_splats

LOG = logging.getLogger(__name__)
SPLATV_FRAMES = 50
"""Default number of frames of a `.splatv` file, as in the training of SpacetimeGaussians."""
_SEQUENCE_READERS = {
    USD: ("usd", "usd_frames"),
    FOURDGS: ("fourdgs_file", "fourdgs_frames"),
    SPLAT4D: ("splat4d_file", "splat4d_frames"),
}
"""Module in `splatwire.io.formats` and function that opens a file with all frames of a sequence, by kind of file."""
MIN_VISIBLE_OPACITY = 1 / 1024
"""Opacity below which a Gaussian is invisible in pictures of eight bits."""


@dataclass(frozen=True)
class Sequence:
    """Frames of a sequence, which are read one at a time.

    Attributes:
        num_frames: Number of frames.
        read: Reads the frames in order.
        order: `tracked` if the i-th Gaussian is the same in all frames, `shuffled` if not, `auto` if unknown.
        rate: Frames per second; None if the files have no rate.
    """

    num_frames: int
    read: Callable[[], Iterator["Frame"]]
    order: str = "auto"
    rate: float | None = None


@checked
def open_sequence(path: str | os.PathLike[str], num_frames: int | None = None) -> Sequence:
    """Opens the frames of a folder, or of a file with all frames.

    Args:
        path: Folder with one file per frame, a `.splatv`, `.4dgs` or `.splat4d` file, or an OpenUSD scene with time
            samples.
        num_frames: Number of frames to sample from a `.splatv` file; None for a default.

    Raises:
        DatasetError: If the folder or file does not exist, is damaged or contains no frame.
        InvalidValueError: If `num_frames` is given for a folder or is out of range.
    """
    with opened(path_of(path)) as source:
        kind = file_kind(source)
        if kind in _SEQUENCE_READERS:
            return _open_sequence_file(source, kind, num_frames)
        if kind != SPLATV:
            files = frame_files(source)
            if num_frames is not None:
                raise InvalidValueError(f"{source} has {len(files)} frames, a file each: a number is for .splatv files")
            return Sequence(len(files), lambda: read_frames(files))
        count = SPLATV_FRAMES if num_frames is None else num_frames
        if not 0 < count <= MAX_FRAMES:
            raise InvalidValueError(f"a clip has 1 to {MAX_FRAMES:,} frames, not {count}")
        moving = read_splatv(source)
    times = [number / max(count - 1, 1) for number in range(count)]
    return Sequence(count, lambda: _frames_at(moving, times), "tracked")


def _sequence_file(path: Path, kind: Kind) -> Any:
    """Opens a single file with all frames of a sequence; None for a static scene.

    Returns:
        Object with `num_frames`, `rate` and `read`.
    """
    module, name = _SEQUENCE_READERS[kind]
    return getattr(import_module(f"splatwire.io.formats.{module}"), name)(path)


def _open_sequence_file(path: Path, kind: Kind, num_frames: int | None) -> Sequence:
    """Opens a single file with all frames of a sequence, such as `.4dgs`.

    Args:
        path: The file.
        kind: Detected file type.
        num_frames: Must be None, because the file determines the number of frames.

    Raises:
        DatasetError: If the file is damaged, or an OpenUSD scene has no time samples.
        InvalidValueError: If the caller requests a number of frames.
    """
    if num_frames is not None:
        raise InvalidValueError(f"{path} has its own frames: a number is for .splatv files")
    sequence_file = _sequence_file(path, kind)
    if sequence_file is None:
        raise DatasetError(f"{path}: has no time samples, so it is a still scene")
    contents = sequence_file.read

    def read() -> Iterator[Frame]:
        for number, content in enumerate(contents()):
            yield Frame.of(
                content.splats, f"{path} frame {number}", antialiased=content.antialiased, origin=content.origin,
                metadata=content.metadata,
            )  # fmt: skip

    return Sequence(sequence_file.num_frames, read, "auto", sequence_file.rate)


def _frames_at(moving: MovingSplats, times: list[float]) -> Iterator["Frame"]:
    """Yields the frames of moving Gaussians (functions of time) at the given times."""
    logged = False
    for time in times:
        splats = moving.at(time)
        validity = validity_of_splats(splats)
        if validity.num_invalid and not logged:
            logged = True
            validity.log_removed(f"{moving.path} at time {time:.3g}", "Gaussians")
        yield Frame.from_checked(splats, validity)


@checked
def frame_files(folder: str | os.PathLike[str]) -> list[Path]:
    """Returns the files of Gaussians in a folder, sorted by name; numbers in names are compared by value.

    Args:
        folder: Folder with one file per frame, or one folder per frame for unbundled SOG.

    Raises:
        DatasetError: If the folder does not exist, contains no frame, or a file with a frame's suffix is not a frame.
    """
    source = Path(folder)
    if not source.is_dir():
        raise DatasetError(f"{source} is not a folder with a file for each frame")
    if is_unfinished(source):
        raise DatasetError(format_error(source, "a folder of frames"))
    files = sorted(source.iterdir(), key=by_number)
    frame_paths = [path for path in files if is_frame(path)]
    if not frame_paths:
        raise DatasetError(f"{source} has no file of explicit Gaussians (PLY, SPZ, SOG, .splat, .ksplat, .glb)")
    endings = {path.suffix.lower() for path in frame_paths if path.is_file()}
    for path in files:
        if path.is_file() and path.suffix.lower() in endings and not is_frame(path):
            raise DatasetError(format_error(path, f"a frame, as other {path.suffix} files there are"))
    _warn_of_gaps(source, [path.name for path in frame_paths])
    _warn_of_decimals(source, [path.name for path in frame_paths])
    return frame_paths


def _warn_of_gaps(source: Path, names: list[str]) -> None:
    """Logs a warning if file names are numbered and a number is missing."""
    name_parts = [re.split(r"(\d+)(?=\D*$)", name, maxsplit=1) for name in names]
    if len({(parts[0], parts[-1]) for parts in name_parts}) != 1 or any(len(parts) != 3 for parts in name_parts):
        return
    numbers = [int(parts[1]) for parts in name_parts]
    steps = [after - before for before, after in itertools.pairwise(numbers)]
    usual_step = min(steps, default=0)
    missing = [names[index] for index, step in enumerate(steps) if step > usual_step > 0]
    if missing:
        LOG.warning(
            "%s: frames are missing after %s%s: the clip continues with the next frame", source, ", ".join(missing[:3]),
            " and others" if len(missing) > 3 else "",
        )  # fmt: skip


def _warn_of_decimals(source: Path, names: list[str]) -> None:
    """Logs a warning if file names have decimal numbers, such as times, and the frames are in another order."""
    matches = [re.fullmatch(r"\D*(\d+\.\d+)\D*", name) for name in names]
    for before, after in itertools.pairwise(matches):
        if before is None or after is None:
            return
        if float(before[1]) > float(after[1]):
            LOG.warning(
                "%s: frame %s is after %s, because numbers after a point are compared as whole numbers: if they are "
                "decimals, give all of them the same number of digits", source, after[0], before[0],
            )  # fmt: skip
            return


@checked
def is_sequence(path: str | os.PathLike[str]) -> bool:
    """True for a file with all frames of a sequence, or a folder with one file per frame."""
    source = path_of(path)
    kind = file_kind(source)
    if kind in SEQUENCE_FILES:
        return True
    if kind == USD:
        return _sequence_file(source, kind) is not None
    if not source.is_dir():
        return False
    if kind in STREAMS or format_of(kind) is not None:
        return False
    return any(is_frame(child) for child in source.iterdir())


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame(FileContent):
    """One frame of a sequence, as read from its file.

    Attributes:
        drawn: Mask of visible Gaussians, bool (M).
    """

    drawn: np.ndarray

    __repr__ = summary_repr

    @staticmethod
    def of(splats: Splats, source: object = "a frame", **properties: Any) -> "Frame":
        """Creates a frame from Gaussians; checks their values.

        Args:
            splats: The Gaussians.
            source: Name of their source in log messages.
            **properties: Other attributes of the frame: `origin`, `antialiased`, `metadata`.
        """
        validity = validity_of_splats(splats)
        validity.log_removed(source, "Gaussians")
        return Frame.from_checked(splats, validity, **properties)

    @staticmethod
    def from_checked(splats: Splats, validity: ElementValidity, **properties: Any) -> "Frame":
        """Creates a frame from Gaussians whose values were already checked.

        Args:
            splats: The Gaussians.
            validity: Result of the check of the values, with the mask of valid Gaussians.
            **properties: Other attributes of the frame: `origin`, `antialiased`, `metadata`.
        """
        return Frame(splats, drawn=validity.kept & (splats.opacities >= MIN_VISIBLE_OPACITY), **properties)

    @property
    def is_visible(self) -> bool:
        """True if at least one Gaussian is visible."""
        return bool(self.drawn.any())

    def fits_origin(self, origin: Origin) -> bool:
        """True if the positions of the visible Gaussians relative to an origin are precise in float32.

        The result is True for the origin of the frame, and for a frame without visible Gaussians.
        """
        if origin == self.origin or not self.is_visible:
            return True
        return coarse_positions(self.relative_to(origin).splats.select(self.drawn)) is None

    def scene(self, background: Background = BLACK) -> SplatScene:
        """Returns the visible Gaussians as a scene."""
        return SplatScene(
            self.splats.select(self.drawn),
            background=background,
            antialiased=self.antialiased,
            origin=self.origin,
            metadata=self.metadata,
        )


@checked
def read_frames(files: list[Path]) -> Iterator[Frame]:
    """Reads and yields the frames of a sequence, one file at a time.

    Raises:
        DatasetError: If a file is damaged, or its degree of harmonics differs from that of the first frame.
    """
    degree: int | None = None
    for path in files:
        content, _ = read_rows_with_origin(path)
        splats = content.splats
        if degree is None:
            degree = splats.degree
        if splats.degree != degree:
            raise DatasetError(
                f"{path} has harmonics of degree {splats.degree}, {files[0].name} of {degree}: frames share one"
            )
        yield Frame.of(splats, path, antialiased=content.antialiased, origin=content.origin, metadata=content.metadata)


def is_frame(path: Path) -> bool:
    """True if a file contains explicit Gaussians (such as PLY, SPZ or SOG), so that it can be a frame of a sequence."""
    return format_of(file_kind(path)) is not None


def by_number(path: Path) -> list[tuple[int, str]]:
    """Returns a key for sorting paths by file name with numbers compared by value, so that 2 precedes 10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]
