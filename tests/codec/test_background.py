"""The background of a scene is transmitted; scenes on black have unchanged streams."""

from dataclasses import replace

import pytest

from splatwire.bitstream import PRESETS, Packetization
from splatwire.bitstream.sections import split_sections
from splatwire.codec import decode_stream, encode_scene, with_section, without_section
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.errors import BitstreamError
from splatwire.types import AnchorScene
from splatwire.types.background import BLACK, WHITE


def test_background_section_bytes_are_pinned() -> None:
    assert BACKGROUND_SECTION.sections(BLACK) == {}
    assert BACKGROUND_SECTION.sections((1.0, 0.5, 0.0)) == {
        BACKGROUND_SECTION.name: bytes.fromhex("0000803f" + "0000003f" + "00000000")
    }


@pytest.mark.parametrize("preset", ["paper", "datagram", "hacpp"])
def test_background_survives_encoding(scene: AnchorScene, preset: str) -> None:
    stream = encode_scene(replace(scene, background=WHITE), PRESETS[preset])
    received = decode_stream(stream.with_packets(stream.packets[1:]))
    assert BACKGROUND_SECTION.of_stream(stream) == received.scene.background == WHITE
    assert BACKGROUND_SECTION.name not in received.sections
    assert BACKGROUND_SECTION.of_stream(with_section(stream, "gnn", b"weights")) == WHITE


def test_background_changes_side_information_only(scene: AnchorScene) -> None:
    packetization = Packetization(block_size=300)
    black, white = (encode_scene(replace(scene, background=color), packetization) for color in (BLACK, WHITE))
    assert BACKGROUND_SECTION.name not in split_sections(black.side_info, black.manifest.schema_name)[1]
    assert BACKGROUND_SECTION.of_stream(black) == decode_stream(black).scene.background == BLACK
    assert without_section(white, BACKGROUND_SECTION.name).side_info == black.side_info
    assert [(p.id, p.payload) for p in white.packets] == [(p.id, p.payload) for p in black.packets]


@pytest.mark.parametrize("data", [b"", b"\0" * 11, b"\0" * 13, b"\0\0\xc0\x7f" * 3, b"\0\0\0\x40" * 3])
def test_damaged_background_is_refused(data: bytes) -> None:
    with pytest.raises(BitstreamError):
        BACKGROUND_SECTION.read({BACKGROUND_SECTION.name: data})
