"""Tiers: separate packets for important anchors, the same decoded scene, and the tier of every anchor in the stream."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from random_numbers import Numbers
from splatwire.bitstream import (
    PRESETS,
    Packetization,
    PacketPlan,
    SceneStream,
    TierCounts,
    manifest_from_bytes,
    manifest_to_bytes,
    measure_sizes,
    stream_from_bytes,
    stream_to_bytes,
)
from splatwire.bitstream.sections import side_info_parts, with_section, without_section
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.progressive import ProgressiveDecoder
from splatwire.codec.tiers import SECTION, assign_stream_packets, decode_tiers, encode_tiers, read_tiers
from splatwire.errors import BitstreamError, InvalidValueError, SplatwireError
from splatwire.types import AnchorScene
from splatwire.types.importance import Importance

NAMES = ("positions", "features", "scalings", "offsets", "mask")
PACKETIZATIONS = {
    "pak": Packetization(block_size=200, lanes=4),
    "datagram": replace(PRESETS["datagram"], block_size=300),
    "contiguous": Packetization(block_size=150, lanes=3, grouping="contiguous", order="raster"),
}


@pytest.fixture(scope="module")
def tiers(scene: AnchorScene) -> np.ndarray:
    share = Numbers(1).rand(scene.anchors.num_anchors)
    return Importance.of_footprints(share).tiers((0.2, 0.3))


@pytest.fixture(scope="module", params=PACKETIZATIONS)
def stream(request, scene: AnchorScene, tiers: np.ndarray) -> SceneStream:
    return encode_scene(scene, PACKETIZATIONS[request.param], tiers=tiers)


def test_tiers_do_not_change_the_decoded_scene(scene: AnchorScene, stream: SceneStream):
    plain = encode_scene(scene, stream.manifest.packetization)
    assert plain.manifest.tiers == ()
    ours, other = decode_stream(stream), decode_stream(plain)
    assert ours.loss_mask.num_lost == 0
    assert SECTION not in ours.sections
    for name in NAMES:
        assert np.array_equal(getattr(ours.scene.anchors, name), getattr(other.scene.anchors, name))


def test_every_subset_decodes_to_the_same_values(stream: SceneStream):
    whole, rng = decode_stream(stream).scene.anchors, np.random.default_rng(3)
    for share in (0.0, 0.3, 0.8):
        kept = [packet for packet in stream.packets if rng.random() < share]
        arrived = stream.with_packets(kept)
        received, (groups, packets) = decode_stream(arrived), assign_stream_packets(arrived)
        known = np.zeros(len(whole.positions), bool)
        for g, packet in enumerate(packets):
            if packet is not None:
                known[groups.indices[groups.starts[g] : groups.starts[g + 1]]] = True
        assert known.sum() == sum(packet.num_elements for packet in kept)
        assert np.array_equal(received.loss_mask.fully_received, known)
        for name in NAMES:
            assert np.array_equal(getattr(received.scene.anchors, name)[known], getattr(whole, name)[known])


def test_progressive_decoding_with_tiers_equals_decoding_at_once(stream: SceneStream):
    decoder = ProgressiveDecoder(stream.manifest, stream.side_info)
    for number in np.random.default_rng(0).permutation(len(stream.packets)).tolist():
        decoder.add([stream.packets[number]])
    assert decoder.complete
    whole = decode_stream(stream).scene.anchors
    for name in NAMES:
        assert np.array_equal(getattr(decoder.received_scene.scene.anchors, name), getattr(whole, name))


def test_packets_of_a_tier_hold_its_anchors(scene: AnchorScene, tiers: np.ndarray, stream: SceneStream):
    first = stream.with_packets(
        [packet for packet in stream.packets if stream.manifest.plan.tier_of(packet.id.block) == 0]
    )
    known = decode_stream(first).loss_mask.fully_received
    assert int(known.sum()) == round(0.2 * scene.anchors.num_anchors) == stream.manifest.tiers[0].num_elements
    whole = decode_stream(stream).scene.anchors.positions
    place = {tuple(p): int(t) for p, t in zip(scene.anchors.positions.tolist(), tiers, strict=True)}
    assert all(place[tuple(p)] == 0 for p in whole[known].tolist())
    assert all(place[tuple(p)] > 0 for p in whole[~known].tolist())
    sizes = measure_sizes(stream).tiers
    assert sizes["0"]["num_packets"] == len(first.packets)
    assert sum(tier["num_packets"] for tier in sizes.values()) == stream.manifest.num_packets
    ids = [stream.manifest.plan.tier_of(packet.id.block) for packet in stream.packets]
    assert ids == sorted(ids)


def test_tiered_stream_round_trips_through_bytes(stream: SceneStream):
    assert stream_from_bytes(stream_to_bytes(stream))[0] == stream
    assert manifest_from_bytes(manifest_to_bytes(stream.manifest)) == stream.manifest
    assert side_info_parts(stream.side_info, stream.manifest.schema_name)[SECTION] < 2 * 700 / 8


def test_a_small_tier_has_fewer_lanes(scene: AnchorScene, tiers: np.ndarray):
    stream = encode_scene(scene, Packetization(block_size=300, lanes=8), tiers=tiers)
    assert [tier.lanes for tier in stream.manifest.tiers] == [2, 3, 4]
    assert min(packet.num_elements for packet in stream.packets) > 30


@pytest.mark.parametrize("num_tiers", [2, 3, 8])
def test_tiers_are_read_from_the_stream(num_tiers: int):
    rng = np.random.default_rng(num_tiers)
    for size in (1, 2, 5000):
        tiers = rng.integers(0, num_tiers, size).astype(np.uint8)
        assert np.array_equal(decode_tiers(encode_tiers(tiers, num_tiers), size, num_tiers), tiers)


def test_coded_tiers_are_near_their_entropy():
    """At 5 %, independent anchors need 0.286 bits each; clustered ones need less."""
    rng = np.random.default_rng(0)
    alone = (rng.random(100_000) >= 0.05).astype(np.uint8)
    assert 8 * len(encode_tiers(alone, 2)) / len(alone) < 0.286 * 1.08
    clustered = np.repeat(alone[:10_000], 10)
    assert 8 * len(encode_tiers(clustered, 2)) / len(clustered) < 0.15


def test_contradictory_tiers_are_refused(stream: SceneStream):
    manifest = stream.manifest
    with pytest.raises(BitstreamError, match="whether there are tiers"):
        decode_stream(without_section(stream, SECTION))
    plain = replace(stream, manifest=replace(manifest, tiers=()), packets=())
    with pytest.raises(BitstreamError, match="whether there are tiers"):
        decode_stream(plain)
    with pytest.raises(BitstreamError, match="which the manifest denies"):
        decode_stream(with_section(stream, SECTION, b"\x55" * 40))


def test_damaged_sections_are_refused_or_decode_to_other_tiers(stream: SceneStream):
    rng = np.random.default_rng(0)
    for _ in range(50):
        data = rng.bytes(int(rng.integers(0, 200)))
        try:
            tiers = read_tiers({SECTION: data}, stream.manifest)
        except SplatwireError:
            continue
        assert len(tiers) == stream.manifest.num_elements


@pytest.mark.parametrize("stream", ["pak"], indirect=True)
@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ([[700, 4]], "2 to 8 of them"),
        ([[300, 4], [300, 4]], "do not add up"),
        ([[0, 4], [700, 4]], "a tier has no element"),
        ([[-5, 4], [705, 4]], "number of elements of a tier"),
        ([[100, 0], [600, 4]], "number of lanes of a tier"),
        ([[100, 99], [600, 4]], "number of lanes of a tier"),
        ([[1, 1]] * 9, "pairs of integers"),
        ([[1, 2, 3]], "pairs of integers"),
        ([7, 7], "pairs of integers"),
        ([[True, 4], [699, 4]], "pairs of integers"),
        ({}, "tiers is not a list"),
    ],
)
def test_inconsistent_manifests_are_refused(stream: SceneStream, stated, message: str):
    content = json.loads(manifest_to_bytes(stream.manifest))
    content.pop("digest")
    content["tiers"] = stated
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    content["digest"] = hashlib.sha256(text.encode()).hexdigest()[:16]
    with pytest.raises(BitstreamError, match=message):
        manifest_from_bytes(json.dumps(content).encode())


def test_impossible_tiers_are_refused(scene: AnchorScene, tiers: np.ndarray):
    with pytest.raises(InvalidValueError, match="tier 0 of 2 has no element"):
        encode_scene(scene, tiers=np.ones_like(tiers))
    with pytest.raises(InvalidValueError, match=r"tiers: .* from 0 to 7, not 0 to 8"):
        encode_scene(scene, tiers=np.arange(700).astype(np.uint8) % 9)
    with pytest.raises(InvalidValueError, match=r"tiers: expected an array \(700,\) .* \(699,\)"):
        encode_scene(scene, tiers=tiers[1:])
    with pytest.raises(InvalidValueError, match="knows no tiers"):
        encode_scene(scene, PRESETS["hacpp"], tiers=tiers)
    with pytest.raises(InvalidValueError, match="knows no tiers"):
        PacketPlan(PRESETS["hacpp"], 700, (TierCounts(100, 1), TierCounts(600, 1)), num_feature_groups=3)


def test_invisible_anchors_have_no_tier(scene: AnchorScene, tiers: np.ndarray):
    mask = scene.anchors.mask.copy()
    mask[:100] = False
    smaller = replace(scene, anchors=replace(scene.anchors, mask=mask))
    stream = encode_scene(smaller, PACKETIZATIONS["pak"], tiers=tiers)
    assert [tier.num_elements for tier in stream.manifest.tiers] == np.bincount(tiers[100:]).tolist()
