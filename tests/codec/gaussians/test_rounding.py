"""Rounding without coding gives the values that a decoder obtains."""

from dataclasses import replace

import numpy as np
import pytest

from shells import shell
from splatwire.bitstream import PRESETS
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.packets import divide_into_packets
from splatwire.codec.gaussians.quality import QUALITIES
from splatwire.codec.gaussians.rounding import coding_for, round_splats
from splatwire.types.splats import Splats


def _sorted(splats: Splats) -> np.ndarray:
    """Attributes of all Gaussians, sorted, because a decoder returns them in another order."""
    quats = np.abs(splats.quats)
    columns = (splats.means, splats.scales, splats.opacities[:, None], quats, splats.sh.reshape(len(quats), -1))
    rows = np.concatenate(columns, axis=1)
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("quality", list(QUALITIES))
def test_rounded_gaussians_equal_decoded_gaussians(degree: int, quality: str) -> None:
    scene = shell(700, degree)
    classes = np.random.Generator(np.random.PCG64(1)).integers(-5, 1, 700).astype(np.int8)
    rounded = round_splats(scene.splats, coding_for(scene.splats, QUALITIES[quality], classes))
    decoded = decode_stream(encode_scene(scene, quality=quality, class_offsets=classes)).scene.splats
    assert (_sorted(rounded) == _sorted(decoded)).all()


def test_rounded_scene_is_encoded_without_change() -> None:
    scene = shell(500, 1)
    coding = coding_for(scene.splats, QUALITIES["small"], None)
    rounded = round_splats(scene.splats, coding)
    decoded = decode_stream(encode_scene(replace(scene, splats=rounded, coding=coding))).scene
    assert (_sorted(rounded) == _sorted(decoded.splats)).all()


@pytest.mark.parametrize("preset", ["paper", "datagram"])
def test_division_into_packets_is_that_of_the_stream(preset: str) -> None:
    scene = shell(2000)
    stream = encode_scene(scene, preset)
    division = divide_into_packets(scene, PRESETS[preset])
    assert sorted(division.num_bytes.tolist()) == sorted(packet.num_bytes for packet in stream.packets)
    counts = np.bincount(division.packet_of_gaussian, minlength=len(division.num_bytes))
    assert sorted(counts.tolist()) == sorted(packet.num_elements for packet in stream.packets)
    for number in range(0, len(counts), 7):
        alone = stream.with_packets([p for p in stream.packets if p.num_bytes == division.num_bytes[number]])
        received = decode_stream(alone)
        sizes = np.sort(received.scene.splats.opacities[received.fully_received])
        members = decode_stream(encode_scene(scene, preset)).scene.splats.opacities
        assert np.isin(sizes, members).all()
