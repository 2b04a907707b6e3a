"""Scene cuts and empty frames: all, most or some Gaussians change, once or in every frame."""

import numpy as np
import pytest

from moving_sequences import cloud, darkened, drawn, errors, moving_frames, shuffled
from splatwire.codec import decode_stream
from splatwire.errors import InvalidValueError
from splatwire.sequence import SequenceEncoder, SequenceOptions, decode_frames, encode_sequence
from splatwire.sequence.matching import match
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow

COUNT = 800


def together(*parts: Splats) -> Splats:
    return Splats(*(np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])))


def moved(splats: Splats, way: float) -> Splats:
    shift = np.array([way, 0.0, 0.0], np.float32)
    return Splats(splats.means + shift, splats.quats, splats.scales, splats.opacities, splats.sh)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_new_gaussians_are_not_matched(share):
    stay = int(share * COUNT)
    kept = cloud(stay, 1) if stay else None
    others = [cloud(COUNT - stay, seed) for seed in (2, 3)]
    before, after = (together(kept, other) if kept else other for other in others)
    order = np.random.default_rng(4).permutation(COUNT)
    found = match(before, moved(after, 0.01).select(order))
    right, false = found.partner == order, (found.partner >= 0) & (order >= stay)
    assert right[order < stay].all()
    assert false.mean() < 0.03
    assert stay or found.share == 0


def test_unrelated_frames_are_coded_independently(caplog):
    frames = [cloud(COUNT, seed, size=1 + seed) for seed in range(4)]
    stream, tracking = encode_sequence(frames)
    clip = decode_stream(stream).scene
    assert clip.timeline.group_frames == 1
    assert "4 of the first 4 frames show another scene" in caplog.text
    assert (tracking.num_matched_frames, tracking.matched_share, tracking.num_births) == (3, 0.0, 3 * COUNT)
    motion = [packet for packet in stream.packets if not stream.manifest.plan.is_keyframe(packet.id.block)]
    assert sum(packet.num_bytes for packet in motion) < 0.01 * stream.num_bytes  # Gaussians that disappeared
    for frame, shown in zip(frames, decode_frames(clip), strict=True):
        assert len(shown.tracks) == COUNT
        assert np.quantile(errors(frame, shown.scene.splats), 0.95) < 0.5


def test_independent_frames_keep_the_packets_of_push():
    encoder = SequenceEncoder(SequenceOptions(group_frames=3))
    given = [encoder.push(cloud(COUNT, seed)) for seed in range(5)]
    stream = encoder.finish()
    assert [bool(packets) for packets in given] == [False, False, True, True, True]
    assert {p.id for packets in given for p in packets} == {p.id for p in stream.packets}


@pytest.mark.parametrize("group", [3, 4])
@pytest.mark.parametrize("live", [False, True])
def test_scene_cut_recomputes_precision_classes_unless_live(live, group):
    one, two = cloud(COUNT, 1, size=4.0), cloud(COUNT, 2, size=0.5)
    frames = [moved(one, 0.01 * n) for n in range(6)] + [moved(two, 0.005 * n) for n in range(6)]

    def encoded(second: int) -> tuple[list[Splats], list[Splats]]:
        looked: list[Splats] = []

        def classes(splats: Splats) -> np.ndarray:
            looked.append(splats)
            return np.full(splats.num_gaussians, second * (len(looked) - 1), np.int8)

        encoder = SequenceEncoder(SequenceOptions(group_frames=group), classes, live=live)
        for frame in frames:
            encoder.push(frame)
        clip = decode_stream(encoder.finish()).scene
        assert clip.timeline.group_frames == group
        return looked, [shown.scene.splats for shown in decode_frames(clip)]

    looked, fine = encoded(0)
    _, coarse = encoded(-4)
    expected = [one] if live else [one, two]
    assert all(
        np.array_equal(np.sort(a.sh, axis=0), np.sort(b.sh, axis=0)) for a, b in zip(looked, expected, strict=True)
    )
    off = [
        [np.median(errors(frame, splats)) for frame, splats in zip(frames, shown, strict=True)]
        for shown in (fine, coarse)
    ]
    assert max(off[0]) < 0.3
    before = 6 // group * group  # groups that contain both scenes share one fit
    assert off[1][:before] == off[0][:before]
    assert off[1][6:] == off[0][6:] if live else min(off[1][6:]) > 4 * max(off[0][6:])


@pytest.mark.parametrize("dark", [[0], [3], [5], [3, 4, 5], [2, 3, 4, 5, 6], [3, 4, 5, 6, 7, 8]])
@pytest.mark.parametrize("order", ["tracked", "shuffled"])
@pytest.mark.parametrize("group", [2, 3])
def test_clip_with_empty_frames_round_trips(dark, order, group):
    frames = darkened(moving_frames(300, 9), dark)
    frames = frames if order == "tracked" else shuffled(frames)
    clip = decode_stream(encode_sequence(frames, SequenceOptions(group_frames=group, order=order))[0]).scene
    for frame, shown in zip(frames, decode_frames(clip), strict=True):
        there = drawn(frame)
        assert len(shown.tracks) == there.num_gaussians
        assert not there.num_gaussians or np.median(errors(there, shown.scene.splats)) < 0.5


def test_clip_with_empty_first_frames_is_refused():
    with pytest.raises(InvalidValueError, match="no Gaussian that draws anything in the first frames"):
        encode_sequence(darkened(moving_frames(300, 9), range(3)), SequenceOptions(group_frames=3))
