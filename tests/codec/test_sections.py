from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatwire.anchors.scene_file import load_partial, save_partial
from splatwire.bitstream import HACPP_ANCHORS, Packetization, SceneStream, stream_from_bytes, stream_to_bytes
from splatwire.bitstream.limits import MAX_SECTIONS
from splatwire.bitstream.sections import read_sections, split_sections, write_sections
from splatwire.codec import decode_stream, encode_scene, side_info_parts, with_section, without_section
from splatwire.codec.anchors.hacpp.side_info import SideInfo, read_side_info, write_side_info
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.files.byte_io import ByteWriter
from splatwire.types import AnchorScene

SECTIONS = {"gnn": b"weights", "hints": b"", "later_release": bytes(range(200))}


@pytest.fixture(scope="module")
def stream(scene: AnchorScene) -> SceneStream:
    return encode_scene(scene, Packetization(block_size=300))


def raw(*pairs: tuple[bytes, bytes]) -> bytes:
    writer = ByteWriter()
    for name, data in pairs:
        writer.blob(name)
        writer.blob(data)
    return writer.bytes()


def test_named_section_bytes_are_pinned() -> None:
    assert write_sections({}) == b""
    assert write_sections({"zz": b"\x07", "gnn": b""}).hex() == "03676e6e00" + "027a7a0107"


def test_sections_with_unknown_names_are_kept(side_info: SideInfo, side_info_bytes: bytes) -> None:
    with_sections = write_side_info(replace(side_info, sections=SECTIONS))
    assert with_sections == side_info_bytes + write_sections(SECTIONS)
    assert read_side_info(with_sections, len(side_info.voxels), "morton").sections == SECTIONS
    assert read_side_info(side_info_bytes, len(side_info.voxels), "morton").sections == {}
    assert split_sections(with_sections, HACPP_ANCHORS) == (side_info_bytes, SECTIONS)
    parts = side_info_parts(with_sections, HACPP_ANCHORS)
    assert sum(parts.values()) == len(with_sections)
    assert {name: parts[name] for name in SECTIONS} == {"gnn": 12, "hints": 7, "later_release": 216}


def test_adding_a_section_changes_side_information_only(stream: SceneStream) -> None:
    richer = with_section(with_section(stream, "hints", b"more"), "gnn", b"weights")
    assert richer == with_section(with_section(stream, "gnn", b"weights"), "hints", b"more")
    assert richer.packets == stream.packets
    assert richer.manifest.stream_id == stream.manifest.stream_id
    assert stream_from_bytes(stream_to_bytes(richer))[0] == richer
    assert with_section(richer, "hints", b"other").num_bytes == richer.num_bytes + 1
    assert without_section(without_section(richer, "gnn"), "hints") == stream
    assert without_section(stream, "gnn") == stream


def test_decoder_passes_sections_to_concealers(stream: SceneStream, tmp_path: Path) -> None:
    richer = stream
    for name, data in SECTIONS.items():
        richer = with_section(richer, name, data)
    received = decode_stream(richer.with_packets(richer.packets[1:]))
    assert received.sections == SECTIONS
    plain = decode_stream(stream.with_packets(stream.packets[1:]))
    assert plain.sections == {}
    assert np.array_equal(received.scene.anchors.features, plain.scene.anchors.features)
    save_partial(received, tmp_path / "rich")
    assert load_partial(tmp_path / "rich").sections == SECTIONS
    save_partial(plain, tmp_path / "plain")
    save_partial(replace(received, sections={}), tmp_path / "stripped")
    assert load_partial(tmp_path / "plain").sections == {}
    assert (tmp_path / "plain").read_bytes() == (tmp_path / "stripped").read_bytes()


def test_impossible_sections_are_refused(stream: SceneStream) -> None:
    for name in ("", "Gnn", "gnn ", "positions", "x" * 33, "ä"):
        with pytest.raises(InvalidValueError, match="cannot be called"):
            with_section(stream, name, b"")
    with pytest.raises(InvalidValueError, match="at most 16"):
        write_sections({f"s{i}": b"" for i in range(MAX_SECTIONS + 1)})


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (raw((b"gnn", b"1"), (b"gnn", b"2")), "twice"),
        (raw((b"b", b""), (b"a", b"")), "order"),
        (raw((b"grid", b"")), "cannot be called"),
        (raw((b"\xff\x00", b"")), "no name"),
        (raw((b"gnn", b"12"))[:-1], "expected"),
        (b"\x00", "no name"),
        (raw(*((b"s%02d" % i, b"") for i in range(MAX_SECTIONS + 1))), "at most"),
    ],
)
def test_damaged_sections_are_refused(data: bytes, message: str, side_info_bytes: bytes) -> None:
    for read in (read_sections, lambda d: side_info_parts(side_info_bytes + d, HACPP_ANCHORS)):
        with pytest.raises(BitstreamError, match=message):
            read(data)
    with pytest.raises(BitstreamError, match=message):
        read_side_info(side_info_bytes + data, 700, "morton")
