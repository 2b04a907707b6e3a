"""Sequences of scene files: a folder with a file a frame."""

import itertools
import logging
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatwire.errors import DatasetError, InvalidValueError
from splatwire.files.kinds import SPLATV, STREAMS, file_kind
from splatwire.formats import format_of, read_all_rows, read_splatv
from splatwire.formats.splatv import MovingSplats
from splatwire.model import SplatScene
from splatwire.packets.limits import MAX_FRAMES
from splatwire.scene.background import BLACK, Background
from splatwire.scene.origin import NO_ORIGIN, Origin
from splatwire.scene.rows import Rows, rows_of_splats
from splatwire.scene.splats import Splats

LOG = logging.getLogger(__name__)
SPLATV_FRAMES = 50
"""What SpacetimeGaussians is trained on."""
FAINTEST = 1 / 1024
"""A Gaussian that is less opaque is not there: no picture of eight bits shows it."""


@dataclass(frozen=True)
class Sequence:
    """Frames that are somewhere, read one at a time.

    Attributes:
        num_frames: How many.
        read: Reads them in order; see `read_frames`.
        order: Whether rows are the same Gaussians in every frame, see `splatwire.clips.tracking.Tracker`.
    """

    num_frames: int
    read: Callable[[], Iterator["Frame"]]
    order: str = "auto"


def open_sequence(path: str | os.PathLike[str], num_frames: int | None = None) -> Sequence:
    """Frames of a folder, or of a `.splatv` file.

    Args:
        path: A folder with a file for each frame, or the file.
        num_frames: Into how many the time of a `.splatv` is cut; None for `SPLATV_FRAMES`.

    Raises:
        DatasetError: If there is no such thing, it is damaged or has no frame.
        InvalidValueError: If a folder should have another number of frames than it has files, or there is none.
    """
    source = Path(path)
    if file_kind(source) != SPLATV:
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


def _frames_at(moving: MovingSplats, times: list[float]) -> Iterator["Frame"]:
    """Frames of Gaussians on paths; what cannot be drawn is told once."""
    told = False
    for time in times:
        splats = moving.at(time)
        rows = rows_of_splats(splats)
        if rows.num_invalid and not told:
            told = True
            rows.tell(f"{moving.path} at time {time:.3g}", "Gaussians")
        yield Frame.judged(splats, rows)


def frame_files(folder: str | os.PathLike[str]) -> list[Path]:
    """Files of explicit Gaussians in a folder, sorted by name, numbers in names by their value.

    Args:
        folder: With a file (or a folder of an unbundled SOG) for each frame; what is no scene of explicit Gaussians is
            passed over.

    Raises:
        DatasetError: If there is no such folder, none of its files is a frame, or one that should be is none.
    """
    source = Path(folder)
    if not source.is_dir():
        raise DatasetError(f"{source} is not a folder with a file for each frame")
    files = sorted(source.iterdir(), key=by_number)
    found = [path for path in files if is_frame(path)]
    if not found:
        raise DatasetError(f"{source} has no file of explicit Gaussians (PLY, SPZ, SOG, .splat, .ksplat, .glb)")
    endings = {path.suffix.lower() for path in found if path.is_file()}
    for path in files:
        if path.is_file() and path.suffix.lower() in endings and not is_frame(path):
            raise DatasetError(f"{path} is no frame, as other {path.suffix} files there are: {file_kind(path)}")
    _tell_gaps(source, [path.name for path in found])
    return found


def _tell_gaps(source: Path, names: list[str]) -> None:
    """Warns where names count frames and a number is missing: the clip goes on as if it had never been there."""
    counted = [re.split(r"(\d+)(?=\D*$)", name, maxsplit=1) for name in names]
    if len({(parts[0], parts[-1]) for parts in counted}) != 1 or any(len(parts) != 3 for parts in counted):
        return
    numbers = [int(parts[1]) for parts in counted]
    steps = [after - before for before, after in itertools.pairwise(numbers)]
    usual = min(steps, default=0)
    missing = [names[at] for at, step in enumerate(steps) if step > usual > 0]
    if missing:
        LOG.warning(
            "%s: frames are missing after %s%s: the clip goes on with the next", source, ", ".join(missing[:3]),
            " and others" if len(missing) > 3 else "",
        )  # fmt: skip


def is_sequence(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a `.splatv` file, or a folder that holds frames and is no scene or stream itself."""
    source, kind = Path(path), file_kind(Path(path))
    if kind == SPLATV:
        return True
    if not source.is_dir():
        return False
    if kind in STREAMS or format_of(kind) is not None:
        return False
    return any(is_frame(child) for child in source.iterdir())


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame as its file has it.

    Attributes:
        splats: All rows.
        drawn: Rows that draw something, bool (M).
        antialiased: Whether the file asks for antialiasing.
        origin: World coordinates that positions are relative to.
    """

    splats: Splats
    drawn: np.ndarray
    antialiased: bool = False
    origin: Origin = NO_ORIGIN

    @staticmethod
    def of(
        splats: Splats, where: object = "a frame", antialiased: bool = False, origin: Origin = NO_ORIGIN
    ) -> "Frame":  # fmt: skip
        """A frame of some Gaussians; what cannot be drawn is told."""
        rows = rows_of_splats(splats)
        rows.tell(where, "Gaussians")
        return Frame.judged(splats, rows, antialiased, origin)

    @staticmethod
    def judged(splats: Splats, rows: Rows, antialiased: bool = False, origin: Origin = NO_ORIGIN) -> "Frame":
        """A frame of some Gaussians of which it is known what can be drawn."""
        return Frame(splats, rows.kept & (splats.opacities >= FAINTEST), antialiased, origin)

    def relative_to(self, origin: Origin) -> "Frame":
        """Returns the same frame with positions relative to another origin."""
        return replace(self, splats=self.splats.moved_origin(self.origin, origin), origin=origin)

    def scene(self, background: Background = BLACK) -> SplatScene:
        """What is drawn of it."""
        return SplatScene(
            self.splats.select(self.drawn), background=background, antialiased=self.antialiased, origin=self.origin
        )


def read_frames(files: list[Path]) -> Iterator[Frame]:
    """Reads frames one at a time.

    Raises:
        DatasetError: If a file is damaged, or its harmonics have another degree than those of the first.
    """
    degree: int | None = None
    for path in files:
        content, _ = read_all_rows(path)
        splats = content.splats
        if degree is None:
            degree = splats.degree
        if splats.degree != degree:
            raise DatasetError(
                f"{path} has harmonics of degree {splats.degree}, {files[0].name} of {degree}: frames share one"
            )
        yield Frame.of(splats, path, content.antialiased, content.origin)


def is_frame(path: Path) -> bool:
    """Whether a file holds explicit Gaussians."""
    return format_of(file_kind(path)) is not None


def by_number(path: Path) -> list[tuple[int, str]]:
    """What files are sorted by: their names, numbers in them by their value."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]
