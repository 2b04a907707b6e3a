"""Shots: lattice, steps and context tables that change at scene cuts."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from moving_sequences import cloud, cut_frames, drawn, errors, moving_frames
from splatwire.bitstream import Packet, SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.gaussians.side_info import write_header
from splatwire.codec.sequence.layout import MAX_SPACING
from splatwire.codec.sequence.side_info import SequenceInfo, Shot, open_side_info, write_side_info
from splatwire.errors import BitstreamError
from splatwire.sequence import SequenceDecoder, SequenceEncoder, SequenceOptions, decode_frames, encode_sequence

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
    assert len({write_header(shot.info) for shot in shots}) == 3


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
    """The side information with a second shot that begins with group `first` and has other `fields`."""
    one, two, three = info.shots
    return replace(info, shots=(one, Shot(first, two.first_block, replace(two.info, **fields)), three))


def with_spacing(info: SequenceInfo, spacing: int) -> SequenceInfo:
    """The side information with a second shot whose lattice is coarser by some octaves than the first one's."""
    level = info.keyframes.size_log - info.keyframes.unit + spacing
    return changed(info, size_log=max(level, 0), unit=max(-level, 0))


def test_impossible_shots_are_refused(stream):
    info = info_of(stream)
    shot = info.shots[1].info
    whole = {"degree": 1, "transform": np.zeros((3, 3), np.int64)}
    for bad, message in [
        (changed(info, first=2), "divide"),
        (changed(info, first=0), "divide"),
        (replace(info, shots=info.shots[1:]), "divide"),
        (replace(info, shots=(*info.shots, Shot(3, 0, shot))), "divide"),
        (with_spacing(info, -MAX_SPACING - 1), "lattice"),
        (with_spacing(info, MAX_SPACING + 1), "lattice"),
        (changed(info, **whole), "degree"),
    ]:
        with pytest.raises(BitstreamError, match=message):
            open_side_info(stream.manifest, write_side_info(bad))


@pytest.mark.parametrize("spacing", [-MAX_SPACING, MAX_SPACING])
def test_extreme_lattices_decode_to_finite_frames(stream, spacing):
    info = info_of(stream)
    decoder = SequenceDecoder(stream.manifest, write_side_info(with_spacing(info, spacing)))
    for packet in stream.packets[:-1]:  # complete integers would not match the digest
        decoder.push(packet)
    for number in range(3 * FRAMES):
        assert np.isfinite(decoder.frame(number).scene.splats.means).all()


def test_unmatched_frames_of_one_size_share_a_lattice():
    frames = [cloud(COUNT, seed) for seed in range(3)]
    shots = info_of(encode_sequence(frames)[0]).shots
    assert len({write_header(shot.info) for shot in shots}) == 1
