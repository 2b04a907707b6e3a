"""Writes the frames of a sequence to files."""

import logging
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.sequence.side_info import open_side_info
from splatwire.concealment.temporal.concealers import DEFAULT, temporal_concealer
from splatwire.errors import InvalidValueError
from splatwire.io.formats import format_for, write_splats
from splatwire.io.formats.content import relative_to_first
from splatwire.io.formats.dispatch import has_world_coordinates, warn_of_background
from splatwire.io.formats.outliers import Outliers
from splatwire.ops.spherical_harmonics import num_functions
from splatwire.sequence.decoding import SequenceFrame, decode_frame, decode_frames
from splatwire.sequence.frames import Sequence
from splatwire.sequence.live_decoder import LiveDecoder, frames_of_events
from splatwire.sequence.waiting_events import WaitingEvents
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
Report = Callable[[str, float], None]
MAX_FILES = 20_000
"""Default limit of the number of frame files written: eleven minutes at 30 frames per second."""
_PLACEHOLDER_SCALE = 1e-3
"""Standard deviation of the transparent Gaussian in the file of an empty frame, world units."""
LIVE_DIGITS = 6
"""Number of digits of the frame number in file names of a live sequence, whose number of frames is unknown."""


def check_num_frames(stream: SceneStream, max_frames: int | None, advice: str) -> None:
    """Checks that the number of frames does not exceed a limit, before one file per frame is written.

    Args:
        stream: The sequence.
        max_frames: Maximum number of files; None for `MAX_FILES`.
        advice: Advice for the error message.

    Raises:
        InvalidValueError: If the sequence has more frames than allowed.
    """
    count = open_side_info(stream.manifest, stream.side_info).timeline.num_frames
    if count > (MAX_FILES if max_frames is None else max_frames):
        raise InvalidValueError(
            f"the clip of {stream.num_bytes:,} bytes has {count:,} frames, and no more than "
            f"{MAX_FILES if max_frames is None else max_frames:,} files are written: {advice}"
        )


def write_frames(
    stream: SceneStream, folder: Path, suffix: str, concealer: str, frame_number: int | None, report: Report,
    outliers: Outliers = "clamp",
) -> dict[str, Any]:  # fmt: skip
    """Decodes a sequence and writes one file per frame, or a single frame.

    Returns the numbers of frames, tracks, lost tracks and concealed Gaussians by name, such as `num_frames`. A track is
    one Gaussian over time.

    Args:
        stream: The sequence; packets may be missing.
        folder: Output folder, or path of the output file for a single frame.
        suffix: File name suffix of the format, such as `.ply`.
        concealer: Name of the concealer for tracks with lost motion.
        frame_number: Number of the only frame to write; None for all.
        report: Called with the name of the current task and its completed fraction, 0 to 1.
        outliers: Treatment of values that the format cannot represent, see `write_splats`.

    Raises:
        InvalidValueError: If the sequence has no such frame.
        UnknownNameError: If there is no such concealer or format.
    """
    method = temporal_concealer(concealer)
    format_for(f"x{suffix}")
    if frame_number is not None:
        open_side_info(stream.manifest, stream.side_info).timeline.group_of(frame_number)  # refuses other frames
    sequence = decode_stream(stream, progress=lambda share: report("decoding packets", share)).scene
    count = sequence.timeline.num_frames
    warn_of_background(folder, sequence.background)
    shown = (
        [decode_frame(sequence, frame_number, method)] if frame_number is not None else decode_frames(sequence, method)
    )
    width, written, concealed = len(str(count - 1)), 0, 0
    for frame in shown:
        name = folder / f"frame_{frame.number:0{width}}{suffix}" if folder.is_dir() else folder
        write_splats(
            [_never_empty(frame.scene.drawn(), name)],
            name,
            antialiased=sequence.antialiased,
            origin=sequence.origin,
            outliers=outliers,
            metadata=sequence.metadata,
        )
        written, concealed = written + 1, concealed + int(frame.concealed.sum())
        report("writing frames", written / (1 if frame_number is not None else count))
    lost = int((~sequence.tracks.received).sum())
    return {"num_frames": written, "num_tracks": sequence.num_gaussians, "num_lost": lost, "num_concealed": concealed}


def write_frame_files(sequence: Sequence, folder: Path, suffix: str, report: Report) -> int:
    """Writes one file of explicit Gaussians per frame of a sequence, and returns the number of files.

    If a format has no world coordinates, all files have the origin of the first visible frame: other programs do not
    read origins, and would draw frames with different ones at different places.

    Args:
        sequence: The frames.
        folder: Output folder.
        suffix: File name suffix of the format, such as `.ply`.
        report: Called with the name of the current task and its completed fraction, 0 to 1.
    """
    width, written = len(str(sequence.num_frames - 1)), 0
    frames = sequence.read() if has_world_coordinates(format_for(f"x{suffix}")) else relative_to_first(sequence.read())
    for frame in frames:
        name = folder / f"frame_{written:0{width}}{suffix}"
        write_splats(
            [_never_empty(frame.splats.select(frame.drawn), name)],
            name,
            antialiased=frame.antialiased,
            origin=frame.origin,
            metadata=frame.metadata,
        )
        written += 1
        report("writing frames", written / sequence.num_frames)
    return written


def write_live_frames(
    waiting: WaitingEvents, folder: Path, concealer: str | None, on_frame: Callable[[], None]
) -> None:
    """Writes a PLY for each frame of a live sequence as soon as it can be decoded.

    Args:
        waiting: Queue of the events of the receiver.
        folder: Output folder.
        concealer: Concealer for tracks with lost motion; None for the default.
        on_frame: Called after each frame.
    """
    for frame, number in numbered(frames_of_events(LiveDecoder(concealer or DEFAULT), waiting)):
        scene, path = frame.scene, folder / f"frame_{number:0{LIVE_DIGITS}}.ply"
        write_splats(
            [_never_empty(scene.drawn(), path)],
            path,
            antialiased=scene.antialiased,
            origin=scene.origin,
            metadata=scene.metadata,
        )
        on_frame()


def _never_empty(splats: Splats, path: Path) -> Splats:
    """Replaces an empty frame by one transparent Gaussian, for file formats that need at least one Gaussian.

    Args:
        splats: Gaussians of the frame.
        path: The file, for the warning about an empty frame.
    """
    if splats.num_gaussians:
        return splats
    LOG.warning("%s: the frame is empty: its file has a transparent Gaussian, because files cannot be empty", path)
    return Splats(
        means=np.zeros((1, 3), np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=np.full((1, 3), _PLACEHOLDER_SCALE, np.float32),
        opacities=np.zeros(1, np.float32),
        sh=np.zeros((1, num_functions(splats.degree), 3), np.float32),
    )


def numbered(frames: Iterable[SequenceFrame]) -> Iterator[tuple[SequenceFrame, int]]:
    """Yields each frame with a number for its file name.

    The numbers keep increasing after a restart of the server.
    """
    # Even if the server restarts and counts its frames from 0 again, no file is overwritten.
    last, offset = -1, 0
    for frame in frames:
        if frame.number + offset <= last:
            offset = last + 1 - frame.number
        last = frame.number + offset
        yield frame, last
