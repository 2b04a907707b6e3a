"""`.splat4d` files: sequences of `.splat` frames, coded with bounded errors by the program of the package splats4d.

A file begins with the bytes `SP4D`, a version (`u32`), the size of a JSON header (`u32`), and the header. Fields of the
header are `n` (number of Gaussians), `t` (number of frames) and `fps` (frames per second).
"""

import json
import logging
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatwire.errors import MALFORMED, BackendUnavailableError, DatasetError
from splatwire.files.atomic_write import atomic_output
from splatwire.files.read_limited import read_at_most
from splatwire.io.formats._columns import check_count
from splatwire.io.formats._sequence_range import PositionRange, position_step, warn_of_large_step
from splatwire.io.formats.content import FileContent, relative_to_first
from splatwire.io.formats.outliers import VISIBLE_DIVISOR, warn_of_clipped
from splatwire.io.formats.splat import read_splat, write_records

LOG = logging.getLogger(__name__)
MAGIC = b"SP4D"
MAX_FRAMES = 20_000
"""Maximum number of frames that are read."""
_MAX_HEADER_BYTES = 16 << 20
_PROGRAM = "splat4d"
_MAX_STEP = 0.004
"""Maximum step of positions in scenes that are not large, world units; twice the program's default error."""
_STEP_SHARE = 2 / VISIBLE_DIVISOR
"""Step of positions, twice their largest error, divided by the median size of the Gaussians, in small scenes."""


@dataclass(frozen=True)
class Splat4dFrames:
    """Frames of a `.splat4d` file.

    Attributes:
        path: The file.
        num_frames: Number of frames.
        rate: Frames per second.
    """

    path: Path
    num_frames: int
    rate: float

    def read(self) -> Iterator[FileContent]:
        """Decodes and yields one frame after the other."""
        with tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
            for number in range(self.num_frames):
                frame = Path(folder) / "frame.splat"
                _run(self.path, "decode", str(self.path), "--frame", str(number), "--output", str(frame))
                yield FileContent(read_splat(frame))


def splat4d_frames(path: Path) -> Splat4dFrames:
    """Opens a `.splat4d` file.

    Raises:
        DatasetError: If its header is damaged, or announces too many Gaussians or frames.
    """
    head = read_at_most(path, _MAX_HEADER_BYTES, DatasetError)
    try:
        (size,) = struct.unpack_from("<I", head, 8)
        header = json.loads(head[12 : 12 + size])
        count, frames, rate = int(header["n"]), int(header["t"]), float(header["fps"])
    except (struct.error, *MALFORMED) as error:
        raise DatasetError(f"{path}: its header is damaged") from error
    check_count(path, count, path.stat().st_size)
    if not 0 < frames <= MAX_FRAMES or not 0.01 <= rate <= 1000:
        raise DatasetError(f"{path}: {frames:,} frames at {rate:g} per second are out of range")
    return Splat4dFrames(path, frames, rate)


def write_splat4d(frames: Iterable[FileContent], path: Path, rate: float) -> int:
    """Writes a sequence to a `.splat4d` file with the command-line program of the package splats4d.

    The format has one colour for all directions.

    Args:
        frames: Frames with the same number of Gaussians; row i is the same Gaussian in all frames.
        path: The file, written atomically.
        rate: Frames per second.

    Returns:
        Number of frames.

    Raises:
        BackendUnavailableError: If the program is not installed.
        DatasetError: If there is no frame, the numbers of Gaussians differ, or the program fails.
    """
    count, first, step, brightest = 0, -1, _MAX_STEP, np.zeros(1)
    with tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
        for count, frame in enumerate(relative_to_first(frames), 1):
            splats = frame.splats
            if count == 1:
                first = splats.num_gaussians
                step = position_step(splats, _STEP_SHARE, _MAX_STEP) if first else _MAX_STEP
                positions = PositionRange(path, splats, step)
                if first:
                    warn_of_large_step(path, splats, _STEP_SHARE, step)
                if splats.degree:
                    LOG.warning("%s: such files have one colour for all directions; harmonics are left out", path)
            if splats.num_gaussians != first:
                raise DatasetError(
                    f"{path}: frame {count - 1} has {splats.num_gaussians:,} Gaussians, the first one {first:,}: such "
                    "files have the same Gaussians in all frames"
                )
            shown = positions.limited(splats.at_most_degree(0))
            _, _, colours = write_records([shown], Path(folder) / f"frame_{count - 1:06}.splat")
            brightest = np.maximum(brightest, colours)
        if not count:
            raise DatasetError(f"{path}: a sequence without frames cannot be written")
        warn_of_clipped(path, "base colours", brightest, 0.0, 1.0)
        with atomic_output(path) as target:
            numbers = ("--pos-mm", f"{1000 * step / 2:g}", "--fps", f"{rate:g}")
            _run(path, "encode", "--input", folder, "--output", str(target), *numbers)
    return count


def _run(path: Path, *words: str) -> None:
    """Runs the command-line program of the package splats4d, which reads and writes `.splat4d` files.

    Args:
        path: The file, for messages.
        *words: Command-line arguments.

    Raises:
        BackendUnavailableError: If the program is not installed.
        DatasetError: If the program fails.
    """
    beside = Path(sys.executable).with_name(_PROGRAM)
    program = str(beside) if beside.exists() else shutil.which(_PROGRAM)
    if program is None:
        raise BackendUnavailableError(_PROGRAM, "pip install 'splatwire[clips]'")
    done = subprocess.run(
        [program, *words], capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
        env=os.environ | {"RUST_BACKTRACE": "0"},
    )  # fmt: skip
    if done.returncode:
        problem = " ".join(done.stderr.rpartition("Error: ")[2].split())  # the program also reports what it did before
        raise DatasetError(f"{path}: {_PROGRAM}: {problem[:300] or done.returncode}")
