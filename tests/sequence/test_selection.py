"""Selection of the way to cover lost tracks, by cross-validation on received tracks."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from close import unit
from random_numbers import Numbers
from splatwire.channel import parse_loss
from splatwire.codec import decode_stream
from splatwire.concealment.temporal.concealers import ConcealedMotion
from splatwire.concealment.temporal.concealment import conceal_group
from splatwire.concealment.temporal.selection import select
from splatwire.errors import InvalidValueError
from splatwire.evaluation.sequence.evaluation import SequenceRow, score_sequence
from splatwire.render.importance import surrounding_cameras
from splatwire.sequence import Frame, SequenceOptions, encode_sequence
from splatwire.sequence.decoding import covering_gains
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

COUNT, FRAMES = 400, 4
MADE = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "shuffled_clips.py"))


@pytest.fixture(scope="module")
def clip():
    """Sparse Gaussians that move to the right by a tenth of a unit per frame."""
    rng = Numbers(4)
    means, quats, colours = rng.randn(COUNT, 3) * 5, unit(rng.randn(COUNT, 4)), rng.rand(COUNT, 1, 3)
    scales, opacities = np.full((COUNT, 3), 0.1), np.full(COUNT, 0.9)
    frames = [Splats(means + np.array([0.1 * f, 0, 0]), quats, scales, opacities, colours) for f in range(FRAMES)]
    frames = [Splats(*(np.ascontiguousarray(v, np.float32) for v in vars(s).values())) for s in frames]
    return decode_stream(encode_sequence(map(Frame.of, frames), SequenceOptions(group_frames=FRAMES))[0]).scene


def received(clip, lost):
    """Motion of the first group without some tracks."""
    motion = clip.motion(0, np.ones(COUNT, bool))
    keep = ~lost[motion.tracks]
    return replace(
        motion, tracks=motion.tracks[keep], moving=motion.moving[keep], begins=motion.begins[keep],
        ends=motion.ends[keep], at=lambda frame: motion.at(frame)[keep], covered=motion.covered & ~lost, complete=False,
    )  # fmt: skip


def concealed(clip, lost, at, shown=True):
    """Result of `conceal_group` with the concealer `at`; and the arguments that the concealer got."""
    got = []

    def call(self, arguments):
        got.append(arguments)
        return ConcealedMotion(at(arguments), shown)

    method = type("Mine", (), {"name": "mine", "grow": True, "__call__": call})()
    there = np.ones(clip.num_gaussians, bool)
    return conceal_group(clip, received(clip, lost), 0, there, None, method), got[0]


def candidate(clip, error):
    """Estimator that returns the true motion plus an error for each track, (T, 3)."""
    motion = clip.motion(0, np.ones(COUNT, bool))

    def estimate(_arrived, tracks):
        def at(frame, _offsets):
            offsets = motion.at(frame)[np.searchsorted(motion.tracks, tracks)].copy()
            offsets[:, :3] += error[tracks]
            return offsets

        return at

    return estimate


def test_best_way_is_selected_in_each_region(clip):
    lost = np.arange(COUNT) % 5 == 0
    _, arguments = concealed(clip, lost, lambda a: lambda f, o: np.zeros((len(a.tracks), 13), np.float32))
    x = clip.tracks.splats.means[:, :1]
    errors = [np.where(x < 1, 0, 3.0) + np.zeros(3), np.where(x > -1, 0, 3.0) + np.zeros(3)]
    far = np.full((COUNT, 3), 3.0)
    tracks, before = arguments.tracks, arguments.before

    def chosen(*wrong):
        return select(
            clip, 0, arguments.arrived, tracks, before, [candidate(clip, error) for error in wrong],
            grow=True,
        )  # fmt: skip

    assert (chosen(0 * far, far) == 0).all()
    assert (chosen(far, 0 * far) == 1).all()
    assert (chosen(far, far) == 2).all(), "a wrong place is worse than a hole"
    sides = chosen(*errors)
    assert (sides[x[tracks, 0] < -4] == 0).all()
    assert (sides[x[tracks, 0] > 4] == 1).all()


def test_few_received_tracks_give_the_first_way(clip):
    lost = np.arange(COUNT) >= 10
    _, arguments = concealed(clip, lost, lambda a: lambda f, o: np.zeros((len(a.tracks), 13), np.float32))
    far = candidate(clip, np.full((COUNT, 3), 3.0))
    assert not select(clip, 0, arguments.arrived, arguments.tracks, arguments.before, [far, far], grow=True).any()


def test_holes_that_nothing_covers_count_fully(clip):
    lost = np.arange(COUNT) % 5 == 0
    _, arguments = concealed(clip, lost, lambda a: lambda f, o: np.zeros((len(a.tracks), 13), np.float32))
    shares = []
    for grow in (True, False):
        near = candidate(clip, np.full((COUNT, 3), 0.097))  # between the error of a hole and that of a covered hole
        found = select(clip, 0, arguments.arrived, arguments.tracks, arguments.before, [near, near], grow=grow)
        shares.append((found == 2).mean())
    assert shares[0] > shares[1]


def test_hidden_tracks_are_covered_by_their_neighbours(clip):
    lost = np.arange(COUNT) % 5 == 0
    zero = lambda a: lambda f, o: np.zeros((len(a.tracks), 13), np.float32)  # noqa: E731
    half = np.arange(int(lost.sum())) % 2 == 0
    (poses, hidden, _), _ = concealed(clip, lost, zero, half)
    assert np.array_equal(hidden.tracks, np.flatnonzero(lost)[~half])
    assert np.array_equal(np.union1d(poses.tracks, hidden.tracks), np.arange(COUNT))
    gains = covering_gains(clip, np.ones(COUNT, bool), 0, poses, hidden)
    assert (gains.opacity_gain[poses.tracks] >= 1).all()
    assert gains.opacity_gain[poses.tracks].mean() > 1
    (poses, hidden, _), _ = concealed(clip, lost, zero)
    assert covering_gains(clip, np.ones(COUNT, bool), 0, poses, hidden) is None


def test_mask_of_wrong_shape_is_one_error_sentence(clip):
    lost = np.arange(COUNT) % 5 == 0
    with pytest.raises(InvalidValueError, match=r"returned a mask of shape \(3,\) and type bool for 80 tracks"):
        concealed(clip, lost, lambda a: lambda f, o: np.zeros((len(a.tracks), 13), np.float32), np.ones(3, bool))


@pytest.mark.slow
@pytest.mark.parametrize("name", list(MADE["CLIPS"]))
def test_motion_is_no_worse_than_hiding_or_holding_on_generated_clips(name):
    frames = [Frame.of(one) for one in MADE["shuffled_frames"](name, count=800, frames=8)]
    stream, _ = encode_sequence(frames, SequenceOptions(group_frames=4))
    cameras = surrounding_cameras(SplatScene(frames[0].splats), 1, 64)
    rows = [SequenceRow(way, parse_loss("bernoulli:0.2"), 1) for way in ("motion", "drop", "hold")]
    best, *others = (score.mean for score in score_sequence(stream, frames, cameras, rows))
    assert best >= max(others) - 0.1


def test_generated_clips_are_reproducible_and_shuffled():
    for name in MADE["CLIPS"]:
        first, again = ([*MADE["shuffled_frames"](name, count=50, frames=2)] for _ in range(2))
        assert all(np.array_equal(a.means, b.means) for a, b in zip(first, again, strict=True))
    for name in ("waves", "cloth", "dancer"):  # the same Gaussians in each frame
        one, other = ([*map(tuple, s.sh[:, 0].tolist())] for s in MADE["shuffled_frames"](name, count=50, frames=2))
        assert one != other
        assert sorted(one) == sorted(other)
