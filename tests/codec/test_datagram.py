"""The preset `datagram` codes the same scene in independently decodable packets of datagram size."""

from dataclasses import replace

import numpy as np
import pytest

from splatwire.bitstream import PRESETS, Packetization, SceneStream
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import InvalidValueError
from splatwire.types import AnchorScene

SMALL = replace(PRESETS["datagram"], block_size=300)


@pytest.fixture(scope="module")
def stream(scene: AnchorScene) -> SceneStream:
    return encode_scene(scene, SMALL)


def test_datagrams_fit_their_limit_and_are_filled(stream: SceneStream):
    sizes = [packet.num_bytes for packet in stream.packets]
    assert max(sizes) <= 1150
    last_of_block = [a.id.block != b.id.block for a, b in zip(stream.packets, stream.packets[1:], strict=False)]
    inner = [size for size, last in zip(sizes, [*last_of_block, True], strict=True) if not last]
    assert len(inner) > 5
    assert min(inner) > 1150 - 60


def test_lossless_datagrams_equal_the_paper_preset(scene: AnchorScene, stream: SceneStream):
    ours, other = decode_stream(stream).scene.anchors, decode_stream(encode_scene(scene)).scene.anchors
    for name in ("positions", "features", "scalings", "offsets", "mask"):
        assert np.array_equal(getattr(ours, name), getattr(other, name))


def test_every_packet_decodes_alone(stream: SceneStream):
    whole = decode_stream(stream).scene.anchors
    for packet in stream.packets[::4]:
        received_scene = decode_stream(stream.with_packets([packet]))
        ranks = stream.manifest.plan.members(packet.id, packet.num_elements)
        received = np.flatnonzero(received_scene.loss_mask.received.all(axis=1))
        assert np.array_equal(received, np.sort(ranks))
        for name in ("features", "scalings", "offsets", "mask"):
            assert np.array_equal(getattr(received_scene.scene.anchors, name)[ranks], getattr(whole, name)[ranks])


def test_lost_packets_remove_exactly_their_anchors(stream: SceneStream):
    rng = np.random.default_rng(0)
    lost = [packet for packet in stream.packets if rng.random() < 0.4]
    kept = [packet for packet in stream.packets if packet not in lost]
    loss_mask = decode_stream(stream.with_packets(kept)).loss_mask
    plan = stream.manifest.plan
    ranks = np.sort(np.concatenate([plan.members(packet.id, packet.num_elements) for packet in lost]))
    assert np.array_equal(np.flatnonzero((~loss_mask.received).all(axis=1)), ranks)
    assert loss_mask.num_lost == len(ranks) > 0


def test_anchor_larger_than_a_packet_is_refused(scene: AnchorScene):
    anchors = replace(scene.anchors, features=scene.anchors.features * 1e6, offsets=scene.anchors.offsets * 1e6)
    huge = AnchorScene(anchors, scene.heads, scene.coding)
    with pytest.raises(InvalidValueError, match="choose a larger packet size"):
        encode_scene(huge, Packetization(lanes=1, grouping="hashed", packet_bytes=128))
