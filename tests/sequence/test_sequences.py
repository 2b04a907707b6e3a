"""Clips are encoded, transmitted with losses and decoded frame by frame."""

import logging
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from moving_sequences import FRAMES, drawn, moving_frames, shuffled
from splatwire.bitstream import PRESETS, SceneStream, make_packet, read_stream, write_stream
from splatwire.channel import parse_loss
from splatwire.channel.transmit import transmit
from splatwire.codec import decode_stream, encode_scene, memory
from splatwire.concealment.temporal.motion_prediction import started_share
from splatwire.errors import (
    BitstreamError,
    DatasetError,
    InvalidValueError,
    MissingSideInfoError,
    SplatwireError,
    UnknownNameError,
)
from splatwire.evaluation.sequence.evaluation import SequenceRow, SequenceScore
from splatwire.io.formats import write_splats
from splatwire.sequence import (
    Frame,
    SequenceDecoder,
    SequenceEncoder,
    SequenceOptions,
    decode_frame,
    decode_frames,
    encode_sequence,
    frame_files,
)
from splatwire.types import SplatScene
from splatwire.types.splats import Splats

OPTIONS = SequenceOptions(Fraction(25), group_frames=4, quality="near-lossless")


@pytest.fixture(scope="module")
def frames() -> list[Splats]:
    return moving_frames()


@pytest.fixture(scope="module")
def stream(frames: list[Splats]) -> SceneStream:
    return encode_sequence(frames, OPTIONS)[0]


def error(found: Splats, wanted: Splats) -> float:
    """Largest distance between a Gaussian and its match among the expected ones."""
    apart = cdist(found.means, wanted.means)
    distance, index = apart.min(axis=1), apart.argmin(axis=1)
    assert found.num_gaussians == wanted.num_gaussians == len(set(index.tolist()))
    return float(distance.max())


def test_every_frame_is_decoded(frames, stream):
    shown = list(decode_frames(decode_stream(stream).scene))
    assert [frame.number for frame in shown] == list(range(FRAMES))
    for frame, wanted in zip(shown, frames, strict=True):
        assert error(frame.scene.splats, drawn(wanted)) < 0.02
        assert not frame.concealed.any()


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_precision_does_not_depend_on_the_unit_of_length(frames, factor):
    def scaled(one: Splats) -> Splats:
        return replace(one, means=one.means * np.float32(factor), scales=one.scales * np.float32(factor))

    stream, _ = encode_sequence([scaled(frame) for frame in frames], OPTIONS)
    shown = list(decode_frames(decode_stream(stream).scene))
    for frame, wanted in zip(shown, frames, strict=True):
        assert error(frame.scene.splats, scaled(drawn(wanted))) < 0.02 * factor


def test_frames_far_from_the_first_one_give_one_warning(frames, caplog):
    origin = (451234.0, 5411876.0, 118.0)
    encode_sequence([Frame.of(frame, origin=origin) for frame in frames[:4]], OPTIONS)
    near = (origin[0] + 50, *origin[1:])
    moved = [Frame.of(frame, origin=near if number else origin) for number, frame in enumerate(frames[:4])]
    encode_sequence(moved, OPTIONS)
    assert not caplog.text
    encode_sequence(
        [Frame.of(frame, origin=(0.0, 0.0, 0.0) if n in (1, 2) else origin) for n, frame in enumerate(frames[:4])],
        OPTIONS,
    )
    assert caplog.text.count("from the origin of the sequence (451234 5411876 118)") == 1
    assert "frame 1: 100 % of the Gaussians are up to 5.41" in caplog.text


@pytest.mark.parametrize("first", [False, True])
def test_frames_with_and_without_antialiasing_give_one_warning(frames, first, caplog):
    stream, _ = encode_sequence([Frame.of(frame, antialiased=first) for frame in frames[:4]], OPTIONS)
    assert not caplog.text
    mixed = [Frame.of(frame, antialiased=first == (number == 0)) for number, frame in enumerate(frames[:4])]
    stream, _ = encode_sequence(mixed, OPTIONS)
    assert decode_stream(stream).scene.antialiased == first
    assert caplog.text.count("all frames are drawn as the first one") == 1


def test_clip_round_trips_through_a_file(stream, tmp_path):
    write_stream(stream, tmp_path / "clip.swz")
    again, report = read_stream(tmp_path / "clip.swz")
    assert again.manifest == stream.manifest
    assert again.packets == stream.packets
    assert report.num_missing == 0
    assert again.manifest.format_version == 3
    decode_stream(again)  # also compares its digest


def test_static_gaussians_have_no_motion_bytes():
    still, _ = encode_sequence(moving_frames(still=True), OPTIONS)
    one, _ = encode_sequence(moving_frames(still=True)[:1], OPTIONS)
    assert len(still.packets) == len(one.packets)
    assert still.num_bytes - one.num_bytes < 60


def test_encoding_frame_by_frame_gives_the_same_packets(frames, stream):
    encoder = SequenceEncoder(OPTIONS)
    pushed = [encoder.push(frame) for frame in frames]
    assert [bool(packets) for packets in pushed] == [(number + 1) % 4 == 0 for number in range(FRAMES)]
    whole = encoder.finish()
    early = {(p.id, p.payload) for packets in pushed for p in packets}
    assert early <= {(p.id, p.payload) for p in whole.packets} == {(p.id, p.payload) for p in stream.packets}


def test_decoder_keeps_packets_instead_of_decoded_motion(stream, monkeypatch):
    """Decoded motion takes many times its coded bytes, so packets are decoded again on demand."""
    inner = SequenceDecoder(stream.manifest, stream.side_info)._decoder._decoder
    monkeypatch.setattr(memory, "FREE_BYTES", inner.working_bytes(stream.packets))
    monkeypatch.setattr(memory, "BYTES_PER_BYTE", 0)
    decoder = SequenceDecoder(stream.manifest, stream.side_info)
    for packet in stream.packets:
        decoder.push(packet)
    assert decoder.complete
    monkeypatch.setattr(memory, "FREE_BYTES", inner.scene_bytes - 1)
    with pytest.raises(BitstreamError, match="all tracks"):
        decoder.frame(0)


@pytest.mark.parametrize("seed", range(2))
def test_decoding_packet_by_packet_gives_the_same_frames(stream, seed):
    decoder = SequenceDecoder(stream.manifest, stream.side_info)
    order = np.random.default_rng(seed).permutation(len(stream.packets))
    for count, number in enumerate(order.tolist()):
        decoder.push(stream.packets[number])
        if count == len(order) // 2:
            assert decoder.frame(5).scene.num_elements > 0
    assert decoder.complete
    for frame in decode_frames(decode_stream(stream).scene):
        now = decoder.frame(frame.number)
        assert np.array_equal(now.tracks, frame.tracks)
        assert np.array_equal(now.scene.splats.means, frame.scene.splats.means)


def test_still_scene_is_refused_as_a_clip():
    still = encode_scene(SplatScene(moving_frames()[0]), PRESETS["datagram"])
    with pytest.raises(BitstreamError, match="not a clip"):
        SequenceDecoder(still.manifest, still.side_info)


def test_stream_does_not_depend_on_the_number_of_threads(frames, stream):
    assert encode_sequence(frames, SequenceOptions(Fraction(25), 4, quality="near-lossless", threads=1))[0] == stream


@pytest.mark.parametrize("seed", range(3))
def test_received_tracks_equal_those_of_the_complete_clip(stream, seed):
    rng, plan = np.random.default_rng(seed), stream.manifest.plan
    kept = [p for p in stream.packets if plan.is_keyframe(p.id.block) or rng.random() < 0.5]
    assert len(kept) < len(stream.packets)
    complete, lossy = (decode_frames(decode_stream(s).scene) for s in (stream, stream.with_packets(kept)))
    lost = 0
    for whole, some in zip(complete, lossy, strict=True):
        arrived = np.flatnonzero(~some.concealed)
        both = np.searchsorted(whole.tracks, some.tracks[arrived])
        assert np.array_equal(whole.tracks[both], some.tracks[arrived])
        assert np.array_equal(whole.scene.splats.means[both], some.scene.splats.means[arrived])
        assert np.array_equal(whole.scene.splats.sh[both], some.scene.splats.sh[arrived])
        lost += int(some.concealed.sum())
    assert lost


def test_motion_without_its_keyframe_gaussian_is_concealed(stream):
    plan = stream.manifest.plan
    bases = [p for p in stream.packets if plan.is_keyframe(p.id.block)]
    clip = decode_stream(stream.with_packets(p for p in stream.packets if p != bases[0])).scene
    shown = decode_frame(clip, 0)
    assert shown.scene.num_elements == int(clip.tracks.received[clip.tracks.born == 0].sum())
    assert shown.concealed.any()


def test_seek_decodes_one_group(stream):
    clip = decode_stream(stream).scene
    for frame in decode_frames(clip):
        alone = decode_frame(clip, frame.number)
        assert np.array_equal(alone.tracks, frame.tracks)
        assert np.array_equal(alone.scene.splats.means, frame.scene.splats.means)
    with pytest.raises(InvalidValueError, match="the clip has the frames 0 to 9, not 10"):
        decode_frame(clip, FRAMES)


def test_shuffled_frames_are_matched(frames):
    found, tracking = encode_sequence(shuffled(frames), OPTIONS)
    assert tracking.num_matched_frames == FRAMES - 1
    assert tracking.matched_share > 0.97
    assert sum(tier.num_elements for tier in found.manifest.tiers[::2]) < 1.05 * frames[0].num_gaussians
    for frame, wanted in zip(decode_frames(decode_stream(found).scene), frames, strict=True):
        assert error(frame.scene.splats, drawn(wanted)) < 0.02


def test_keyframe_packets_are_retransmitted_and_motion_packets_are_not(stream):
    lossy, record = transmit(stream, parse_loss("bernoulli:0.5", "datagram"), seed=1)
    plan = stream.manifest.plan
    lost = set(stream.packets) - set(lossy.packets)
    assert lost
    assert not any(plan.is_keyframe(packet.id.block) for packet in lost)
    assert record.num_lost == len(lost)


@pytest.mark.parametrize("method", ["hold", "extrapolate", "neighbors", "motion"])
def test_tracks_with_lost_motion_are_still_drawn(frames, stream, method):
    lossy, _ = transmit(stream, parse_loss("bernoulli:0.3", "datagram"), seed=2)
    for frame, whole in zip(
        decode_frames(decode_stream(lossy).scene, method), decode_frames(decode_stream(stream).scene), strict=True
    ):
        assert np.isin(whole.tracks[:500], frame.tracks).mean() > 0.97


@pytest.mark.slow
def test_motion_concealment_is_better_than_keeping_the_last_position():
    stream, _ = encode_sequence(moving_frames(4000), OPTIONS)
    lossy, _ = transmit(stream, parse_loss("bernoulli:0.3", "datagram"), seed=2)
    clip, whole = decode_stream(lossy).scene, decode_stream(stream).scene

    def squares(method: str) -> float:
        total = 0.0
        for frame, true in zip(decode_frames(clip, method), decode_frames(whole), strict=True):
            both, here, there = np.intersect1d(frame.tracks, true.tracks, return_indices=True)
            assert len(both)
            total += float(((frame.scene.splats.means[here] - true.scene.splats.means[there]) ** 2).sum())
        return total

    assert 0 < squares("motion") < squares("neighbors") < 0.2 * squares("hold")


@pytest.mark.needs_torch
def test_unknown_concealer_is_named(stream):
    with pytest.raises(UnknownNameError, match="cari"):
        decode_frame(decode_stream(stream).scene, 0, "cari")


def test_inconsistent_frames_are_refused(frames):
    encoder = SequenceEncoder(SequenceOptions(order="tracked"))
    encoder.push(frames[0])
    with pytest.raises(InvalidValueError, match="600"):
        encoder.push(frames[1].select(np.arange(500)))
    wide = Splats(**{**vars(frames[0]), "sh": np.zeros((600, 4, 3), np.float32)})
    with pytest.raises(InvalidValueError, match="degree 1, those before of 0"):
        encoder.push(wide)
    with pytest.raises(InvalidValueError, match="one frame at least"):
        SequenceEncoder().finish()
    with pytest.raises(InvalidValueError, match="1 to 64 frames"):
        SequenceOptions(group_frames=65)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"background": (2.0, 0.0, 0.0)}, r"a background is three numbers from 0 to 1, not \(2.0, 0.0, 0.0\)"),
        ({"up": "upward"}, "unknown up axis 'upward': known are .*-y.* auto"),
        ({"order": "sorted"}, "unknown order of Gaussians 'sorted': known are auto, shuffled, tracked"),
        ({"quality": "finest"}, "unknown quality 'finest'"),
        ({"quality": 101}, "quality: a number is 0 to 100"),
        ({"threads": -1}, "threads must be a whole number of 0 or more"),
    ],
)
def test_options_are_checked_before_frames_are_read(options, message):
    """A background or axis out of range would give a stream that no decoder reads."""
    with pytest.raises(SplatwireError, match=message):
        SequenceOptions(**options)
    assert SequenceOptions(background=(0.0, 0.5, 1.0), up="-x").up == "-x"


@pytest.mark.parametrize(
    ("rate", "fraction"), [(25, (25, 1)), (29.97, (2997, 100)), (30000 / 1001, (30000, 1001)), (12.5, (25, 2))]
)
def test_frame_rates_may_be_any_numbers(rate, fraction):
    assert SequenceOptions(rate=rate).rate == Fraction(*fraction)


@pytest.mark.parametrize("rate", [0, -1, 0.0004, 1001, float("nan"), float("inf")])
def test_impossible_frame_rates_are_refused(rate):
    with pytest.raises(InvalidValueError, match=r"1000 frames per second|rate: expected .* not nan"):
        SequenceOptions(rate=rate)


def test_arbitrary_payload_bytes_decode_without_an_error(stream):
    """Packets with valid checksums and random bytes give no error, no hang and finite values."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        packets = []
        for packet in stream.packets[:-1]:
            payload = np.frombuffer(packet.payload, np.uint8).copy()
            if rng.random() < 0.3 and len(payload):
                payload[rng.integers(0, len(payload), 4)] = rng.integers(0, 256, 4)
            packets.append(make_packet(packet.id, packet.num_elements, payload.tobytes(), stream.manifest.stream_id))
        clip = decode_stream(stream.with_packets(packets)).scene
        for frame in decode_frames(clip):
            splats = frame.scene.splats
            assert all(bool(np.isfinite(getattr(splats, name)).all()) for name in vars(splats))


def test_inconsistent_side_information_is_refused(stream):
    from splatwire.codec.sequence.side_info import open_side_info

    with pytest.raises(MissingSideInfoError):
        open_side_info(stream.manifest, b"")
    for cut in range(0, len(stream.side_info), 37):
        with pytest.raises(BitstreamError):
            open_side_info(stream.manifest, stream.side_info[:cut] or b"\x00")


def test_frames_equal_to_their_reference_have_no_deficit():
    best, some = np.array([np.inf, 40.0, np.inf]), np.array([np.inf, 38.0, 45.0])
    complete, lossy = (SequenceScore(SequenceRow("motion"), psnr, np.zeros(2), 0, 0) for psnr in (best, some))
    assert complete.worst_below(complete) == complete.mean_below(complete) == 0
    assert lossy.worst_below(complete) == np.inf
    assert SequenceScore(SequenceRow("motion"), some[:2], np.zeros(1), 0, 0).mean_below(
        SequenceScore(SequenceRow("motion"), best[:2], np.zeros(1), 0, 0)
    ) == pytest.approx(1.0)


def test_missing_or_invalid_frame_is_reported(tmp_path, caplog):
    frames = moving_frames(30, 4)
    for number in (0, 1, 3, 4):
        write_splats([frames[min(number, 3)]], tmp_path / f"frame_{number:02}.ply")
    with caplog.at_level(logging.WARNING):
        assert len(frame_files(tmp_path)) == 4
    assert "missing after frame_01.ply: the clip continues with the next frame" in caplog.text
    (tmp_path / "frame_02.ply").write_bytes(b"")
    with pytest.raises(DatasetError, match=r"frame_02.ply: not a frame, .*an empty file"):
        frame_files(tmp_path)


def test_decimal_numbers_in_another_order_give_a_warning(tmp_path, caplog):
    times, counts = tmp_path / "times", tmp_path / "counts"
    for folder, numbers in ((times, ("0.0", "0.25", "0.5", "1.0")), (counts, ("0.25", "0.50", "1.00"))):
        folder.mkdir()
        for number in numbers:
            write_splats(moving_frames(30, 1), folder / f"t_{number}.ply")
    frame_files(counts)
    assert not caplog.messages
    frame_files(times)
    assert "frame t_0.25.ply is after t_0.5.ply" in caplog.text


def test_opacity_of_lost_tracks_follows_the_birth_probability():
    assert started_share(np.array([0, 0, 2, 3]), 5).tolist() == [0.5, 0.5, 0.75, 1, 1]
    assert started_share(np.zeros(0, np.int64), 3).tolist() == [1, 1, 1]
    assert started_share(np.array([2]), 3)[0] > 0, "its logarithm is added to that of the opacity"
