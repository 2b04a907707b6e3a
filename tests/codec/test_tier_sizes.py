"""Tier sizes: one byte per tier, strictly parsed, and used by receivers for growth."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import tiny_causal_scene
from splatwire.bitstream import PRESETS, Packetization, SceneStream
from splatwire.bitstream.sections import sections_of, without_section
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.codec.progressive import ProgressiveDecoder
from splatwire.codec.tier_sizes import SECTION, encode_tier_sizes, read_tier_sizes
from splatwire.codec.tiers import read_tiers
from splatwire.concealment import conceal
from splatwire.concealment.scene_free.signature import near_losses, signatures
from splatwire.concealment.scene_free.surroundings import surroundings_of
from splatwire.errors import BitstreamError
from splatwire.types import Anchors, AnchorScene, ReceivedScene, TierSizes

PACKETIZATION = Packetization(block_size=200, lanes=4)
TIER_OF = (np.arange(600) % 4).clip(None, 2).astype(np.uint8)


def sized_like_tiers(scene: AnchorScene) -> AnchorScene:
    """Scene with smaller anchors in less important tiers."""
    scalings = scene.anchors.scalings.copy()
    scalings[:, 3:] *= 0.25 ** TIER_OF[:, None].astype(np.float32)
    return replace(scene, anchors=replace(scene.anchors, scalings=scalings))


@pytest.fixture(scope="module", params=["causal", "hacpp"])
def whole(request, scene: AnchorScene) -> SceneStream:
    made = tiny_causal_scene(seed=4, num_anchors=600) if request.param == "causal" else scene.select(np.arange(600))
    return encode_scene(sized_like_tiers(made), PACKETIZATION, tiers=TIER_OF)


@pytest.fixture(scope="module")
def cut(whole: SceneStream) -> SceneStream:
    """Stream that ends within the second importance tier."""
    kept = [packet for packet in whole.packets if whole.manifest.plan.tier_of(packet.id.block) < 2]
    return whole.with_packets(kept[:-1])


def anchors_of(sizes: list[list[float]], offsets: list[int]) -> Anchors:
    mask, num = np.arange(4)[None] < np.array(offsets)[:, None], len(sizes)
    scalings = np.concatenate([np.ones((num, 3), np.float32), np.array(sizes)], axis=1)
    return Anchors(
        np.zeros((num, 3), np.float32),
        np.zeros((num, 2), np.float32),
        scalings,
        np.zeros((num, 4, 3), np.float32),
        mask,
    )


def test_tier_size_is_the_root_of_the_mean_footprint():
    anchors = anchors_of([[4, 0, 2], [1, 2, 3], [1, 1, 1], [0.5, 0.5, 0]], [1, 4, 1, 3])
    data = encode_tier_sizes(anchors, np.array([0, 0, 1, 2]), 3)
    mean = [(8 + 4 * 6) / 2, 1, 0.75]
    assert list(data) == [0, 16, round(4 * np.log2(mean[0] / mean[2]))]


@pytest.mark.parametrize("size", [0.0, -1.0, 1e-30, float("nan"), float("inf")])
def test_tiers_of_equal_size_are_coded_equally(size: float):
    data = encode_tier_sizes(anchors_of([[size] * 3] * 2, [1, 1]), np.array([0, 1]), 2)
    assert list(data) == [0, 0]


def test_extreme_sizes_fit_into_one_byte():
    data = encode_tier_sizes(anchors_of([[1e38] * 3, [0.0] * 3], [4, 1]), np.array([0, 1]), 2)
    assert list(data) == [0, 255]


def test_tier_sizes_round_trip(whole: SceneStream):
    sections = sections_of(whole)
    sizes = read_tier_sizes(sections, whole.manifest)
    assert len(sections[SECTION]) == len(sizes) == 3
    np.testing.assert_array_equal(-8 * np.log2(sizes), list(sections[SECTION]))
    assert sizes[0] == 1 > 2 * sizes[1] > 4 * sizes[2]
    received = decode_stream(whole)
    assert SECTION not in received.sections
    assert np.array_equal(received.tier_sizes, sizes[read_tiers(sections, whole.manifest)])
    arriving = ProgressiveDecoder(whole.manifest, whole.side_info)
    for found in (arriving.received_scene, arriving.snapshot(), received.masked(np.arange(600) % 2 == 0)):
        assert np.array_equal(found.tier_sizes, received.tier_sizes)


def test_stream_without_tiers_has_no_tier_sizes(scene: AnchorScene):
    for made in (scene, tiny_causal_scene(seed=4)):
        stream = encode_scene(made, PACKETIZATION)
        assert SECTION not in sections_of(stream)
        assert decode_stream(stream).tier_sizes is None


def test_separated_packets_have_no_tier_sizes(scene: AnchorScene):
    stream = encode_scene(scene, PRESETS["hacpp"])
    assert SECTION not in sections_of(stream)
    assert decode_stream(stream).tier_sizes is None


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "section 'tier_sizes' has 0 bytes for 3 tiers"),
        (b"\0\7", "section 'tier_sizes' has 2 bytes for 3 tiers"),
        (b"\0\7\7\7", "section 'tier_sizes' has 4 bytes for 3 tiers"),
        (b"\1\7\7", "section 'tier_sizes': no tier is the largest"),
    ],
)
def test_damaged_sections_are_refused(whole: SceneStream, data: bytes, message: str):
    stream = with_section(whole, SECTION, data)
    with pytest.raises(BitstreamError, match=message):
        decode_stream(stream)
    with pytest.raises(BitstreamError, match=message):
        ProgressiveDecoder(stream.manifest, stream.side_info)


def test_sizes_of_absent_tiers_are_refused():
    stream = encode_scene(tiny_causal_scene(seed=4), PACKETIZATION)
    for data, message in ((b"", "no tier is the largest"), (b"\0", "1 bytes for 0 tiers")):
        with pytest.raises(BitstreamError, match=message):
            decode_stream(with_section(stream, SECTION, data))


def without_tier_sizes(received: ReceivedScene) -> ReceivedScene:
    return replace(received, records=tuple(record for record in received.records if not isinstance(record, TierSizes)))


def test_stream_without_tier_sizes_is_concealed_as_before(cut: SceneStream):
    """Without the section, growth uses the size expected by the prior and a limit by anchor count."""
    old = decode_stream(without_section(cut, SECTION))
    assert old.tier_sizes is None
    for name in ("grow", "scene_free"):
        plain = conceal(without_tier_sizes(decode_stream(cut)), name)
        assert np.array_equal(conceal(old, name).hints.size_gain, plain.hints.size_gain)
        assert not np.array_equal(conceal(decode_stream(cut), name).hints.size_gain, plain.hints.size_gain)


@pytest.mark.parametrize("name", ["grow", "scene_free"])
def test_losing_small_anchors_causes_little_growth(cut: SceneStream, name: str):
    sized, without_them = decode_stream(cut), decode_stream(without_section(cut, SECTION))
    known = sized.loss_mask.fully_received
    with_sizes, without = (conceal(received, name).hints.size_gain[known] for received in (sized, without_them))
    assert 0.2 < float(known.astype(np.float32).mean()) < 0.5
    assert float(without.mean()) > 1.4
    assert float(with_sizes.mean()) < 1 + 0.6 * (float(without.mean()) - 1)
    assert bool((with_sizes <= without + 1e-6).all())


def test_tier_sizes_do_not_change_network_inputs(cut: SceneStream):
    context = decode_stream(cut)
    plain, rows = without_tier_sizes(context), np.flatnonzero(context.loss_mask.fully_received)
    ours, theirs = surroundings_of(context, rows), surroundings_of(plain, rows)
    assert np.array_equal(signatures(context, ours), signatures(plain, theirs))
    assert bool((near_losses(context, ours) < near_losses(plain, theirs)).any())
