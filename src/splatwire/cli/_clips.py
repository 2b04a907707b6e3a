"""What verbs do with clips: folders of frames in, folders of frames out."""

import itertools
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.cli._files import check_folder
from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.clips import TrackingReport
    from splatwire.clips.options import ClipOptions
    from splatwire.formats.outliers import Outliers
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras
    from splatwire.scene.background import Background

Report = Callable[[str, float], None]
MOST_FILES = 20_000
"""Most frames that are written unless somebody allows more: eleven minutes at 30 frames per second."""
MAX_DENOMINATOR = 1001
"""29.97 frames a second are 30000 / 1001."""


def check_concealer(name: str) -> None:
    """Tells a name that neither scenes nor clips know, before it is known which of them it is for.

    Raises:
        UnknownNameError: If there is no such concealer.
    """
    from splatwire.clips.concealers import CLIP_CONCEALERS
    from splatwire.conceal import create_concealer

    if name not in CLIP_CONCEALERS:
        create_concealer(name)


def clip_options(
    fps: float | None, group: int | None, quality: str | None, background: "Background | None", up: str = "auto"
) -> "ClipOptions":
    """How a clip is encoded.

    Raises:
        InvalidValueError: If a number is out of range.
        UnknownNameError: If there is no such quality.
    """
    from splatwire.clips import ClipOptions
    from splatwire.clips.options import FRAME_RATE, GROUP_FRAMES
    from splatwire.codec.schemas.gaussians.quality import quality_of
    from splatwire.scene.background import BLACK

    if fps is not None and not 0.01 <= fps <= 1000:
        raise InvalidValueError(f"--fps takes 0.01 to 1000 frames a second, not {fps:g}")
    rate = FRAME_RATE if fps is None else Fraction(fps).limit_denominator(MAX_DENOMINATOR)
    return ClipOptions(
        rate, GROUP_FRAMES if group is None else group, quality=quality_of(quality or "default"),
        background=BLACK if background is None else background, up=up,
    )  # fmt: skip


def encode_sequence(
    source: Path, frames: int | None, options: "ClipOptions", report: Report
) -> tuple["SceneStream", "TrackingReport", float]:
    """Encodes what `open_sequence` takes; the stream, how frames belong together, seconds."""
    from splatwire.clips import encode_clip, open_sequence

    sequence, started = open_sequence(source, frames), time.perf_counter()
    stream, tracking = encode_clip(
        sequence.read(),
        replace(options, order=sequence.order),
        progress=lambda done: report("encoding frames", done / sequence.num_frames),
    )
    return stream, tracking, time.perf_counter() - started


def describe_clip(stream: "SceneStream") -> dict[str, Any]:
    """Facts about a clip: frames, tracks that are born, die and stand still, bytes of bases and of motion, matching."""
    from splatwire.clips.tracking import SECTION, TrackingReport
    from splatwire.codec.schemas.tracks.side_info import open_side_info

    manifest, plan = stream.manifest, stream.manifest.plan
    info = open_side_info(manifest, stream.side_info)
    sizes = {True: 0, False: 0}
    for packet in stream.packets:
        sizes[plan.lasting(packet.id.block)] += packet.num_bytes
    births, time_ = [group.births for group in info.groups], info.timeline
    tracking = TrackingReport.read(info.sections[SECTION]) if SECTION in info.sections else None
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
        "frames_matched": None if tracking is None else tracking.matched,
        "share_matched": None if tracking is None else tracking.share,
    }


def count_motions(stream: "SceneStream") -> dict[str, Any]:
    """Facts about a clip that its packets have to be read for: tracks that stand still in a group, and that die."""
    import numpy as np

    from splatwire.codec import decode_stream

    clip = decode_stream(stream).scene
    alive, there, still = np.zeros(clip.num_gaussians, bool), 0, 0
    for group in range(clip.timeline.num_groups):
        motion = clip.motion(group, clip.tracks.received)
        if motion.unchanged:
            alive |= clip.tracks.born == group
            here = standing = int(alive.sum())
        else:
            alive[:] = False
            alive[motion.tracks[motion.ends == len(clip.timeline.frames_of(group))]] = True
            here, standing = len(motion.tracks), int((~motion.moving).sum())
        there, still = there + here, still + standing
    return {"died": int((~alive).sum()), "still_share": still / there if there else 1.0}


def check_num_frames(stream: "SceneStream", most: int | None, advice: str) -> None:
    """Refuses to write a file for each frame of a clip that has very many: a few bytes may announce 131,072.

    Args:
        stream: The clip.
        most: Most files; None for `MOST_FILES`.
        advice: What to do about it.

    Raises:
        InvalidValueError: If it has more frames.
    """
    from splatwire.codec.schemas.tracks.side_info import open_side_info

    count = open_side_info(stream.manifest, stream.side_info).timeline.num_frames
    if count > (MOST_FILES if most is None else most):
        raise InvalidValueError(
            f"the clip of {stream.num_bytes:,} bytes has {count:,} frames, and no more than "
            f"{MOST_FILES if most is None else most:,} files are written: {advice}"
        )


def write_frames(
    stream: "SceneStream", folder: Path, suffix: str, concealer: str, only: int | None, report: Report,
    outliers: "Outliers" = "clamp",
) -> dict[str, Any]:  # fmt: skip
    """Decodes a clip into a folder with a file a frame, or of one frame if `only` says which; that may go to a file.

    Raises:
        InvalidValueError: If the clip has no such frame.
        UnknownNameError: If there is no such concealer or format.
    """
    from splatwire.clips.concealers import clip_concealer
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
        name = folder / f"frame_{frame.number:0{width}}{suffix}" if folder.is_dir() else folder
        write_splats([frame.scene.drawn()], name, antialiased=clip.antialiased, origin=clip.origin, outliers=outliers)
        written, concealed = written + 1, concealed + int(frame.concealed.sum())
        report("writing frames", written / (1 if only is not None else count))
    lost = int((~clip.tracks.received).sum())
    return {"num_frames": written, "num_tracks": clip.num_gaussians, "num_lost": lost, "num_concealed": concealed}


def draw_clip(
    stream: "SceneStream", path: Path, cameras: "Cameras | None", scale: float, concealer: str | None, renderer: str,
    report: Report,
) -> dict[str, Any]:  # fmt: skip
    """Draws a clip as an animated WebP: from one camera after another, or on a walk around it.

    Raises:
        UnknownNameError: If there is no such concealer or renderer.
    """
    from PIL import Image

    from splatwire.clips.concealers import DEFAULT, clip_concealer
    from splatwire.clips.decoding import decode_frames
    from splatwire.clips.extent import ball_around
    from splatwire.codec import decode_stream
    from splatwire.codec.viewpoint import read_extent, up_axis
    from splatwire.evaluate.pixels import to_pixels
    from splatwire.files.whole import written_whole
    from splatwire.packets.sections import sections_of
    from splatwire.render import iterate_views
    from splatwire.render.importance import orbiting_cameras

    method = clip_concealer(concealer or DEFAULT)
    clip = decode_stream(stream, progress=lambda share: report("decoding packets", share)).scene
    count = clip.timeline.num_frames
    if cameras is None:
        sections, born = sections_of(stream), ball_around(clip.positions)
        middle, radius = read_extent(sections) or (born.middle, born.radius)
        cameras = orbiting_cameras(middle, max(radius, 1e-6), count, up_axis(sections))
        cameras = replace(cameras, origin=clip.origin)
    cameras = cameras if scale == 1 else cameras.scaled(scale)

    def pictures() -> Iterator[Image.Image]:
        for frame in decode_frames(clip, method):
            view = cameras.select([frame.number * cameras.num_views // count])
            image = next(iter(iterate_views(frame.scene, view, renderer=renderer)))
            report("drawing", (frame.number + 1) / count)
            yield Image.fromarray(to_pixels(image))

    drawn, times = pictures(), [round(number * 1000 / clip.timeline.rate) for number in range(count + 1)]
    durations = [after - before for before, after in itertools.pairwise(times)]
    with written_whole(path) as target:
        next(drawn).save(
            target, "WEBP", save_all=True, append_images=drawn, duration=durations, loop=0, quality=85, method=2
        )
    return {"num_frames": count, "width": cameras.width, "height": cameras.height}


@contextmanager
def output_folder(name: str) -> Iterator[Path]:
    """A new folder that is there as a whole or not at all.

    Raises:
        InvalidValueError: If there is one with something in it.
    """
    from splatwire.files.whole import written_whole

    target = Path(name)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InvalidValueError(f"{target} is there already and not empty: frames go into a new folder")
    check_folder(target)
    with written_whole(target) as made:
        made.mkdir()
        yield made
