"""Evaluation of a sequence against its original frames: losses and concealers, views, scores and the report."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from splatwire.bitstream import SceneStream
from splatwire.channel import parse_loss
from splatwire.codec.sequence.side_info import open_side_info
from splatwire.concealment.temporal.concealers import DEFAULT, temporal_concealer_names
from splatwire.data import load_cameras
from splatwire.errors import InvalidValueError
from splatwire.evaluation.pixels import to_pixels
from splatwire.evaluation.sequence.evaluation import NUM_VIEWS, VIEW_SIZE, SequenceRow, score_sequence
from splatwire.evaluation.sequence.report import PlayerPictures, render_sequence_report, score_rows
from splatwire.evaluation.views import spread
from splatwire.files.atomic_write import atomic_write
from splatwire.render.importance import surrounding_cameras
from splatwire.render.near_plane import warn_of_near_plane
from splatwire.sequence import Frame, open_sequence
from splatwire.types import Cameras

UNIT = "datagram"


def evaluate_sequence(
    stream: SceneStream, reference: Path, rows: Sequence[SequenceRow], *, cameras: Path | None = None,
    views: int | None = None, renderer: str = "cpu", output: Path | None = None, title: str = "clip",
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:  # fmt: skip
    """Evaluates a sequence; returns JSON values, and writes a report if requested.

    Args:
        stream: The sequence.
        reference: Original frames of the sequence: a folder or file that `open_sequence` reads.
        rows: Experiments: each has a loss model and a concealer.
        cameras: Cameras file; None for views around the first frame.
        views: Maximum number of views; None for the default.
        renderer: Name of the renderer.
        output: Folder of the report; None for no report.
        title: Title of the report.
        progress: Called with the finished share, 0 to 1.

    Raises:
        SplatwireError: If frames or cameras cannot be read, or do not fit the sequence.
    """
    timeline = open_side_info(stream.manifest, stream.side_info).timeline
    frames = open_sequence(reference, None if reference.is_dir() else timeline.num_frames)
    if frames.num_frames != timeline.num_frames:
        raise InvalidValueError(f"the clip has {timeline.num_frames} frames, {reference} has {frames.num_frames}")
    player_pictures, seen_from = PlayerPictures(len(rows)), _cameras(cameras, views, next(frames.read()))
    scores = score_sequence(
        stream, frames.read(), seen_from, rows, renderer=renderer,
        on_picture=None if output is None else lambda row, at, image: player_pictures.add(row, at, to_pixels(image)),
        progress=lambda done: progress(done / timeline.num_frames),
    )  # fmt: skip
    content: dict[str, Any] = {
        "frames": timeline.num_frames, "frame_rate": float(timeline.rate), "group_frames": timeline.group_frames,
        "num_bytes": stream.num_bytes, "views": seen_from.num_views, "rows": score_rows(scores), "report": None,
    }  # fmt: skip
    if output is not None:
        text = f"{timeline.num_frames} frames in groups of {timeline.group_frames}, {seen_from.num_views} views"
        atomic_write(
            output / "report.html",
            render_sequence_report(title, text, timeline, scores, player_pictures).encode(),
            parents=True,
        )
        content["report"] = str(output / "report.html")
    return content


def sequence_rows(
    stream: SceneStream, concealers: Sequence[str], loss: str | None, seeds: Sequence[int]
) -> list[SequenceRow]:
    """Returns the experiments to run: one without losses, then one for each concealer and seed.

    Args:
        stream: The sequence.
        concealers: Names of concealers; all if empty.
        loss: Specification of the loss model; None to evaluate the sequence as it is.
        seeds: Seeds of the losses; 0 if empty.
    """
    names = concealers or temporal_concealer_names()
    if loss is None:
        complete = len(stream.packets) == stream.manifest.num_packets
        return [SequenceRow(DEFAULT)] if complete else [SequenceRow(name) for name in names]
    model = parse_loss(loss, UNIT)
    return [SequenceRow(DEFAULT), *(SequenceRow(name, model, seed, loss) for name in names for seed in seeds or (0,))]


def _cameras(path: Path | None, views: int | None, frame: Frame) -> Cameras:
    """Returns the cameras of a file, or generated cameras around the first frame."""
    if path is not None:
        cameras = load_cameras(path)
        cameras = cameras.select(spread(cameras.num_views, views))
        warn_of_near_plane(frame.scene(), cameras)
        return cameras
    return surrounding_cameras(frame.scene(), NUM_VIEWS if views is None else views, VIEW_SIZE)
