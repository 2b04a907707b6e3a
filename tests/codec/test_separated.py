"""HAC++'s separated layout contains the same integers, and a lost file removes its attribute and dependent ones."""

from dataclasses import replace

import numpy as np
import pytest

from splatwire.bitstream import (
    PRESETS,
    PacketId,
    Packetization,
    SceneStream,
    make_packet,
    stream_from_bytes,
    stream_to_bytes,
)
from splatwire.bitstream.sections import side_info_parts, without_section
from splatwire.channel import parse_loss, transmit
from splatwire.codec import ProgressiveDecoder, decode_stream, encode_scene, scene_in_order
from splatwire.codec.anchors.hacpp.separated import SECTION
from splatwire.errors import BitstreamError, DesyncError
from splatwire.types import Anchors, AnchorScene, Attribute, ReceivedScene

HACPP = replace(PRESETS["hacpp"], block_size=200)
SCALING, OFFSET, FEATURE = 1, 2, 3
NAMES = ("positions", "features", "scalings", "offsets", "mask")
FEATURE_GROUPS = (slice(0, 4), slice(4, 8), slice(8, 12))


@pytest.fixture(scope="module")
def stream(scene: AnchorScene) -> SceneStream:
    return encode_scene(scene, HACPP)


@pytest.fixture(scope="module")
def whole(stream: SceneStream) -> Anchors:
    return decode_stream(stream).scene.anchors


def without(stream: SceneStream, *ids: PacketId) -> ReceivedScene:
    return decode_stream(stream.with_packets(packet for packet in stream.packets if packet.id not in ids))


def test_separated_preset_equals_the_hacpp_layout():
    preset = PRESETS["hacpp"]
    assert (preset.block_size, preset.order, preset.lanes, preset.grouping) == (3000, "raster", 1, "contiguous")
    assert preset.separated


def test_packet_files_equal_those_of_hacpp(stream: SceneStream):
    parts = ("scaling", "offset", "feature0", "feature1", "feature2")
    assert [packet.id.filename for packet in stream.packets] == [
        f"pak_lane0_s{block}_{part}.pak" for block in range(4) for part in parts
    ]
    assert [packet.num_elements for packet in stream.packets] == [200] * 15 + [100] * 5


@pytest.mark.parametrize(
    "packetization",
    [
        HACPP,
        Packetization(block_size=300, lanes=4, packaging="separated"),
        Packetization(block_size=250, lanes=3, grouping="contiguous", packaging="separated"),
    ],
    ids=["hacpp", "stratified", "contiguous"],
)
def test_lossless_separated_packets_equal_atomic_packets(scene: AnchorScene, packetization: Packetization):
    separated = encode_scene(scene, packetization)
    atomic = encode_scene(scene, replace(packetization, packaging="atomic"))
    assert separated.manifest.symbols_digest == atomic.manifest.symbols_digest
    ours, other = decode_stream(separated), decode_stream(atomic)
    assert ours.loss_mask.num_lost == 0
    assert SECTION not in ours.sections
    for name in NAMES:
        assert np.array_equal(getattr(ours.scene.anchors, name), getattr(other.scene.anchors, name))
    assert stream_from_bytes(stream_to_bytes(separated))[0] == separated


def test_lost_scaling_packets_lose_only_scalings(stream: SceneStream, whole: Anchors):
    received = without(stream, PacketId(1, 0, SCALING))
    anchors, rows = received.scene.anchors, slice(200, 400)
    assert not anchors.scalings[rows].any()
    expected = np.ones((700, 4), np.bool_)
    expected[rows, Attribute.SCALING] = False
    assert np.array_equal(received.loss_mask.received, expected)
    for name in ("features", "offsets", "mask"):
        assert np.array_equal(getattr(anchors, name), getattr(whole, name))
    assert np.array_equal(anchors.scalings[400:], whole.scalings[400:])


def test_lost_offset_packets_lose_only_offsets(stream: SceneStream, whole: Anchors):
    received = without(stream, PacketId(3, 0, OFFSET))
    anchors = received.scene.anchors
    assert not anchors.offsets[600:].any()
    assert np.array_equal(anchors.offsets[:600], whole.offsets[:600])
    assert received.loss_mask.column(Attribute.OFFSET).tolist() == [True] * 600 + [False] * 100
    for name in ("features", "scalings", "mask"):
        assert np.array_equal(getattr(anchors, name), getattr(whole, name))


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_lost_feature_group_loses_dependent_groups(stream: SceneStream, whole: Anchors, lost: int):
    received = without(stream, PacketId(2, 0, FEATURE + lost))
    features, rows = received.scene.anchors.features, slice(400, 600)
    for group, columns in enumerate(FEATURE_GROUPS):
        if group < lost:
            assert np.array_equal(features[rows, columns], whole.features[rows, columns])
        else:
            assert not features[rows, columns].any()
    others = np.ones(700, np.bool_)
    others[rows] = False
    assert np.array_equal(features[others], whole.features[others])
    assert np.array_equal(received.loss_mask.column(Attribute.FEATURE), others)
    assert bool(received.loss_mask.received[:, 1:].all())


def test_every_subset_decodes_to_original_values_or_zero(stream: SceneStream, whole: Anchors):
    for seed in range(5):
        arrived, _ = transmit(stream, parse_loss("bernoulli:0.3"), seed=seed)
        received_scene = decode_stream(arrived)
        there = {packet.id for packet in arrived.packets}
        for block in range(4):
            rows = slice(200 * block, min(200 * block + 200, 700))
            features = [PacketId(block, 0, FEATURE + g) in there for g in range(3)]
            groups = np.minimum.accumulate(features).tolist()
            received = [all(features), PacketId(block, 0, SCALING) in there, PacketId(block, 0, OFFSET) in there, True]
            assert bool((received_scene.loss_mask.received[rows] == np.array(received)).all())
            for columns, ok in zip(FEATURE_GROUPS, groups, strict=True):
                expected = whole.features[rows, columns] * ok
                assert np.array_equal(received_scene.scene.anchors.features[rows, columns], expected)
            assert np.array_equal(received_scene.scene.anchors.scalings[rows], whole.scalings[rows] * received[1])
            assert np.array_equal(received_scene.scene.anchors.offsets[rows], whole.offsets[rows] * received[2])
        assert np.array_equal(received_scene.scene.anchors.mask, whole.mask)


def test_digest_covers_every_attribute(stream: SceneStream):
    for number in range(5):
        packets = list(stream.packets)
        payload = bytearray(packets[number].payload)
        payload[len(payload) // 2] ^= 0x10
        packets[number] = make_packet(packets[number].id, packets[number].num_elements, bytes(payload))
        with pytest.raises(DesyncError):
            decode_stream(stream.with_packets(packets))


def test_damaged_payloads_decode_without_an_error(stream: SceneStream):
    rng = np.random.default_rng(1)
    for _ in range(20):
        packets = [make_packet(p.id, p.num_elements, rng.bytes(int(rng.integers(0, 90)))) for p in stream.packets[:7]]
        assert decode_stream(stream.with_packets(packets)).loss_mask.num_lost == 500


def test_masks_are_side_information(stream: SceneStream):
    assert 0 < side_info_parts(stream.side_info, stream.manifest.schema_name)[SECTION] < 700 * 4 / 8 + 20
    with pytest.raises(BitstreamError, match="lacks the section 'masks'"):
        decode_stream(without_section(stream, SECTION))
    with pytest.raises(BitstreamError, match="all at once"):
        ProgressiveDecoder(stream.manifest, stream.side_info)


def test_separated_size_differs_from_atomic_by_headers_only(scene: AnchorScene, stream: SceneStream):
    """The distributions are equal. Sizes differ by one byte per stream end and by the adaptation of masks."""
    atomic = encode_scene(scene, replace(HACPP, packaging="atomic"))
    masks = side_info_parts(stream.side_info, stream.manifest.schema_name)[SECTION]
    ours, theirs = stream.part_sizes()["packet_payloads"] + masks, atomic.part_sizes()["packet_payloads"]
    assert abs(ours - theirs) < 1.5 * len(stream.packets) + 0.02 * masks + 20


def test_raster_order_equals_that_of_hacpp(scene: AnchorScene, whole: Anchors):
    assert np.array_equal(scene_in_order(scene, "raster").anchors.positions, whole.positions)
    keys = (whole.positions * 64).astype(np.int64) @ np.array([1, 1 << 12, 1 << 24])
    assert bool((np.diff(keys) > 0).all())
