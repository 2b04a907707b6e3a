"""Predicts the picture errors that lost motion packets cause in a group of pictures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.sequence.side_info import open_side_info
from splatwire.concealment.temporal.concealers import TemporalConcealer
from splatwire.concealment.temporal.concealment import conceal_group
from splatwire.planning.sequence.delivery import SequenceLoad
from splatwire.render import iterate_views
from splatwire.sequence.decoding import covering_gains, pose_frame
from splatwire.types import Cameras
from splatwire.types.sequence_scene import SequenceScene, Timeline

SHARES = (0.0, 0.1, 0.3, 0.6, 0.9, 1.0)
"""Lost shares of a group's motion at which the distortion is measured. Distortion is moderate up to 0.9 and rises
steeply towards 1.
"""
MIN_FACTOR = 0.01
"""Minimum distortion of one quality relative to the median of all qualities; a value near zero would be a random
effect."""
FRAMES = 3
"""Number of frames per group of pictures that are rendered to measure distortion."""

Pictures = list[np.ndarray]
"""Renderings of the sampled frames: one array per frame with all views, float32 (V, H, W, 3)."""


@dataclass(frozen=True, eq=False)
class SequenceDistortion:
    """Mean squared error of the pictures of each group as a function of the lost share of the group's motion.

    Attributes:
        shares: Lost shares at which errors were measured, ascending from 0, float64 (G, S). Packets are weighted by
            importance.
        mse: Mean squared error after concealment at each share, float64 (G, S, K), for K rendered pictures of a group.
        frames: Number of frames of each group.
    """

    shares: np.ndarray
    mse: np.ndarray
    frames: tuple[int, ...]

    def psnr(self, group: int, lost: np.ndarray) -> np.ndarray:
        """Predicts the mean PSNR of a group of pictures.

        Args:
            group: Index of the group of pictures.
            lost: Lost share of the group's motion in each of T transfers, (T).

        Returns:
            PSNR in decibels, float64 (T).
        """
        shares, curves = self.shares[group], self.mse[group]
        return np.mean([-10 * np.log10(np.interp(lost, shares, curve)) for curve in curves.T], axis=0)


def sampled_frames(timeline: Timeline) -> list[list[int]]:
    """Selects the frames that are rendered to measure distortion; returns their indices within each group."""
    counts = [len(timeline.frames_of(group)) for group in range(timeline.num_groups)]
    return [sorted({int((n + 0.5) * count / FRAMES) for n in range(FRAMES)}) for count in counts]


def render_sampled_frames(sequence: SequenceScene, method: TemporalConcealer, cameras: Cameras) -> Pictures:
    """Renders a sample of the frames of a decoded sequence after concealing packet losses.

    Args:
        sequence: The decoded sequence, with masks of received elements.
        method: Concealer of lost motion.
        cameras: Views to render.
    """
    renders, memory, received = [], None, sequence.tracks.received
    for group, frames in enumerate(sampled_frames(sequence.timeline)):
        poses, hidden, after = conceal_group(
            sequence, sequence.motion(group, received), group, received, memory, method
        )
        hints = covering_gains(sequence, received, group, poses, hidden) if method.grow else None
        for index in frames:
            scene = pose_frame(sequence, poses, index, sequence.timeline.frames_of(group)[index], hints).scene
            renders.append(np.stack(list(iterate_views(scene, cameras))))
        memory = after()
    return renders


def measure_sequence_distortion(
    stream: SceneStream, load: SequenceLoad, method: TemporalConcealer, cameras: Cameras, references: Pictures,
    floor: float, *, seed: int = 0, progress: Callable[[float], None] | None = None,
) -> SequenceDistortion:  # fmt: skip
    """Measures how lost motion degrades the pictures of a sequence, by rendering simulated losses.

    Args:
        stream: Complete sequence.
        load: Sizes and importance of the packets of the sequence.
        method: The receiver's concealer of lost motion.
        cameras: Views to render.
        references: Reference renderings of the frames.
        floor: Mean squared error of the references themselves, which is added to the measured errors.
        seed: Random seed of the simulated losses.
        progress: Called with the completed fraction.
    """
    rng = np.random.default_rng(seed)
    timeline = open_side_info(stream.manifest, stream.side_info).timeline
    frames = sampled_frames(timeline)
    shares, mse = np.zeros((len(frames), len(SHARES))), list[np.ndarray]()
    for number, share in enumerate(SHARES):
        lost = set[int]()
        for group, packets in enumerate(load.groups):
            gone = rng.permutation(packets.motion)[: round(share * len(packets.motion))].tolist()
            lost |= set(gone)
            shares[group, number] = load.importance[gone].sum() / max(
                load.importance[list(packets.motion)].sum(), 1e-30
            )
        away = {load.ids[packet] for packet in lost}
        sequence = decode_stream(stream.with_packets(p for p in stream.packets if p.id not in away)).scene
        pairs = zip(render_sampled_frames(sequence, method, cameras), references, strict=True)
        mse.append(np.array([((a - b).astype(np.float64) ** 2).mean(axis=(1, 2, 3)) for a, b in pairs]))
        if progress:
            progress((number + 1) / len(SHARES))
    return _curves(shares, np.array(mse) + floor, frames, timeline)


def _curves(
    loss_shares: np.ndarray, mse: np.ndarray, frames: list[list[int]], timeline: Timeline
) -> SequenceDistortion:
    """Builds the distortion model of a sequence from the picture errors measured in S simulations of packet loss.

    Args:
        loss_shares: Lost share of each group's motion in each simulation, float64 (G, S).
        mse: Mean squared errors in each simulation, for each rendered frame and each of V views, float64 (S, frames,
            V).
        frames: Indices of the rendered frames within each group.
        timeline: Frame rate and groups of the sequence.
    """
    begins = np.cumsum([0, *map(len, frames)])
    groups = []
    for group, group_frames in enumerate(frames):
        rows = begins[group] + np.arange(FRAMES) % len(group_frames)
        groups.append(mse[:, rows].reshape(len(loss_shares[group]), -1))
    order = np.argsort(loss_shares, axis=1, kind="stable")
    sorted_mse = np.take_along_axis(np.array(groups), order[:, :, None], axis=1)
    lengths = tuple(len(timeline.frames_of(group)) for group in range(timeline.num_groups))
    return SequenceDistortion(
        np.take_along_axis(loss_shares, order, axis=1), np.maximum.accumulate(sorted_mse, axis=1), lengths
    )


def smoothed(distortions: Sequence[SequenceDistortion]) -> list[SequenceDistortion]:
    """Smooths the measured distortion models of several encodings of one sequence.

    All encodings are assumed to have the same curve of error over lost share, except for a constant factor. The common
    curve is the median of all measurements, which suppresses random errors.

    Args:
        distortions: One model for each encoding.

    Returns:
        One smoothed model for each encoding, in the order of `distortions`.
    """
    # One curve of added error, multiplied by a factor for each encoding; medians, as single values can be outliers.
    grid = np.array(SHARES)

    def on_grid(distortion: SequenceDistortion) -> np.ndarray:
        pairs = zip(distortion.shares, distortion.mse, strict=True)
        return np.array([[np.interp(grid, shares, curve) for curve in mse.T] for shares, mse in pairs]).swapaxes(1, 2)

    errors = np.array([on_grid(distortion) for distortion in distortions])
    added, factors = errors - errors[:, :, :1], np.ones(len(distortions))
    for _ in range(2):  # second round without the factors of the first
        usual = np.median([errors_added / factor for errors_added, factor in zip(added, factors, strict=True)], axis=0)
        is_measured = usual > 0
        if is_measured.any():
            factors = np.array(
                [
                    max(float(np.median(errors_added[is_measured] / usual[is_measured])), MIN_FACTOR)
                    for errors_added in added
                ]
            )
    usual, shares = np.maximum.accumulate(usual, axis=1), np.tile(grid, (len(usual), 1))
    return [
        SequenceDistortion(shares, errors_added[:, :1] + factor * usual, distortion.frames)
        for errors_added, factor, distortion in zip(errors, factors, distortions, strict=True)
    ]
