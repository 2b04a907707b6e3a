"""`splatwire evaluate` of a clip."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.cli._output import refuse_options
from splatwire.cli._terminal import print_table
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.cli._evaluate_options import EvaluateOptions
    from splatwire.cli._output import Reporter
    from splatwire.clips import Frame
    from splatwire.clips.evaluation import ClipRow
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras

UNIT = "datagram"
_STILL = ("data", "contiguous", "background", "lpips_views")
"""Options that a clip has no use for."""


def check_clip_options(options: "EvaluateOptions") -> None:
    """Tells what is wrong with the options before any work.

    Raises:
        InvalidValueError: If they are not for a clip.
        UnknownNameError: If there is no such concealer.
    """
    from splatwire.clips import is_sequence
    from splatwire.clips.concealers import clip_concealer

    refuse_options(options, _STILL, "is for a still scene, not for a clip")
    if options.reference is None or not is_sequence(options.reference):
        raise InvalidValueError("a clip is compared with what it was made of: give --reference FOLDER of its frames")
    for concealer in options.conceal:
        clip_concealer(concealer)


def evaluate_clip(options: "EvaluateOptions", stream: "SceneStream", report: "Reporter") -> dict[str, Any]:
    """Scores a clip; what `--json` prints.

    Raises:
        SplatwireError: If frames or cameras cannot be read, or do not fit.
    """
    from splatwire.clips import open_sequence
    from splatwire.clips.evaluation import score_clip
    from splatwire.clips.report import Film, render_clip_report, score_rows
    from splatwire.codec.schemas.tracks.side_info import open_side_info
    from splatwire.evaluate.pixels import to_pixels
    from splatwire.files.whole import write_whole

    assert options.reference is not None
    timeline = open_side_info(stream.manifest, stream.side_info).timeline
    frames = open_sequence(options.reference, None if options.reference.is_dir() else timeline.num_frames)
    if frames.num_frames != timeline.num_frames:
        raise InvalidValueError(
            f"the clip has {timeline.num_frames} frames, {options.reference} has {frames.num_frames}"
        )
    rows = _rows(options, complete=len(stream.packets) == stream.manifest.num_packets)
    film, cameras = Film(len(rows)), _cameras(options, next(frames.read()))
    scores = score_clip(
        stream, frames.read(), cameras, rows, renderer=options.renderer,
        on_picture=None if options.output is None else lambda row, frame, image: film.add(row, frame, to_pixels(image)),
        progress=lambda done: report("comparing frames", done / timeline.num_frames),
    )  # fmt: skip
    content: dict[str, Any] = {
        "frames": timeline.num_frames, "frame_rate": float(timeline.rate), "group_frames": timeline.group_frames,
        "num_bytes": stream.num_bytes, "views": cameras.num_views, "rows": score_rows(scores), "report": None,
    }  # fmt: skip
    if options.output is not None:
        text = f"{timeline.num_frames} frames in groups of {timeline.group_frames}, {cameras.num_views} views"
        page = render_clip_report(Path(options.source).name, text, timeline, scores, film)
        write_whole(options.output / "report.html", page.encode())
        content["report"] = str(options.output / "report.html")
    return content


def print_clip_rows(content: dict[str, Any], title: str) -> None:
    """Prints the rows as a table on standard output."""
    from rich.table import Table

    from splatwire.clips.report import HEADINGS, cells

    under = "".join(f" under {loss}" for loss in {row["loss"] for row in content["rows"]} - {None, "none"})
    later = ", from the second group on" if content["frames"] > content["group_frames"] else ""
    table = Table(title=f"{title}{under}{later}", title_justify="left")
    shown = [number for number, name in enumerate(HEADINGS) if name != "loss"]  # it is in the title
    for number in shown:
        table.add_column(HEADINGS[number], justify="left" if number == 0 else "right")
    for row in content["rows"]:
        table.add_row(*(cells(row)[number] for number in shown))
    print_table(table)


def _rows(options: "EvaluateOptions", *, complete: bool) -> "list[ClipRow]":
    """How the clip is shown: as it is, then under every loss with every concealer."""
    from splatwire.channel import parse_loss
    from splatwire.clips.concealers import CLIP_CONCEALERS, DEFAULT
    from splatwire.clips.evaluation import ClipRow

    names = options.conceal or tuple(CLIP_CONCEALERS)
    if options.loss is None:
        return [ClipRow(DEFAULT)] if complete else [ClipRow(name) for name in names]
    loss = parse_loss(options.loss, UNIT)
    lossy = [ClipRow(name, loss, seed, options.loss) for name in names for seed in options.seeds or (0,)]
    return [ClipRow(DEFAULT), *lossy]


def _cameras(options: "EvaluateOptions", frame: "Frame") -> "Cameras":
    """Those of a file, or some around the first frame."""
    from splatwire.clips.evaluation import NUM_VIEWS, VIEW_SIZE
    from splatwire.data import load_cameras
    from splatwire.evaluate.views import spread
    from splatwire.render.importance import surrounding_cameras

    if options.cameras is not None:
        cameras = load_cameras(options.cameras)
        return cameras.select(spread(cameras.num_views, options.views))
    scene = frame.scene()
    return surrounding_cameras(scene, NUM_VIEWS if options.views is None else options.views, VIEW_SIZE)
