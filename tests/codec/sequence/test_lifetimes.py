"""Lifetimes of tracks are transmitted separately from their motion."""

import itertools
from fractions import Fraction

import numpy as np
import pytest

from moving_sequences import FRAMES, moving_frames
from splatwire.bitstream import SceneStream
from splatwire.codec import decode_stream
from splatwire.codec.sequence import encoder
from splatwire.codec.sequence.lifetimes import (
    PACKET_BYTES_PER_LIFETIME,
    SECTION,
    Lifetimes,
    lifetimes_sections,
    read_lifetimes,
)
from splatwire.codec.sequence.side_info import open_side_info
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteWriter
from splatwire.sequence import Frame, SequenceOptions, decode_frames, encode_sequence
from splatwire.types.sequence_scene import Timeline

GROUP = 4
TIME = Timeline(Fraction(30), 11, GROUP)
BIRTHS = [7, 2, 4]


def some(*tracks: int) -> np.ndarray:
    return np.array(tracks, np.int64)


def test_lifetimes_round_trip():
    parts = [
        Lifetimes(some(3), some(2), some(1, 4), some(1, 4)), Lifetimes(some(8), some(1), some(3, 6), some(5, 8)),
        Lifetimes(some(9, 12), some(1, 2), some(10), some(9)),
    ]  # fmt: skip
    begins, ends = read_lifetimes(lifetimes_sections(Lifetimes.joined(parts)), BIRTHS, TIME).by_track(13, 11)
    assert begins.tolist() == [0, 0, 0, 2, 0, 0, 0, 0, 1, 1, 0, 0, 2]
    assert ends.tolist() == [11, 1, 11, 5, 4, 11, 8, 11, 11, 11, 9, 11, 11]
    none = Lifetimes.joined([])
    assert lifetimes_sections(none) == {}
    assert [values.tolist() for values in read_lifetimes({}, BIRTHS, TIME).by_track(13, 11)] == [[0] * 13, [11] * 13]


def test_most_visible_lifetimes_are_kept():
    lifetimes = Lifetimes(some(1, 5), some(1, 1), some(5, 7, 9), some(4, 5, 6))
    kept = lifetimes.without_least_visible(np.arange(13.0), 2)
    assert (kept.begin_tracks.tolist(), kept.end_tracks.tolist()) == ([], [7, 9])
    kept = lifetimes.without_least_visible(-np.arange(13.0), 2)
    assert (kept.begin_tracks.tolist(), kept.end_tracks.tolist(), kept.end_frames.tolist()) == ([1, 5], [5], [4])


def section(*lists: list[tuple[int, int]]) -> bytes:
    writer = ByteWriter()
    for pairs in lists:
        writer.unsigned(len(pairs))
        for value in itertools.chain(*pairs):
            writer.unsigned(value)
    return writer.bytes()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (section([(13, 1)], []), "not in the clip"),
        (section([], [(0, 12)]), "not in the clip"),
        (section([(0, 4)], []), "before it begins"),
        (section([], [(7, 4)]), "before it begins"),
        (section([(0, 2)], [(0, 2)]), "before it begins"),
        (section([(9, 3)], []), "before it begins"),
        (section([], [])[:1], SECTION),
        (section([], []) + b"\0", SECTION),
    ],
)
def test_impossible_lifetimes_are_refused(content, words):
    with pytest.raises(BitstreamError, match=words):
        read_lifetimes({SECTION: content}, BIRTHS, TIME)


def clip() -> SceneStream:
    return encode_sequence(map(Frame.of, moving_frames(2000)), SequenceOptions(group_frames=GROUP))[0]


def without_motion(stream: SceneStream) -> SceneStream:
    return stream.with_packets(p for p in stream.packets if stream.manifest.plan.is_keyframe(p.id.block))


def test_lifetimes_do_not_depend_on_motion_packets(monkeypatch):
    """All motion is lost, and exactly the existing tracks are drawn in every frame, also after a seek."""
    monkeypatch.setattr(encoder, "PACKET_BYTES_PER_LIFETIME", 1)
    stream = clip()
    lossy, complete = decode_stream(without_motion(stream)).scene, decode_stream(stream).scene
    for first in (0, FRAMES - 1):
        pairs = zip(decode_frames(lossy, first=first), decode_frames(complete, first=first), strict=True)
        for frame, whole in pairs:
            assert frame.tracks.tolist() == whole.tracks.tolist()
            assert frame.concealed.all()


def test_lifetimes_section_is_a_small_share_of_the_stream():
    stream = clip()
    content = open_side_info(stream.manifest, stream.side_info).sections[SECTION]
    assert 4 < len(content) < sum(packet.num_bytes for packet in stream.packets) * 3.2 / PACKET_BYTES_PER_LIFETIME
