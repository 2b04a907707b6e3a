"""What losing some of a group's motion does to the picture, after concealment: curves that a planner looks up."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from splatwire.clips.concealers import ClipConcealer
from splatwire.clips.concealment import conceal_group
from splatwire.clips.decoding import posed
from splatwire.clips.delivery import ClipLoad
from splatwire.codec import decode_stream
from splatwire.codec.schemas.tracks.side_info import open_side_info
from splatwire.model.clip import ClipScene, Timeline
from splatwire.packets import SceneStream
from splatwire.render import iterate_views
from splatwire.scene import Cameras

SHARES = (0.0, 0.1, 0.3, 0.6, 0.9, 1.0)
"""Of a group's motion that are lost to measure: most is bearable, all is not, and between 0.9 and 1 it turns."""
LEAST_FACTOR = 0.01
"""How much less than usual losses may seem to cost one quality: nothing at all is a lucky draw."""
FRAMES = 3
"""Frames of a group whose pictures are drawn."""

Pictures = list[np.ndarray]
"""Of the sampled frames, in order: all views of each, float32 (V, H, W, 3)."""


@dataclass(frozen=True, eq=False)
class ClipDamage:
    """Mean squared errors of pictures where some of a group's motion is lost.

    Attributes:
        shares: What of a group's motion was lost, by what it is worth, ascending from 0, float64 (G, S).
        mse: Of each view of the group's sampled frames, by that, float64 (G, S, K); never less than of a smaller loss.
        frames: Frames of each group.
    """

    shares: np.ndarray
    mse: np.ndarray
    frames: tuple[int, ...]

    def psnr(self, group: int, lost: np.ndarray) -> np.ndarray:
        """Decibels of a group, mean over frames and views, for what is lost of its motion, float64 (T)."""
        shares, curves = self.shares[group], self.mse[group]
        return np.mean([-10 * np.log10(np.interp(lost, shares, curve)) for curve in curves.T], axis=0)


def sampled(timeline: Timeline) -> list[list[int]]:
    """Frames of each group whose pictures are drawn, counted from the group's first."""
    counts = [len(timeline.frames_of(group)) for group in range(timeline.num_groups)]
    return [sorted({int((n + 0.5) * count / FRAMES) for n in range(FRAMES)}) for count in counts]


def draw(clip: ClipScene, method: ClipConcealer, cameras: Cameras) -> Pictures:
    """Pictures of the sampled frames of a clip as it arrived."""
    found, memory, there = [], None, clip.tracks.received
    for group, frames in enumerate(sampled(clip.timeline)):
        poses, after = conceal_group(clip, clip.motion(group, there), group, there, memory, method)
        for index in frames:
            scene = posed(clip, poses, index, clip.timeline.frames_of(group)[index], None).scene
            found.append(np.stack(list(iterate_views(scene, cameras))))
        memory = after()
    return found


def measure_clip_damage(
    stream: SceneStream, load: ClipLoad, method: ClipConcealer, cameras: Cameras, references: Pictures, floor: float,
    *, seed: int = 0, progress: Callable[[float], None] | None = None,
) -> ClipDamage:  # fmt: skip
    """Loses shares of the motion of all groups, conceals, draws, and compares.

    Args:
        stream: The complete clip.
        load: Its packets.
        method: What the receiver does about losses.
        cameras: Where from.
        references: What the sampled frames should show.
        floor: Mean squared error of the references themselves, which is added.
        seed: Which packets are lost.
        progress: Called with the share of the work that is done.
    """
    rng = np.random.default_rng(seed)
    timeline = open_side_info(stream.manifest, stream.side_info).timeline
    frames = sampled(timeline)
    shares, mse = np.zeros((len(frames), len(SHARES))), list[np.ndarray]()
    for number, share in enumerate(SHARES):
        lost = set[int]()
        for group, packets in enumerate(load.groups):
            gone = rng.permutation(packets.motion)[: round(share * len(packets.motion))].tolist()
            lost |= set(gone)
            shares[group, number] = load.worth[gone].sum() / max(load.worth[list(packets.motion)].sum(), 1e-30)
        away = {load.ids[packet] for packet in lost}
        clip = decode_stream(stream.with_packets(p for p in stream.packets if p.id not in away)).scene
        pairs = zip(draw(clip, method, cameras), references, strict=True)
        mse.append(np.array([((a - b).astype(np.float64) ** 2).mean(axis=(1, 2, 3)) for a, b in pairs]))
        if progress:
            progress((number + 1) / len(SHARES))
    return _curves(shares, np.array(mse) + floor, frames, timeline)


def _curves(shares: np.ndarray, mse: np.ndarray, frames: list[list[int]], timeline: Timeline) -> ClipDamage:
    """Curves of groups from errors (S, frames, V); groups of fewer frames repeat some."""
    begins = np.cumsum([0, *map(len, frames)])
    groups = []
    for group, some in enumerate(frames):
        rows = begins[group] + np.arange(FRAMES) % len(some)
        groups.append(mse[:, rows].reshape(len(shares[group]), -1))
    order = np.argsort(shares, axis=1, kind="stable")
    sorted_mse = np.take_along_axis(np.array(groups), order[:, :, None], axis=1)
    lengths = tuple(len(timeline.frames_of(group)) for group in range(timeline.num_groups))
    return ClipDamage(np.take_along_axis(shares, order, axis=1), np.maximum.accumulate(sorted_mse, axis=1), lengths)


def pooled(damages: Sequence[ClipDamage]) -> list[ClipDamage]:
    """The same where qualities of one clip share how errors grow with what is lost, and differ by one factor each.

    One draw of losses for each share is little: a quality would seem better because its draw was lucky. Medians, for
    in some draws what neighbours tell is not believed any more, and errors are a hundred times the usual.
    """
    grid = np.array(SHARES)

    def on_grid(damage: ClipDamage) -> np.ndarray:
        pairs = zip(damage.shares, damage.mse, strict=True)
        return np.array([[np.interp(grid, shares, curve) for curve in mse.T] for shares, mse in pairs]).swapaxes(1, 2)

    errors = np.array([on_grid(damage) for damage in damages])
    added, factors = errors - errors[:, :, :1], np.ones(len(damages))
    for _ in range(2):  # what is usual of them as they are, and then of what they are without their factors
        usual = np.median([some / factor for some, factor in zip(added, factors, strict=True)], axis=0)
        told = usual > 0
        if told.any():
            factors = np.array([max(float(np.median(some[told] / usual[told])), LEAST_FACTOR) for some in added])
    usual, shares = np.maximum.accumulate(usual, axis=1), np.tile(grid, (len(usual), 1))
    return [
        ClipDamage(shares, some[:, :1] + factor * usual, damage.frames)
        for some, factor, damage in zip(errors, factors, damages, strict=True)
    ]
