"""Measures sizes and distortion of several encodings of a sequence for the planner."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.sequence.side_info import Timeline, open_side_info
from splatwire.concealment.temporal.concealers import DEFAULT, temporal_concealer
from splatwire.errors import InvalidValueError
from splatwire.planning.sequence.delivery import SequenceLoad
from splatwire.planning.sequence.distortion import (
    Pictures,
    measure_sequence_distortion,
    render_sampled_frames,
    sampled_frames,
    smoothed,
)
from splatwire.planning.sequence.planner import SequenceVariant
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.sequence import frame_files, read_frames
from splatwire.sequence.importance import stream_importance
from splatwire.types import Cameras

VIEWS, VIEW_SIZE = 3, 256
ASSUMED_PSNR = 45.0
"""PSNR in decibels that is assumed for the finest stream if the original frames are not available."""


def common_timeline(streams: Sequence[SceneStream]) -> Timeline:
    """Returns the frame rate and groups of pictures that several encodings of one sequence have in common.

    Raises:
        InvalidValueError: If the sequences do not encode the same frames in the same groups.
    """
    times = [open_side_info(stream.manifest, stream.side_info).timeline for stream in streams]
    if any(time != times[0] for time in times):
        raise InvalidValueError("clips that compete have the same frames, in the same groups")
    return times[0]


def sequence_variants(
    streams: Sequence[SceneStream], reference: Path | None, *, concealer: str | None = None, views: int | None = None,
    seed: int = 0, progress: Callable[[float], None] = lambda share: None,
) -> list[SequenceVariant]:  # fmt: skip
    """Measures how packet loss degrades several encodings of the same frames, for the planner to choose one.

    Args:
        streams: The encoded sequences.
        reference: Folder of the original frames; None to compare with the largest sequence.
        concealer: Name of the receiver's concealer; None for the default.
        views: Number of views; None for the default.
        seed: Random seed of the simulated losses.
        progress: Called with the finished share, 0 to 1.

    Raises:
        InvalidValueError: If the number of original frames differs from the number of frames in the sequences.
    """
    method = temporal_concealer(concealer or DEFAULT)
    finest = decode_stream(max(streams, key=lambda stream: stream.num_bytes)).scene
    cameras = surrounding_cameras(finest.keyframes(), VIEWS if views is None else views, VIEW_SIZE)
    if reference is not None:
        references, floor = frames_of(frame_files(reference), finest.timeline, cameras), 0.0
    else:
        references, floor = render_sampled_frames(finest, method, cameras), 10 ** (-ASSUMED_PSNR / 10)
    loads, damages = [], []
    for number, stream in enumerate(streams):

        def on_share(share: float, number: int = number) -> None:
            progress((number + share) / len(streams))

        load = SequenceLoad.of(stream, stream_importance(stream))
        loads.append(load)
        damages.append(
            measure_sequence_distortion(stream, load, method, cameras, references, floor, seed=seed, progress=on_share)
        )
    return [SequenceVariant(load, damage) for load, damage in zip(loads, smoothed(damages), strict=True)]


def frames_of(files: list[Path], timeline: Timeline, cameras: Cameras) -> Pictures:
    """Renders a sample of the frames of an original sequence (`sampled_frames`), as references for received frames.

    Args:
        files: Files of all original frames, in order.
        timeline: Timeline of the sequence.
        cameras: Views to render.

    Raises:
        InvalidValueError: If the number of files differs from the number of frames in the sequence.
    """
    if len(files) != timeline.num_frames:
        raise InvalidValueError(f"the clip has {timeline.num_frames} frames, its reference has {len(files)}")
    wanted = [timeline.frames_of(group)[n] for group, sampled in enumerate(sampled_frames(timeline)) for n in sampled]
    frames = []
    for frame in read_frames([files[number] for number in wanted]):
        scene = frame.scene()
        frames.append(np.stack(list(iterate_views(scene, cameras))))
    return frames
