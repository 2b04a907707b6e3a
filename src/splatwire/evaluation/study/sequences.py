"""Evaluation of sequences: each frame is one view, compared with a render of the original frame."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from splatwire.bitstream import SceneStream
from splatwire.channel import PacketLossMask
from splatwire.channel.transmit import arrival_groups
from splatwire.codec import decode_stream
from splatwire.codec.sequence.side_info import open_side_info
from splatwire.concealment.temporal.concealers import TemporalConcealer
from splatwire.data import load_cameras
from splatwire.errors import InvalidValueError
from splatwire.evaluation.sequence.evaluation import NUM_VIEWS, VIEW_SIZE, available_by_group
from splatwire.evaluation.study.definition import Loss
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.sequence.decoding import decode_frames
from splatwire.sequence.frames import open_sequence
from splatwire.types import Cameras
from splatwire.types.background import Background

Picture = Float[np.ndarray, "H W 3"]


def frame_cameras(stream: SceneStream, frames: Path, cameras: Path | None) -> Cameras:
    """Returns one camera for each frame of a sequence.

    Args:
        stream: The stream of the sequence.
        frames: The original frames, in a format of `splatwire.sequence.open_sequence`.
        cameras: A cameras file; None for generated cameras around the first frame. If there are fewer cameras than
            frames, the cameras are repeated from the first one on.

    Raises:
        InvalidValueError: If the stream and the original sequence have different numbers of frames.
    """
    count = open_side_info(stream.manifest, stream.side_info).timeline.num_frames
    sequence = open_sequence(frames, None if frames.is_dir() else count)
    if sequence.num_frames != count:
        raise InvalidValueError(f"the sequence has {count} frames, {frames} has {sequence.num_frames}")
    if cameras is not None:
        cameras_of_frames = load_cameras(cameras)
    else:
        cameras_of_frames = surrounding_cameras(next(iter(sequence.read())).scene(), NUM_VIEWS, VIEW_SIZE)
    width = len(str(count - 1))
    turns = cameras_of_frames.select([frame % cameras_of_frames.num_views for frame in range(count)])
    return replace(turns, names=tuple(f"frame_{frame:0{width}}" for frame in range(count)))


def reference_pictures(
    frames: Path, cameras: Cameras, chosen: Sequence[int], renderer: str, background: Background
) -> Iterator[Picture]:
    """Renders the selected original frames, each with its camera.

    Args:
        frames: The frames, in a format of `splatwire.sequence.open_sequence`.
        cameras: Camera of each selected frame.
        chosen: Indices of the selected frames, ascending.
        renderer: Name of the renderer.
        background: RGB of the background.
    """
    sequence = open_sequence(frames, None if frames.is_dir() else chosen[-1] + 1)
    scenes = (frame.scene(background) for number, frame in enumerate(sequence.read()) if number in set(chosen))
    yield from _drawn(scenes, cameras, renderer)


def concealed_pictures(
    stream: SceneStream, mask: PacketLossMask | None, loss: Loss | None, seed: int, concealer: TemporalConcealer,
    cameras: Cameras, chosen: Sequence[int], renderer: str,
) -> Iterator[Picture]:  # fmt: skip
    """Simulates packet losses in a sequence, conceals them, and yields a render of each selected frame.

    Args:
        stream: The complete stream.
        mask: Mask of the packets that are received when first sent; None without loss. Lost packets of keyframes are
            sent again.
        loss: Loss model of retransmissions; None without loss.
        seed: Seed of the loss.
        concealer: Concealer of lost motion data.
        cameras: Camera of each selected frame.
        chosen: Indices of the selected frames, ascending.
        renderer: Name of the renderer.
    """
    arrived, available = stream, None
    if mask is not None and loss is not None:
        when = arrival_groups(stream, mask, loss.process, seed=seed)
        packets = zip(stream.packets, when.tolist(), strict=True)
        arrived, available = (
            stream.with_packets(p for p, group in packets if group >= 0),
            available_by_group(stream, when),
        )
    wanted = set(chosen)
    frames = decode_frames(decode_stream(arrived, threads=1).scene, concealer, available=available)
    yield from _drawn((frame.scene for frame in frames if frame.number in wanted), cameras, renderer)


def _drawn(scenes: Iterator[object], cameras: Cameras, renderer: str) -> Iterator[Picture]:
    for view, scene in enumerate(scenes):
        yield next(iter(iterate_views(scene, cameras.select([view]), renderer=renderer)))  # type: ignore[arg-type]
