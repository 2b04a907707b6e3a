"""Shots: lattice, steps and context tables that change at scene cuts."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from moving_sequences import cloud, cut_frames, drawn, errors, lasting_frames, moving_frames
from splatwire.bitstream import Packet, SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.gaussians.side_info import write_header
from splatwire.codec.sequence.layout import MAX_COORD, MAX_LOG2_RATIO, NUM_CHANNELS
from splatwire.codec.sequence.side_info import SequenceInfo, Shot, open_side_info, write_side_info
from splatwire.codec.sequence.steps import in_other_units
from splatwire.errors import BitstreamError
from splatwire.sequence import SequenceDecoder, SequenceEncoder, SequenceOptions, decode_frames, encode_sequence
from splatwire.types.splats import Splats

pytestmark = pytest.mark.slow
COUNT, FRAMES = 600, 4
OPTIONS = SequenceOptions(group_frames=FRAMES)


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    """Three scenes in one group of frames each."""
    return encode_sequence(cut_frames(COUNT, FRAMES, [1.0, 0.02, 30.0]), OPTIONS)[0]


def info_of(stream: SceneStream) -> SequenceInfo:
    return open_side_info(stream.manifest, stream.side_info)


def test_scenes_of_other_sizes_get_shots_of_their_own(stream):
    shots = info_of(stream).shots
    assert [shot.first_group for shot in shots] == [0, 1, 2]
    assert len({write_header(shot.keyframe_info) for shot in shots}) == 3


def test_frames_of_all_shots_decode_precisely(stream):
    frames = cut_frames(COUNT, FRAMES, [1.0, 0.02, 30.0])
    for frame, shown in zip(frames, decode_frames(decode_stream(stream).scene), strict=True):
        assert np.quantile(errors(drawn(frame), shown.scene.splats), 0.95) < 0.5


def test_scene_after_a_cut_takes_the_bytes_of_a_first_scene(stream):
    frames = cut_frames(COUNT, FRAMES, [1.0, 0.02, 30.0])
    alone = [encode_sequence(frames[n : n + FRAMES], OPTIONS)[0] for n in range(0, len(frames), FRAMES)]
    assert stream.num_bytes < 1.02 * sum(part.num_bytes for part in alone)


def test_keyframes_after_a_cut_equal_those_of_a_first_scene(stream):
    """Lattice and steps are fitted as at the start, so the decoded Gaussians are the same."""
    frames = cut_frames(COUNT, FRAMES, [1.0, 0.02, 30.0])[FRAMES : 2 * FRAMES]
    alone = decode_stream(encode_sequence(frames, OPTIONS)[0]).scene.tracks.splats
    tracks = decode_stream(stream).scene.tracks
    again = tracks.splats.select(np.flatnonzero(tracks.born == 1))
    assert np.array_equal(alone.means, again.means)
    assert np.array_equal(alone.scales, again.scales)


def worst(frames: list[Splats], stream: SceneStream) -> float:
    """The 95th percentile of the errors, in the worst frame."""
    shown = decode_frames(decode_stream(stream).scene)
    found = zip(frames, shown, strict=True)
    return max(float(np.quantile(errors(drawn(frame), one.scene.splats), 0.95)) for frame, one in found)


@pytest.mark.parametrize("sizes", [[1.0, 1 / 300, 1.0], [1.0, 1 / 5000, 1.0], [1 / 300, 1.0]])
def test_motion_of_far_smaller_scenes_is_kept(sizes):
    """In units of the first scene, the motion of a scene 5000 times smaller is off by two sizes of its Gaussians."""
    frames = cut_frames(COUNT, FRAMES, sizes)
    stream = encode_sequence(frames, OPTIONS)[0]
    assert worst(frames, stream) < 0.25
    assert write_side_info(info_of(stream)) == stream.side_info


def test_scene_that_is_cut_within_a_group_gets_a_shot_of_its_own():
    frames = cut_frames(COUNT, FRAMES + 2, [1.0, 1 / 300])
    stream = encode_sequence(frames, OPTIONS)[0]
    assert [shot.first_group for shot in info_of(stream).shots] == [0, 1]
    assert worst(frames, stream) < 0.25


@pytest.mark.parametrize("sizes", [[1.0, 1 / 300, 1.0], [1.0, 1 / 5000, 1.0]])
def test_tracks_move_on_through_shots_with_other_units(sizes):
    frames = lasting_frames(FRAMES, sizes)
    stream = encode_sequence(frames, OPTIONS)[0]
    info = info_of(stream)
    assert len({shot.log2_motion_unit for shot in info.shots}) == 2
    assert sum(group.num_births for group in info.groups) < 300 * len(sizes) + 45, "lasting tracks have one base"
    assert worst(frames, stream) < 0.3


@pytest.mark.parametrize(("speed", "stands"), [(0.0, False), (100.0, True)])
def test_tracks_too_fast_for_the_units_after_a_cut_are_static_with_a_warning(caplog, speed, stands):
    frames = lasting_frames(FRAMES, [1.0, 2e-6], lasting=40)
    for number in range(FRAMES, 2 * FRAMES):
        frames[number].means[:40, 0] += speed * (number - FRAMES)
    shown = decode_frames(decode_stream(encode_sequence(frames, OPTIONS)[0]).scene)
    after = [frame.scene.splats.means for frame in shown][FRAMES:]
    first, *later = (means[np.abs(means).max(axis=1) > 1e-4] for means in after)  # the new scene is far smaller
    assert all(len(means) >= 39 for means in [first, *later])  # one of them disappears
    assert all(np.isin(means, first).all() for means in later) == stands
    assert ("40 Gaussians of the scene before a cut stand still in the 4 frames" in caplog.text) == stands


def test_units_change_without_loss_to_finer_ones_and_back():
    places = np.array([[5, -7, 1 << 40], [0, 1, -1]])
    shifts = np.full((2, NUM_CHANNELS), 4)
    finer = in_other_units(places, shifts, np.array([6, 0]))
    assert finer[0].tolist() == [[320, -448, 1 << 46], [0, 1, -1]]
    assert finer[1][:, 0].tolist() == [10, 4]
    assert (finer[1][:, 3:] == 4).all()
    back = in_other_units(*finer, np.array([-6, 0]))
    assert np.array_equal(back[0], places)
    assert np.array_equal(back[1], shifts)
    mixed = in_other_units(places, shifts, np.array([-3, 20]))[0]
    assert mixed.tolist() == [[0, -1, 1 << 37], [0, 1 << 20, -(1 << 20)]]
    assert np.abs(in_other_units(places, shifts, np.array([40, 40]))[0]).max() == MAX_COORD


def test_shots_of_like_sizes_keep_version_2_and_others_take_version_3(stream):
    alike = encode_sequence(cut_frames(COUNT, FRAMES, [1.0, 8.0]), OPTIONS)[0]
    assert alike.side_info[1] == 2
    assert stream.side_info[1] == 3
    assert info_of(stream).log2_motion_units[1] < -3


def test_sequence_without_another_lattice_keeps_version_1():
    frames = moving_frames(300, 8)
    stream = encode_sequence(frames, OPTIONS)[0]
    assert len(info_of(stream).shots) == 1
    assert stream.side_info[1] == 1


def test_live_sequence_has_one_shot():
    encoder = SequenceEncoder(OPTIONS, live=True)
    for frame in cut_frames(COUNT, FRAMES, [1.0, 0.02]):
        encoder.push(frame)
    assert len(info_of(encoder.finish()).shots) == 1


def test_packets_that_arrive_in_any_order_give_the_same_frames(stream):
    def frames(packets: Iterable[Packet]) -> list[np.ndarray]:
        decoder = SequenceDecoder(stream.manifest, stream.side_info)
        for packet in packets:
            decoder.push(packet)
        return [decoder.frame(number).scene.splats.means for number in range(3 * FRAMES)]

    for some, others in zip(frames(stream.packets), frames(reversed(stream.packets)), strict=True):
        assert np.array_equal(some, others)


def test_side_information_round_trips(stream):
    info = info_of(stream)
    assert write_side_info(info) == stream.side_info


def changed(info: SequenceInfo, first: int = 1, **fields: Any) -> SequenceInfo:
    """Side information with a second shot that begins with group `first` and has other `fields`."""
    one, two, three = info.shots
    return replace(info, shots=(one, Shot(first, two.first_block, replace(two.keyframe_info, **fields)), three))


def with_lattice(info: SequenceInfo, octaves: int) -> SequenceInfo:
    """Side information with a second shot on a position lattice that is some octaves coarser than the first one's."""
    level = info.keyframe_info.size_log - info.keyframe_info.lattice_bits + octaves
    return changed(info, size_log=max(level, 0), lattice_bits=max(-level, 0))


def with_unit(info: SequenceInfo, number: int, octaves: int) -> SequenceInfo:
    """The side information with another unit of motion for a shot."""
    shots = list(info.shots)
    shots[number] = replace(shots[number], log2_motion_unit=octaves)
    return replace(info, shots=tuple(shots))


def test_impossible_shots_are_refused(stream):
    info = info_of(stream)
    shot = info.shots[1].keyframe_info
    whole = {"degree": 1, "transform": np.zeros((3, 3), np.int64)}
    for bad, message in [
        (changed(info, first=2), "divide"),
        (changed(info, first=0), "divide"),
        (replace(info, shots=info.shots[1:]), "divide"),
        (replace(info, shots=(*info.shots, Shot(3, 0, shot))), "divide"),
        (with_lattice(info, -MAX_LOG2_RATIO - 1), "lattice"),
        (with_lattice(info, MAX_LOG2_RATIO + 1), "lattice"),
        (changed(info, **whole), "degree"),
        (with_unit(info, 0, MAX_LOG2_RATIO + 1), "unit of motion"),
        (with_unit(info, 1, MAX_LOG2_RATIO - 4), "unit of motion"),  # the lattice is 5 octaves finer
        (with_unit(info, 2, -MAX_LOG2_RATIO - 1), "unit of motion"),
        (with_unit(info, 2, 1 << 50), "unit of motion"),
    ]:
        with pytest.raises(BitstreamError, match=message):
            open_side_info(stream.manifest, write_side_info(bad))


@pytest.mark.parametrize("octaves", [-MAX_LOG2_RATIO, MAX_LOG2_RATIO])
def test_extreme_lattices_decode_to_finite_frames(stream, octaves):
    info = info_of(stream)
    decoder = SequenceDecoder(stream.manifest, write_side_info(with_lattice(info, octaves)))
    for packet in stream.packets[:-1]:  # complete integers would not match the digest
        decoder.push(packet)
    for number in range(3 * FRAMES):
        assert np.isfinite(decoder.frame(number).scene.splats.means).all()


@pytest.mark.parametrize("units", [(-MAX_LOG2_RATIO, 15, -15), (MAX_LOG2_RATIO, -MAX_LOG2_RATIO, 15)])
def test_extreme_units_decode_to_finite_frames(stream, units):
    info = info_of(stream)
    for number, octaves in enumerate(units):
        info = with_unit(info, number, octaves)
    decoder = SequenceDecoder(stream.manifest, write_side_info(info))
    for packet in stream.packets[:-1]:
        decoder.push(packet)
    for number in range(3 * FRAMES):
        assert np.isfinite(decoder.frame(number).scene.splats.means).all()


@pytest.mark.parametrize(("live", "size"), [(True, 1e-3), (True, 1e-7), (False, 1e-7)])
def test_scenes_too_small_for_the_lattice_give_a_warning(caplog, live, size):
    encoder = SequenceEncoder(OPTIONS, live=live)
    for frame in cut_frames(COUNT, FRAMES, [1.0, size]):
        encoder.push(frame)
    encoder.finish()
    assert "smaller than" in caplog.text
    assert "of 601 new Gaussians" in caplog.text


def test_unmatched_frames_of_one_size_share_a_lattice():
    frames = [cloud(COUNT, seed) for seed in range(3)]
    shots = info_of(encode_sequence(frames)[0]).shots
    assert len({write_header(shot.keyframe_info) for shot in shots}) == 1
