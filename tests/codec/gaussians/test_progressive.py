"""Decoding Gaussians packet by packet equals decoding the same packets at once, at any time."""

import dataclasses

import numpy as np
import pytest

from close import unit
from random_numbers import Numbers
from splatwire.bitstream import PRESETS, SceneStream
from splatwire.codec import ProgressiveDecoder, decode_stream, encode_scene
from splatwire.errors import BitstreamError, DesyncError
from splatwire.types import ReceivedScene, SplatScene
from splatwire.types.splats import Splats

COUNT = 1500


@pytest.fixture(scope="module", params=["paper", "datagram"])
def stream(request) -> SceneStream:
    rng = Numbers(8)
    quats = unit(rng.randn(COUNT, 4))
    splats = Splats(
        rng.rand(COUNT, 3), quats, rng.rand(COUNT, 3) * 0.02 + 0.005,
        rng.rand(COUNT), rng.randn(COUNT, 4, 3) * 0.3,
    )  # fmt: skip
    packetization = dataclasses.replace(PRESETS[request.param], block_size=400)
    return encode_scene(SplatScene(splats), packetization)


def of(stream: SceneStream, packets) -> ReceivedScene:
    received = decode_stream(SceneStream(stream.manifest, stream.side_info, tuple(sorted(packets, key=lambda p: p.id))))
    assert isinstance(received, ReceivedScene)
    return received


def assert_same(one: ReceivedScene, other: ReceivedScene) -> None:
    assert np.array_equal(one.loss_mask.received, other.loss_mask.received)
    for name, values in vars(one.scene.splats).items():
        assert np.array_equal(values, getattr(other.scene.splats, name)), name


def test_progressive_state_equals_decoding_the_same_packets(stream):
    decoder = ProgressiveDecoder(stream.manifest, stream.side_info)
    order = np.random.default_rng(1).permutation(len(stream.packets))
    assert_same(decoder.snapshot(), of(stream, ()))
    for part in np.array_split(order, 3):
        new = decoder.add([stream.packets[i] for i in part])
        assert len(new) == sum(stream.packets[i].num_elements for i in part)
        assert len(decoder.add([stream.packets[part[0]]])) == 0
        assert_same(decoder.received_scene, of(stream, decoder.stream.packets))
    assert decoder.complete
    assert decoder.report.num_duplicate == 3


def test_wrong_integers_fail_the_digest_once_complete(stream):
    wrong = dataclasses.replace(stream.manifest, symbols_digest="0" * 64)
    decoder = ProgressiveDecoder(wrong, stream.side_info)
    with pytest.raises(DesyncError):
        decoder.add(stream.packets)
    with pytest.raises(BitstreamError):
        ProgressiveDecoder(stream.manifest, stream.side_info[:40])
