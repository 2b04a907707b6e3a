"""Schema `causal` decodes to the same integers on every machine and under every loss."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from close import assert_close
from reference.causal_packets import decode_reference
from scenes import tiny_causal_scene
from splatwire.anchors.scene_file import load_partial, load_scene, save_partial, save_scene
from splatwire.anchors.voxels import voxel_indices
from splatwire.bitstream import CAUSAL, PRESETS, Packetization, SceneStream, stream_from_bytes, stream_to_bytes
from splatwire.channel import parse_loss, transmit
from splatwire.codec import ProgressiveDecoder, decode_stream, encode_scene, scene_in_order
from splatwire.codec.anchors.causal.context import CodingContext, exponential
from splatwire.codec.anchors.causal.encoder import MAX_SIDE_INFO_SHARE, _split_position_bits
from splatwire.codec.anchors.causal.packet_coder import decode_packets, encode_packets, quantise, split_into_packets
from splatwire.codec.anchors.causal.positions import AnchorPositions, encode_coarse_positions, read_coarse_positions
from splatwire.codec.anchors.causal.side_info import LOG_BITS, SideInfo, read_side_info, write_side_info
from splatwire.concealment import conceal
from splatwire.errors import DesyncError, InvalidValueError, MissingSideInfoError, SplatwireError
from splatwire.ops.morton import morton_encode
from splatwire.types import AnchorScene, Prior


@pytest.fixture(scope="module")
def scene() -> AnchorScene:
    return scene_in_order(tiny_causal_scene(seed=3, num_anchors=500), "morton")


@pytest.fixture(scope="module")
def stream(scene: AnchorScene) -> SceneStream:
    return encode_scene(scene)


@pytest.fixture(scope="module")
def info(stream: SceneStream) -> SideInfo:
    return read_side_info(stream.side_info, stream.manifest.num_elements)


def exact_places(scene: AnchorScene, info: SideInfo) -> AnchorPositions:
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    known = info.positions.known
    return replace(known, codes=morton_encode(voxels - known.corner))


def test_decoded_values_are_within_half_a_step(scene: AnchorScene, stream: SceneStream):
    found, meant, steps = decode_stream(stream).scene.anchors, scene.anchors, scene.causal.steps
    assert np.array_equal(found.positions, meant.positions)
    assert np.array_equal(found.mask, meant.mask)
    features = np.array(scene.causal.config.layout.feature_groups)
    feature_step = np.repeat(steps[: len(features)], features)
    assert bool((np.abs(found.features - meant.features) <= 0.5001 * feature_step).all())
    logs = np.abs(np.log(found.scalings) - np.log(meant.scalings))
    assert float(logs[:, 0].max()) <= 0.5001 * steps[-3]
    assert float(logs[:, 3:].max()) <= 0.5001 * steps[-2]
    # rounding of scales moves no Gaussian, because offsets compensate for it
    away = found.offsets * found.scalings[:, None, :3] - meant.offsets * meant.scalings[:, None, :3]
    assert bool((np.abs(away) <= 0.501 * steps[-1] * found.scalings[:, None, :3]).all())


def test_streams_name_their_codec_and_survive_files(stream: SceneStream):
    assert (stream.manifest.schema_name, stream.manifest.format_version) == (CAUSAL, 2)
    back, _ = stream_from_bytes(stream_to_bytes(stream))
    found, expected = (decode_stream(some).scene.anchors.features for some in (back, stream))
    assert np.array_equal(found, expected)


@pytest.mark.parametrize("preset", ["paper", "datagram"])
@pytest.mark.parametrize("tiers", [False, True])
def test_anchors_are_equal_under_every_packetization(scene: AnchorScene, stream: SceneStream, preset: str, tiers: bool):
    of = (np.arange(scene.anchors.num_anchors) % 3).astype(np.uint8) if tiers else None
    other = encode_scene(scene, PRESETS[preset], tiers=of)
    whole, again = decode_stream(stream).scene.anchors, decode_stream(other).scene.anchors
    for name, values in vars(whole).items():
        assert np.array_equal(values, getattr(again, name)), name
    if preset == "datagram":
        assert max(packet.num_bytes for packet in other.packets) <= PRESETS[preset].packet_bytes


def test_lost_packet_affects_only_its_anchors(scene: AnchorScene):
    stream = encode_scene(scene, PRESETS["datagram"])
    whole, damaged = decode_stream(stream), decode_stream(transmit(stream, parse_loss("bernoulli:0.4"), seed=1)[0])
    known = damaged.loss_mask.received.all(axis=1)
    assert 0 < int(known.sum()) < len(known)
    assert np.array_equal(damaged.scene.anchors.features[known], whole.scene.anchors.features[known])
    assert not bool(damaged.scene.anchors.features[~known].any())
    assert np.array_equal(damaged[Prior].offset.mean, whole[Prior].offset.mean)
    assert bool((damaged[Prior].scaling.mean > 0).all())
    assert np.array_equal(damaged.scene.anchors.positions[known], whole.scene.anchors.positions[known])
    assert np.array_equal(damaged.scene.anchors.positions[~known], whole.positions[~known])
    away = np.linalg.norm(whole.positions - whole.scene.anchors.positions, axis=1)
    assert 0 < float(np.median(away)) < 0.5 * float(whole.positions.std())


def test_progressive_decoding_equals_decoding_at_once(stream: SceneStream):
    decoder, whole = ProgressiveDecoder(stream.manifest, stream.side_info), decode_stream(stream)
    for packet in reversed(stream.packets):
        decoder.add([packet])
    assert decoder.complete
    assert np.array_equal(decoder.received_scene.scene.anchors.offsets, whole.scene.anchors.offsets)


@pytest.mark.parametrize("name", ["drop", "grow", "idw", "prior", "scene_free"])
def test_concealment_works_with_positions_from_packets(scene: AnchorScene, name: str):
    stream = encode_scene(scene, PRESETS["datagram"])
    decoder, whole = ProgressiveDecoder(stream.manifest, stream.side_info), decode_stream(stream)
    some = stream.packets[::2]
    for packet in some:
        decoder.add([packet])
    known = decoder.received_scene.loss_mask.fully_received
    at_once = conceal(decode_stream(replace(stream, packets=some)), name)
    shown = conceal(decoder.received_scene, name)
    for other in (conceal(whole.masked(known), name), shown):
        for attribute, values in vars(at_once.anchors).items():
            assert np.array_equal(getattr(other.anchors, attribute), values), attribute
    assert_close(shown.hints.size_gain, at_once.hints.size_gain, rtol=1e-6, atol=0)
    assert np.array_equal(shown.anchors.positions[known], whole.scene.anchors.positions[known])
    assert np.array_equal(shown.anchors.positions[~known], whole.positions[~known])


def test_plain_reference_decodes_the_same_integers(scene: AnchorScene, info: SideInfo):
    context, rows = CodingContext.of(info), np.arange(9)
    positions = exact_places(scene, info).select(rows)
    masks = scene.anchors.mask[rows].astype(np.uint8)
    values = np.random.default_rng(0).normal(0, 6, (9, context.stages[-1].first + context.stages[-1].size))
    values[0, 3] = 9000.0  # far outside the window of its distribution
    found = quantise(context, positions, masks, values, 0.4)
    (payload,) = encode_packets(context, found, np.array([9]))
    codes, masks_back, numbers = decode_reference(context, info.positions.known.select(rows), payload)
    assert codes == positions.codes.tolist()
    assert masks_back == masks.tolist()
    assert numbers == found.reconstructed.tolist()


@pytest.mark.parametrize("batch", [1, 7, 333])
def test_decoded_integers_do_not_depend_on_the_batch_size(stream: SceneStream, info: SideInfo, batch: int):
    context, packet = CodingContext.of(info), stream.packets[0]
    ranks = stream.manifest.plan.members(packet.id, packet.num_elements)
    known, voxels = info.positions.known, info.positions.known.voxels
    together = decode_packets(context, known.select(ranks), np.array([len(ranks)]), [packet.payload])
    outputs = context.start(voxels).position_outputs
    parts = [context.start(voxels[i : i + batch]).position_outputs for i in range(0, len(voxels), batch)]
    assert np.array_equal(outputs, np.concatenate(parts))
    pair = known.select(np.tile(ranks, 2))
    twice = decode_packets(context, pair, np.array([len(ranks)] * 2), [packet.payload] * 2)
    assert np.array_equal(np.tile(together[2], (2, 1)), twice[2])


def test_side_information_round_trips(info: SideInfo, stream: SceneStream):
    again = read_side_info(write_side_info(info), len(info.positions.known.codes))
    assert again.config == info.config
    assert np.array_equal(again.positions.known.voxels, info.positions.known.voxels)
    for name in ("middle", "spread", "linear_steps", "steps_of_logs", "zero_points"):
        assert np.array_equal(getattr(again, name), getattr(info, name)), name
    assert write_side_info(again) == stream.side_info


def test_damaged_side_information_is_refused(stream: SceneStream, info: SideInfo):
    for wrong in (
        replace(info, linear_steps=np.zeros(5)), replace(info, spread=np.zeros(3, dtype=np.int64)),
        replace(info, voxel_size=0.0), replace(info, steps_of_logs=np.array([0, 5])),
        replace(info, zero_points=np.full(4, 1 << 40)), replace(info, middle=np.array([1 << 39, 0, 0])),
    ):  # fmt: skip
        with pytest.raises(InvalidValueError, match="side information"):
            write_side_info(wrong)
    with pytest.raises(MissingSideInfoError):
        decode_stream(replace(stream, side_info=b""))
    rng = np.random.default_rng(4)
    for _ in range(40):
        data = bytearray(stream.side_info[: rng.integers(len(stream.side_info))])
        for place in rng.integers(len(data), size=3) if len(data) else ():
            data[place] = rng.integers(256)
        try:
            read_side_info(bytes(data), len(info.positions.known.codes))
        except SplatwireError:
            continue


def test_arbitrary_payload_decodes_without_an_error(info: SideInfo):
    context, rng = CodingContext.of(info), np.random.default_rng(5)
    for size in (0, 1, 30, 400):
        positions = info.positions.known.select(np.arange(20))
        codes, masks, numbers = decode_packets(context, positions, np.array([20]), [rng.bytes(size)])
        assert np.array_equal(codes >> positions.num_low_bits, positions.codes >> positions.num_low_bits)
        assert masks.shape == (20, 4)
        assert np.abs(numbers.astype(np.int64)).max() < 1 << 31


def test_changed_network_fails_the_digest(stream: SceneStream, info: SideInfo):
    offset = info.networks["offset"]
    bias = offset.output.bias.copy()
    bias[0] += 1
    networks = {**info.networks, "offset": replace(offset, output=replace(offset.output, bias=bias))}
    with pytest.raises(DesyncError):
        decode_stream(replace(stream, side_info=write_side_info(replace(info, networks=networks))))


@pytest.mark.parametrize("leaf", [1, 2, 5, 64])
def test_positions_split_between_side_information_and_packets_round_trip(info: SideInfo, leaf: int):
    rng, context = np.random.default_rng(leaf), CodingContext.of(info)
    coarse = rng.integers(-40, 900, (80, 3)) // rng.choice([1, 4, 16], (80, 1)) * 16
    voxels = np.concatenate([coarse, coarse[:9], coarse[:9] + 1])
    shared = encode_coarse_positions(voxels, leaf)
    context, codes = (
        replace(context, low_bit_probabilities=shared.low_bit_probabilities),
        np.sort(morton_encode(voxels - shared.known.corner)),
    )
    known = shared.known
    assert np.array_equal(known.codes >> known.num_low_bits, codes >> known.num_low_bits)
    assert (np.diff(known.codes) >= 0).all()
    assert known.num_low_bits.any()
    numbers = context.stages[-1].first + context.stages[-1].size
    found = quantise(
        context, replace(known, codes=codes), np.ones((98, 4), np.uint8), rng.normal(size=(98, numbers)), 0.4
    )
    (payload,) = encode_packets(context, found, np.array([98]))
    assert np.array_equal(decode_packets(context, known, np.array([98]), [payload])[0], codes)
    assert decode_reference(context, known, payload)[0] == codes.tolist()
    # the estimated size includes the positions
    assert len(split_into_packets(context, found, np.array([98]), len(payload) + 2)) == 1
    assert len(split_into_packets(context, found, np.array([98]), len(payload) - 2)) == 2


def test_side_information_is_small(scene: AnchorScene, info: SideInfo):
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    everything = replace(info, positions=encode_coarse_positions(voxels, 1))
    head = len(write_side_info(everything))
    sizes = [len(encode_coarse_positions(voxels, leaf).section) for leaf in range(1, 9)]
    assert sizes == sorted(sizes, reverse=True)
    for size in sizes:
        enough = (head - sizes[0] + size) / MAX_SIDE_INFO_SHARE - head
        assert len(_split_position_bits(everything, voxels, enough + 1).section) == size
    assert len(_split_position_bits(everything, voxels, 0.0).section) == sizes[-1]


def test_positions_without_probabilities_are_refused(info: SideInfo):
    section = bytearray(info.positions.section)
    assert section[1] > 1
    for place, value in ((0, 0), (0, 65), (1, 22), (1, section[1] - 1), (2, 0)):
        wrong = section.copy()
        wrong[place] = value
        with pytest.raises(SplatwireError, match="positions"):
            read_coarse_positions(bytes(wrong), len(info.positions.known.codes))


def test_unusable_scenes_are_refused(scene: AnchorScene):
    features = scene.anchors.features.copy()
    features[0, 0] = 1e9
    with pytest.raises(InvalidValueError, match="too large"):
        encode_scene(replace(scene, anchors=replace(scene.anchors, features=features)))
    for wrong in (PRESETS["hacpp"], Packetization(order="raster")):
        with pytest.raises(InvalidValueError, match="coded whole and in Morton order"):
            encode_scene(scene, wrong)


def test_powers_of_two_are_exact():
    logs = np.random.default_rng(0).integers(-40 << LOG_BITS, 40 << LOG_BITS, 1000)
    np.testing.assert_allclose(exponential(logs), np.exp2(logs / 2.0**LOG_BITS), rtol=2e-7)


def test_scene_files_hold_the_causal_model(scene: AnchorScene, stream: SceneStream, tmp_path: Path):
    save_scene(scene, tmp_path / "a.scene")
    back = load_scene(tmp_path / "a.scene")
    assert encode_scene(back).side_info == stream.side_info
    received = decode_stream(transmit(stream, parse_loss("bernoulli:0.5"), seed=1)[0])
    save_partial(received, tmp_path / "b.scene")
    again = load_partial(tmp_path / "b.scene")
    assert np.array_equal(again[Prior].context_features, received[Prior].context_features)
    assert again.scene.causal.config == scene.causal.config
