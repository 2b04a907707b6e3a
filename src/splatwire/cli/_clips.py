"""What verbs do with clips: folders of frames in, folders of frames out."""

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.clips import TrackingReport
    from splatwire.clips.encoding import ClipOptions
    from splatwire.packets import SceneStream
    from splatwire.scene.background import Background

Report = Callable[[str, float], None]
MAX_DENOMINATOR = 1001
"""29.97 frames a second are 30000 / 1001."""


def clip_options(
    fps: float | None, group: int | None, quality: str | None, background: "Background | None"
) -> "ClipOptions":
    """How a clip is encoded.

    Raises:
        InvalidValueError: If a number is out of range.
        UnknownNameError: If there is no such quality.
    """
    from splatwire.clips import ClipOptions
    from splatwire.clips.encoding import FRAME_RATE, GROUP_FRAMES
    from splatwire.codec.schemas.gaussians.quality import quality_of
    from splatwire.scene.background import BLACK

    if fps is not None and not 0.01 <= fps <= 1000:
        raise InvalidValueError(f"--fps takes 0.01 to 1000 frames a second, not {fps:g}")
    rate = FRAME_RATE if fps is None else Fraction(fps).limit_denominator(MAX_DENOMINATOR)
    return ClipOptions(
        rate, GROUP_FRAMES if group is None else group, quality=quality_of(quality or "default"),
        background=BLACK if background is None else background,
    )  # fmt: skip


def encode_folder(
    folder: Path, options: "ClipOptions", report: Report
) -> tuple["SceneStream", "TrackingReport", float]:
    """Encodes a folder with a file a frame; the stream, how frames belong together, seconds."""
    from splatwire.clips import encode_clip, frame_files, read_frames

    files, started = frame_files(folder), time.perf_counter()
    stream, tracking = encode_clip(
        read_frames(files), options, progress=lambda done: report("encoding frames", done / len(files))
    )
    return stream, tracking, time.perf_counter() - started


def describe_clip(stream: "SceneStream") -> dict[str, Any]:
    """Facts about a clip: its frames, how many tracks are born and move in each group, bytes of either."""
    from splatwire.codec.schemas.tracks.side_info import open_side_info

    manifest, plan = stream.manifest, stream.manifest.plan
    info = open_side_info(manifest, stream.side_info)
    sizes = {True: 0, False: 0}
    for packet in stream.packets:
        sizes[plan.lasting(packet.id.block)] += packet.num_bytes
    births, time_ = [group.births for group in info.groups], info.timeline
    return {
        "frames": time_.num_frames,
        "frame_rate": float(time_.rate),
        "group_frames": time_.group_frames,
        "seconds": float(time_.num_frames / time_.rate),
        "num_tracks": sum(births),
        "born_later": sum(births[1:]),
        "groups": len(births),
        "groups_without_motion": sum(not group.motions for group in info.groups),
        "base_bytes": sizes[True],
        "motion_bytes": sizes[False],
        "bytes_per_track_and_frame": stream.num_bytes / max(sum(births) * time_.num_frames, 1),
    }


def write_frames(
    stream: "SceneStream", folder: Path, suffix: str, concealer: str, only: int | None, report: Report
) -> dict[str, Any]:
    """Decodes a clip into a folder with a file a frame; or one frame into a file if `only` says which.

    Raises:
        InvalidValueError: If the clip has no such frame.
        UnknownNameError: If there is no such concealer or format.
    """
    from splatwire.clips.concealment import clip_concealer
    from splatwire.clips.decoding import decode_frame, decode_frames
    from splatwire.codec import decode_stream
    from splatwire.formats import write_splats, writer_for

    method = clip_concealer(concealer)
    writer_for(f"x{suffix}")
    clip = decode_stream(stream, progress=lambda share: report("decoding packets", share)).scene
    count = clip.timeline.num_frames
    shown = [decode_frame(clip, only, method)] if only is not None else decode_frames(clip, method)
    width, written, concealed = len(str(count - 1)), 0, 0
    for frame in shown:
        name = folder if only is not None else folder / f"frame_{frame.number:0{width}}{suffix}"
        write_splats([frame.scene.drawn()], name)
        written, concealed = written + 1, concealed + int(frame.concealed.sum())
        report("writing frames", written / (1 if only is not None else count))
    lost = int((~clip.tracks.received).sum())
    return {"num_frames": written, "num_tracks": clip.num_gaussians, "num_lost": lost, "num_concealed": concealed}


@contextmanager
def output_folder(name: str) -> Iterator[Path]:
    """A new folder that is there as a whole or not at all.

    Raises:
        InvalidValueError: If there is one with something in it.
    """
    target = Path(name)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InvalidValueError(f"{target} is there already and not empty: frames go into a new folder")
    target.parent.mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    try:
        yield made
        if target.exists():
            target.rmdir()
        made.chmod(0o755)
        made.rename(target)
    finally:
        shutil.rmtree(made, ignore_errors=True)
