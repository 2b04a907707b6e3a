"""What a scene was trained in front of travels with it; scenes on black are what they always were."""

from dataclasses import replace

import pytest

from splatwire.codec import add_concealment, decode_stream, encode_scene, without_concealment
from splatwire.codec.background import SECTION, background_of, background_sections, read_background
from splatwire.errors import BitstreamError
from splatwire.model import AnchorScene
from splatwire.packets import PRESETS, Packetization
from splatwire.packets.sections import split_sections
from splatwire.scene.background import BLACK, WHITE


def test_pinned_bytes() -> None:
    assert background_sections(BLACK) == {}
    assert background_sections((1.0, 0.5, 0.0)) == {SECTION: bytes.fromhex("0000803f" + "0000003f" + "00000000")}


@pytest.mark.parametrize("preset", ["paper", "datagram", "hacpp"])
def test_a_background_crosses_the_wire(scene: AnchorScene, preset: str) -> None:
    stream = encode_scene(replace(scene, background=WHITE), PRESETS[preset])
    partial = decode_stream(stream.with_packets(stream.packets[1:]))
    assert background_of(stream) == partial.scene.background == WHITE
    assert SECTION not in partial.sections
    assert background_of(add_concealment(stream, "gnn", b"weights")) == WHITE


def test_only_side_information_knows(scene: AnchorScene) -> None:
    packetization = Packetization(block_size=300)
    black, white = (encode_scene(replace(scene, background=color), packetization) for color in (BLACK, WHITE))
    assert SECTION not in split_sections(black.side_info, black.manifest.codec)[1]
    assert background_of(black) == decode_stream(black).scene.background == BLACK
    assert without_concealment(white, SECTION).side_info == black.side_info
    assert [(p.id, p.payload) for p in white.packets] == [(p.id, p.payload) for p in black.packets]


@pytest.mark.parametrize("data", [b"", b"\0" * 11, b"\0" * 13, b"\0\0\xc0\x7f" * 3, b"\0\0\0\x40" * 3])
def test_damage_is_told(data: bytes) -> None:
    with pytest.raises(BitstreamError):
        read_background({SECTION: data})
