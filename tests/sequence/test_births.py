"""Lost motion of late tracks and of two overlapping bodies is estimated from neighbours."""

from dataclasses import replace

import numpy as np
import pytest

from close import unit
from random_numbers import Numbers
from splatwire.codec import decode_stream
from splatwire.concealment.temporal.concealers import temporal_concealer
from splatwire.concealment.temporal.concealment import conceal_group
from splatwire.concealment.temporal.poses import ConcealmentState
from splatwire.sequence import Frame, SequenceEncoder, SequenceOptions, encode_sequence
from splatwire.sequence.group_builder import GroupBuilder, group_of
from splatwire.sequence.partial_tracks import TrackedFrame, extrapolate_partial_tracks
from splatwire.types.sequence_scene import GroupMotion, SequenceScene
from splatwire.types.splats import Splats

COUNT, FRAMES, LATE, GONE = 1200, 12, 5, 8
LOST = np.arange(COUNT) % 4 == 0
"""Rows without motion: a quarter of the late tracks and of the others."""


def places(body: np.ndarray, frame: int, turns: float) -> np.ndarray:
    """A cloud that rotates about an axis and drifts."""
    angle = turns * frame
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return body @ turn.T + np.array([0.05, 0.02, -0.01]) * frame


def splats_at(means: np.ndarray, there: np.ndarray) -> Splats:
    rng = Numbers(3)
    count = len(means)
    quats = unit(rng.randn(count, 4))
    scales = rng.rand(count, 3) * 0.02 + 0.01
    colours = rng.rand(count, 1, 3)
    return Splats(means.astype(np.float32), quats, scales, 0.8 * there.astype(np.float32), colours)


@pytest.fixture(scope="module")
def body() -> np.ndarray:
    return np.random.default_rng(1).uniform(-1, 1, (COUNT, 3))


def there_at(frame: int) -> np.ndarray:
    """A fifth of the Gaussians appear late, another fifth disappear early."""
    fifth = np.arange(COUNT) % 5
    return ((fifth != 1) | (frame >= LATE)) & ((fifth != 2) | (frame < GONE))


def test_unborn_tracks_follow_their_neighbours(body):
    frames = []
    for frame in range(FRAMES):
        here = np.flatnonzero(there_at(frame))
        splats = splats_at(places(body, frame, 0.1), there_at(frame))
        frames.append(TrackedFrame(splats.select(here), here))
    group = group_of(frames)
    wanted = np.stack([places(body, frame, 0.1) for frame in range(FRAMES)], axis=1)
    assert np.abs(group.trajectories.means - wanted).max() < 0.02
    assert (group.begins[group.keys % 5 == 1] == LATE).all()
    assert np.array_equal(group.keyframe_gaussians(np.arange(COUNT)).means, group.trajectories.means[:, 0])


def decoded(frames: list[Splats], group_frames: int) -> tuple[SequenceScene, np.ndarray]:
    """Decoded sequence, and the mask of the tracks that lose their motion in the tests."""
    options = SequenceOptions(group_frames=group_frames, order="tracked")
    clip = decode_stream(encode_sequence(map(Frame.of, frames), options)[0]).scene
    colours = np.concatenate([frame.sh[frame.opacities > 0, 0] for frame in frames])
    rows = np.concatenate([np.flatnonzero(frame.opacities > 0) for frame in frames])
    near = ((clip.tracks.splats.sh[:, None, 0] - colours[None, :COUNT]) ** 2).sum(axis=2).argmin(axis=1)
    return clip, LOST[rows[near]]


def without(motion: GroupMotion, lost: np.ndarray) -> GroupMotion:
    """Motion of a group of pictures without that of some tracks."""
    keep = ~lost[motion.tracks]
    return replace(
        motion, tracks=motion.tracks[keep], moving=motion.moving[keep], begins=motion.begins[keep],
        ends=motion.ends[keep], at=lambda frame: motion.at(frame)[keep], covered=motion.covered & ~lost, complete=False,
    )  # fmt: skip


def errors(clip: SequenceScene, lost: np.ndarray) -> list[float]:
    """Largest position error of the tracks without received motion, for each group."""
    memory: ConcealmentState | None = None
    there, found = np.ones(clip.num_gaussians, bool), []
    for group in range(clip.timeline.num_groups):
        motion = clip.motion(group, there)
        poses, _, after = conceal_group(clip, without(motion, lost), group, there, memory, temporal_concealer("motion"))
        memory = after()
        row = np.full(clip.num_gaussians, -1)
        row[motion.tracks] = np.arange(len(motion.tracks))
        own = np.flatnonzero(poses.concealed & (row[poses.tracks] >= 0))
        assert len(own) > COUNT // 8
        truth = row[poses.tracks[own]]
        worst = 0.0
        for frame in range(len(clip.timeline.frames_of(group))):
            here = (motion.begins[truth] <= frame) & (frame < motion.ends[truth])
            apart = np.linalg.norm(poses.at(frame)[own, :3] - motion.at(frame)[truth, :3], axis=1)
            worst = max(worst, float(apart[here].max()))
        found.append(worst)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("late", [LATE, FRAMES // 2 + LATE])
def test_late_track_starts_where_its_neighbours_moved(body, late):
    """Covers the first group, and the second one, after its other tracks."""
    fifth = np.arange(COUNT) % 5
    frames = [splats_at(places(body, f, 0.1), (fifth != 1) | (f >= late)) for f in range(FRAMES)]
    assert max(errors(*decoded(frames, FRAMES // 2))) < 0.05


def test_touching_bodies_keep_separate_motion(body):
    """One body rotates, and the other passes through it from the left."""
    frames = []
    for frame in range(FRAMES):
        means = places(body, frame, 0.1)
        means[::2] = body[::2] + np.array([0.4 * frame - 4, 0, 0])
        frames.append(splats_at(means, np.ones(COUNT, bool)))
    assert max(errors(*decoded(frames, FRAMES // 2))) < 0.05


def test_lost_tracks_are_omitted_where_neighbours_move_incoherently(body):
    """A guess would be worse than omission. With coherent neighbours all tracks are drawn."""
    rng = np.random.default_rng(2)
    wild = np.cumsum(rng.normal(0, 0.1, (FRAMES, COUNT, 3)), axis=0)
    for moves, shown in ((wild, False), (np.zeros_like(wild) + np.arange(FRAMES)[:, None, None] / 10, True)):
        clip, lost = decoded([splats_at(body + move, np.ones(COUNT, bool)) for move in moves], FRAMES)
        there = np.ones(clip.num_gaussians, bool)
        motion = without(clip.motion(0, there), lost)
        poses, _, _ = conceal_group(clip, motion, 0, there, None, temporal_concealer("motion"))
        assert poses.concealed.any() == shown
        assert len(poses.tracks) == (COUNT if shown else COUNT - lost.sum())


def test_early_neighbour_search_equals_the_search_at_group_end(body):
    groups = []
    for smooth in (False, True):
        gathering = GroupBuilder(FRAMES, was_coherent=smooth)
        for frame in range(FRAMES):
            here = np.flatnonzero(there_at(frame))
            splats = splats_at(places(body, frame, 0.1), there_at(frame))
            gathering.add(TrackedFrame(splats.select(here), here))
        groups.append(gathering.group())
    for name, values in vars(groups[0].trajectories).items():
        assert np.array_equal(values, getattr(groups[1].trajectories, name))


def test_live_encoding_is_bit_identical_to_offline_encoding(body):
    """The last group ends early, after its frames were analysed."""
    streams = []
    for live in (False, True):
        encoder = SequenceEncoder(SequenceOptions(group_frames=4, order="tracked"), live=live)
        for frame in range(FRAMES - 1):
            encoder.push(splats_at(places(body, frame, 0.1), there_at(frame)))
        streams.append(encoder.finish())
    assert streams[0].packets == streams[1].packets
    assert streams[0].manifest == streams[1].manifest


@pytest.mark.parametrize("far", [1e20, 3e38])
def test_a_track_at_the_end_of_the_range_of_float32_is_not_coherent_with_the_others(far: float) -> None:
    rng, steps = np.random.default_rng(0), np.linspace(0, 1, 5, dtype=np.float32)[None, :, None]
    means = rng.normal(size=(200, 1, 3)).astype(np.float32) + steps
    begins, ends = np.where(np.arange(200) < 20, 2, 0), np.full(200, 5)
    begins[3:5] = 0
    means[3, 2:], means[4, 2:] = far, -far
    expected = means[:3, 2:3] - steps[:, 2:3] + steps
    means[:3, :2] = 0
    before = means[3:5].copy()
    assert extrapolate_partial_tracks(means, begins, ends, [], None)
    assert np.abs(means[:3] - expected).max() < 0.2
    assert np.array_equal(means[3:5], before)
