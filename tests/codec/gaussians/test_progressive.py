"""Gaussians decoded packet by packet are at every moment those that a decoder makes of the same packets."""

import dataclasses

import numpy as np
import pytest
import torch

from close import unit
from splatwire.codec import ProgressiveDecoder, decode_stream, encode_scene
from splatwire.errors import BitstreamError, DesyncError
from splatwire.model import Partial, SplatScene
from splatwire.packets import PRESETS, SceneStream
from splatwire.scene.splats import Splats

COUNT = 1500


@pytest.fixture(scope="module", params=["paper", "datagram"])
def stream(request) -> SceneStream:
    rng = torch.Generator().manual_seed(8)
    quats = unit(torch.randn(COUNT, 4, generator=rng).numpy())
    splats = Splats(
        torch.rand(COUNT, 3, generator=rng).numpy(), quats, torch.rand(COUNT, 3, generator=rng).numpy() * 0.02 + 0.005,
        torch.rand(COUNT, generator=rng).numpy(), torch.randn(COUNT, 4, 3, generator=rng).numpy() * 0.3,
    )  # fmt: skip
    packetization = dataclasses.replace(PRESETS[request.param], block_size=400)
    return encode_scene(SplatScene(splats), packetization)


def of(stream: SceneStream, packets) -> Partial:
    partial = decode_stream(SceneStream(stream.manifest, stream.side_info, tuple(sorted(packets, key=lambda p: p.id))))
    assert isinstance(partial, Partial)
    return partial


def assert_same(one: Partial, other: Partial) -> None:
    assert np.array_equal(one.erasures.received, other.erasures.received)
    for name, values in vars(one.scene.splats).items():
        assert np.array_equal(values, getattr(other.scene.splats, name)), name


def test_every_moment_is_what_a_decoder_makes_of_the_same_packets(stream):
    decoder = ProgressiveDecoder(stream.manifest, stream.side_info)
    order = np.random.default_rng(1).permutation(len(stream.packets))
    assert_same(decoder.snapshot(), of(stream, ()))
    for part in np.array_split(order, 3):
        new = decoder.add([stream.packets[i] for i in part])
        assert len(new) == sum(stream.packets[i].num_elements for i in part)
        assert len(decoder.add([stream.packets[part[0]]])) == 0
        assert_same(decoder.partial, of(stream, decoder.stream.packets))
    assert decoder.complete
    assert decoder.report.num_duplicate == 3


def test_wrong_integers_are_noticed_when_everything_is_there(stream):
    wrong = dataclasses.replace(stream.manifest, symbols_digest="0" * 64)
    decoder = ProgressiveDecoder(wrong, stream.side_info)
    with pytest.raises(DesyncError):
        decoder.add(stream.packets)
    with pytest.raises(BitstreamError):
        ProgressiveDecoder(stream.manifest, stream.side_info[:40])
