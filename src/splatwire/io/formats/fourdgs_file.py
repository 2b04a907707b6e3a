"""`.4dgs` files: Gaussians, each with the time interval in which it exists; read and written by the package fourdgs.

The format has no frames. When a sequence is written, each change of a Gaussian's values starts a new Gaussian; the
format's parameters for motion and fading are not used. When a file is read, the Gaussians are evaluated at the middle
of each frame.
"""

import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import fourdgs
import numpy as np
from fourdgs.opcode import CHUNK
from fourdgs.records import parse_chunk
from fourdgs.serialization import MAGIC, check_magic, iter_records

from splatwire.errors import MALFORMED, DatasetError
from splatwire.files.atomic_write import atomic_output
from splatwire.io.formats._axes import SPZ_FLIPS, flip_axes
from splatwire.io.formats._columns import build_splats, check_count, concatenate
from splatwire.io.formats._sequence_range import PositionRange
from splatwire.io.formats.content import FileContent, relative_to_first
from splatwire.io.formats.outliers import warn_of_clipped
from splatwire.ops.spherical_harmonics import DC, num_functions
from splatwire.types.metadata import SceneMetadata
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
RATE = 30.0
"""Frames per second at which a file of another program is read."""
MAX_FRAMES = 20_000
"""Maximum number of frames that are read."""
_FPS, _AXES, _Y_UP, _Z_UP = "splatwire:fps", "coordinate_system", "y-up-right-handed", "z-up-right-handed"
_COLORS, _SRGB = "color_space", "srgb-rec709-display"
_LOWEST, _HIGHEST = -4.0, 4.0
"""Coefficients of harmonics for the bytes 0 and 255."""
_ROWS = "Gaussians and their states"
"""Rows of such a file, for messages: a Gaussian has one row for each interval in which it does not change."""
_STEP = 0.1
"""Step of positions divided by the median of all standard deviations, with the default error bounds of fourdgs."""


@dataclass(frozen=True)
class FourdgsFrames:
    """Frames of a `.4dgs` file.

    Attributes:
        path: The file.
        num_frames: Number of frames.
        rate: Frames per second.
        scene: The file as the package fourdgs reads it.
    """

    path: Path
    num_frames: int
    rate: float
    scene: Any

    def read(self) -> Iterator[FileContent]:
        """Yields the Gaussians of each frame at the middle of the frame's duration.

        A frame may be empty.
        """
        axes = self.scene.header.attributes.get(_AXES, "")
        metadata = SceneMetadata(up="z") if axes == _Z_UP else SceneMetadata()
        for number in range(self.num_frames):
            try:
                splats = _splats_at(self.path, self.scene, (number + 0.5) / self.rate)
            except MALFORMED as error:
                raise DatasetError(f"{self.path}: frame {number}: {error}") from error
            yield FileContent(flip_axes(splats, SPZ_FLIPS) if axes == _Y_UP else splats, metadata=metadata)


def fourdgs_frames(path: Path) -> FourdgsFrames:
    """Opens a `.4dgs` file.

    Files of other programs have no frame rate and are read with 30 frames per second.

    Raises:
        DatasetError: If the package fourdgs cannot read the file, or the file has too many Gaussians or frames.
    """
    try:
        if count := _declared_gaussians(path):
            check_count(path, count, path.stat().st_size)
        scene = fourdgs.read(str(path), recover_truncated=False)
    except (fourdgs.FourdgsError, OSError, *MALFORMED) as error:
        raise DatasetError(f"{path}: {error}") from error
    check_count(path, scene.gaussians.count, path.stat().st_size)
    try:
        rate = float(scene.header.attributes.get(_FPS, RATE))
    except ValueError:
        rate = RATE
    rate = rate if 0.01 <= rate <= 1000 else RATE
    count = max(round(scene.duration_sec * rate), 1) if math.isfinite(scene.duration_sec) else 0
    if not 0 < count <= MAX_FRAMES:
        raise DatasetError(
            f"{path}: {scene.duration_sec:g} s are not 1 to {MAX_FRAMES:,} frames at {rate:g} per second"
        )
    _warn_of_unapplied_settings(path, scene)
    return FourdgsFrames(path, count, rate, scene)


def _warn_of_unapplied_settings(path: Path, scene: Any) -> None:
    """Logs a warning if a `.4dgs` file declares axes, colours or coordinates that the reader does not apply.

    Args:
        path: The file, for messages.
        scene: The file as the package fourdgs reads it.
    """
    stated = scene.header.attributes
    if stated.get(_AXES, "") not in ("", _Y_UP, _Z_UP):
        LOG.warning("%s: %s %.60r is not known: positions are read as they are", path, _AXES, stated[_AXES])
    if stated.get(_COLORS, _SRGB) not in ("", _SRGB):
        LOG.warning("%s: %s %.60r is read as %s: colours may look too dark", path, _COLORS, stated[_COLORS], _SRGB)
    if scene.provenance.frames or scene.provenance.anchors:
        LOG.warning("%s: its coordinate frames and geodetic anchors are left out: axes may be others", path)


def _declared_gaussians(path: Path) -> int:
    """Returns the number of Gaussians in a file according to its headers."""
    data = path.read_bytes()
    check_magic(data)
    records = iter_records(data, len(MAGIC))
    return sum(parse_chunk(record.content)[0].count for record in records if record.opcode == CHUNK)


def write_fourdgs(frames: Iterable[FileContent], path: Path, rate: float) -> int:
    """Writes a sequence to a `.4dgs` file, with the default error bounds of fourdgs; returns the number of frames.

    Args:
        frames: Frames of one degree of harmonics.
        path: The file, written atomically.
        rate: Frames per second.

    Raises:
        DatasetError: If no frame has Gaussians, or the package fourdgs cannot store the values.
    """
    runs = _ConstantIntervals(rate)
    for frame in relative_to_first(frames):
        runs.add(flip_axes(frame.splats, SPZ_FLIPS))
    splats, begins, ends = runs.end_all()
    count = runs.num_frames
    if not splats.num_gaussians:
        raise DatasetError(f"{path}: a sequence without Gaussians cannot be written")
    size = float(np.median(splats.scales))
    # Shrinking Gaussians below the median would make the step of fourdgs smaller.
    splats = PositionRange(path, splats, _STEP * size, ends - begins).limited(splats, min_scale=size)
    colours = 0.5 + DC * splats.sh[:, 0]
    warn_of_clipped(path, "base colours", colours, 0.0, 1.0, _ROWS)
    warn_of_clipped(path, "harmonics", splats.sh[:, 1:], _LOWEST, _HIGHEST, _ROWS)
    harmonics = (splats.sh[:, 1:] - _LOWEST) / (_HIGHEST - _LOWEST) * 255
    records = fourdgs.GaussianSet(
        positions=splats.means,
        scales=splats.scales,
        rotations=np.roll(splats.quats, -1, axis=1),
        colors=np.concatenate([np.clip(colours, 0.0, 1.0), splats.opacities[:, None]], axis=1),
        motions=np.zeros_like(splats.means),
        mu_t=((begins + ends) / 2).astype(np.float32),
        sigma_t=np.full(len(begins), np.inf, np.float32),
        win_lo=begins,
        win_hi=ends,
        sh=np.rint(harmonics.clip(0, 255)).astype(np.uint8).transpose(0, 2, 1).reshape(len(begins), -1)
        if splats.degree
        else None,
        sh_degree=splats.degree,
    )
    attributes = {_AXES: _Y_UP, _COLORS: _SRGB, _FPS: f"{rate:g}"}
    with atomic_output(path) as target:
        options = fourdgs.WriteOptions(metadata=attributes)
        try:
            with np.errstate(all="ignore"):  # fourdgs verifies what it wrote
                fourdgs.write(str(target), records, count / rate, options=options)
        except (fourdgs.FourdgsError, *MALFORMED) as error:
            raise DatasetError(f"{path}: fourdgs cannot store the values of these Gaussians: {error}") from error
    return count


class _ConstantIntervals:
    """Converts the frames of a sequence to Gaussians with time intervals, for a `.4dgs` file.

    A Gaussian is constant during its interval. In consecutive frames with the same number of Gaussians, row i is the
    same Gaussian. The interval of a Gaussian ends when one of its values changes, or when the number of Gaussians
    changes.

    Attributes:
        num_frames: Number of frames so far.
    """

    def __init__(self, rate: float) -> None:
        self._rate, self.num_frames = rate, 0
        self._open: Splats | None = None
        self._begins = np.zeros(0, np.int64)
        self._done: list[tuple[Splats, np.ndarray, np.ndarray]] = []

    def add(self, splats: Splats) -> None:
        """Adds the Gaussians of the next frame of the sequence."""
        before = self._open
        if before is None or before.num_gaussians != splats.num_gaussians:
            self._end_intervals(np.ones(0 if before is None else before.num_gaussians, bool))
            self._begins = np.full(splats.num_gaussians, self.num_frames)
        else:
            changed = np.zeros(splats.num_gaussians, bool)
            for column in fields(splats):
                rows = (getattr(before, column.name) != getattr(splats, column.name)).reshape(len(changed), -1)
                changed |= rows.any(axis=1)
            self._end_intervals(changed)
            self._begins[changed] = self.num_frames
        self._open, self.num_frames = splats, self.num_frames + 1

    def end_all(self) -> tuple[Splats, np.ndarray, np.ndarray]:
        """Ends the intervals that are still open, and returns all intervals; called after the last frame.

        An interval is a time during which one Gaussian of the sequence does not change.

        Returns:
            Three items with an entry for each of the N intervals: the Gaussian, the start of the interval, float64 (N),
            and the end of the interval, float64 (N). Times are seconds from the first frame.
        """
        if self._open is not None:
            self._end_intervals(np.ones(self._open.num_gaussians, bool))
        if not self._done:
            return Splats.empty(0, 0), np.zeros(0), np.zeros(0)
        parts, begins, ends = zip(*self._done, strict=True)
        return concatenate(parts), np.concatenate(begins) / self._rate, np.concatenate(ends) / self._rate

    def _end_intervals(self, rows: np.ndarray) -> None:
        if self._open is not None and rows.any():
            begins = self._begins[rows]
            self._done.append((self._open.select(rows), begins, np.full(len(begins), self.num_frames)))


def _splats_at(path: Path, scene: Any, time: float) -> Splats:
    """Evaluates the moving Gaussians of a file at a time; returns the visible ones, in the axes of the file.

    Args:
        path: The file, for messages.
        scene: The file as the package fourdgs reads it.
        time: The time, seconds.
    """
    state, records = scene.state_at(time), scene.gaussians
    rows = state["indices"]
    degree = records.sh_degree if records.sh is not None else 0
    sh = np.zeros((len(rows), num_functions(degree), 3), np.float32)
    sh[:, 0] = (records.colors[rows, :3] - 0.5) / DC
    if degree:
        stored = records.sh[rows].reshape(len(rows), 3, -1)[:, :, : sh.shape[1] - 1]
        sh[:, 1:] = stored.transpose(0, 2, 1) / 255 * (_HIGHEST - _LOWEST) + _LOWEST
    return build_splats(
        path,
        means=state["centers"],
        quats=np.roll(state["orientations"], 1, axis=1),
        scales=records.scales[rows],
        opacities=state["opacity"],
        sh=sh,
    )
