"""Metadata of a scene is kept by every format with a field for it, by streams and by scene files."""

import dataclasses
import json
import logging
import math
import re
import struct
from pathlib import Path
from typing import Any

import pytest

from splat_io.formats.handmade import glb, legacy_spz, modern_spz, some_splats, write
from splat_io.formats.test_spz import extended
from splatwire.bitstream import stream_from_bytes, stream_to_bytes
from splatwire.bitstream.sections import sections_of, with_section
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.metadata import SECTION, read_metadata
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.io import open_scene, save_scene
from splatwire.io.formats import _asset, write_splats
from splatwire.io.formats.dispatch import read_content
from splatwire.io.formats.ply_metadata import stated_metadata
from splatwire.types import SplatScene
from splatwire.types.metadata import MAX_TEXT, NO_METADATA, SceneMetadata, StartView, clean_text, metadata_to_json

VIEW = StartView((1.5, -2.0, 3.0), (0.0, 0.25, -1.0), (0.0, -1.0, 0.0))
ALL = SceneMetadata("Räume 2, 日本", "Jürgen: & <Söhne>", "CC BY-SA 4.0", "z", VIEW, (-0.5, 1.25, 2.0))
ENDS = [".ply", ".compressed.ply", ".spz", ".sog", ".glb"]


def same(found: SceneMetadata, expected: SceneMetadata = ALL) -> None:
    """True if values are equal up to rounding to float32."""
    assert found.view is not None
    assert expected.view is not None
    assert found.view.numbers() == pytest.approx(expected.view.numbers(), rel=1e-6)
    assert dataclasses.replace(found, view=None) == dataclasses.replace(expected, view=None)


@pytest.mark.parametrize("end", ENDS)
def test_metadata_round_trips_through_each_format(end: str, tmp_path: Path) -> None:
    write_splats([some_splats(30, 1)], tmp_path / f"a{end}", metadata=ALL)
    same(read_content(tmp_path / f"a{end}").metadata)


@pytest.mark.parametrize(("value", "kept"), [(0.25, True), (math.nan, False)])
def test_limits_of_an_orbit_in_elements_of_a_ply_are_read(value: float, kept: bool, tmp_path: Path) -> None:
    write_splats([some_splats(20, 1)], tmp_path / "a.ply", metadata=SceneMetadata("Garden"))
    names = ("safe_orbit_camera_elevation_min_max_radians", "safe_orbit_camera_radius_min")
    more = "".join(
        f"element {name} {count}\nproperty float {name}\n" for name, count in zip(names, (2, 1), strict=True)
    )
    head, mark, rows = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    (tmp_path / "a.ply").write_bytes(head + more.encode() + mark + rows + struct.pack("<3f", -0.5, value, 2))
    assert read_content(tmp_path / "a.ply").metadata == SceneMetadata(
        "Garden", orbit=(-0.5, 0.25, 2.0) if kept else None
    )


@pytest.mark.parametrize("end", ENDS)
def test_file_without_metadata_is_unchanged(end: str, tmp_path: Path) -> None:
    for name, words in (("a", {}), ("b", {"metadata": NO_METADATA})):
        write_splats([some_splats(30, 1)], tmp_path / f"{name}{end}", **words)
    assert (tmp_path / f"a{end}").read_bytes() == (tmp_path / f"b{end}").read_bytes()
    assert read_content(tmp_path / f"a{end}").metadata == NO_METADATA


def test_format_without_metadata_warns(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        write_splats([some_splats(30, 0)], tmp_path / "a.splat", metadata=SceneMetadata("Garden", up="z"))
    assert "no place for metadata: title, up" in caplog.text


@pytest.mark.parametrize("first", ENDS)
@pytest.mark.parametrize("last", ENDS)
def test_metadata_survives_a_stream(first: str, last: str, tmp_path: Path) -> None:
    """Converts a file to a stream, to another file, and to a stream again."""
    write_splats([some_splats(30, 1)], tmp_path / f"a{first}", metadata=ALL)
    stream = encode_scene(open_scene(tmp_path / f"a{first}"))
    stream, _ = stream_from_bytes(stream_to_bytes(stream))
    save_scene(decode_stream(stream).scene, tmp_path / f"b{last}")
    again = encode_scene(open_scene(tmp_path / f"b{last}"))
    same(read_metadata(sections_of(again)))


def test_initial_view_moves_with_the_origin(tmp_path: Path) -> None:
    origin = (500_000.0, 4_000_000.0, 100.0)
    write_splats([some_splats(30, 1)], tmp_path / "a.ply", origin=origin, metadata=ALL)
    text = (tmp_path / "a.ply").read_bytes().partition(b"end_header")[0].decode()
    assert "view: 500001.5 3999998.0 103.0" in text
    content = read_content(tmp_path / "a.ply")
    assert content.origin == origin
    same(content.metadata)


def test_levels_keep_metadata() -> None:
    from splatwire.lod import encode_levels

    stream = encode_levels(SplatScene(some_splats(300, 0), metadata=ALL))
    same(read_metadata(sections_of(stream)))


def test_stream_without_metadata_is_unchanged() -> None:
    assert set(sections_of(encode_scene(SplatScene(some_splats(30, 0))))) & {"metadata", "up", "viewpoint"} == set()


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b"\xff", b"[" * 100_000, b'{"title": "' + b"x" * 70_000 + b'"}'])
def test_a_damaged_section_is_refused(data: bytes) -> None:
    stream = with_section(encode_scene(SplatScene(some_splats(30, 0))), SECTION, data)
    with pytest.raises(BitstreamError, match="section 'metadata'"):
        decode_stream(stream)


def test_ply_comments_of_other_programs_are_read() -> None:
    comments = ["Generated by Nerfstudio", "Vertical Axis: z", "Author: Ana", "Copyright = CC0", "name: Garden"]
    assert stated_metadata(comments) == SceneMetadata("Garden", "Ana", "CC0", "z")


@pytest.mark.parametrize("end", [".ply", ".compressed.ply"])
def test_comments_that_are_not_utf8_are_read_as_windows_1252(
    end: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / f"a{end}"
    write_splats([some_splats()], path, metadata=SceneMetadata("Räume", "Jürgen"))
    written = path.read_bytes()
    path.write_bytes(written.replace("Räume".encode(), "Räume €1".encode("cp1252")))
    assert read_content(path).metadata == SceneMetadata("Räume €1", "Jürgen")
    path.write_bytes(written.replace("Räume".encode(), b"R\xe4ume").replace("Jürgen".encode(), b"J\xfcrgen"))
    assert read_content(path).metadata == SceneMetadata("Räume", "Jürgen")
    assert ["read as Windows-1252" in message for message in caplog.messages] == [True, True]
    assert "(and 1 more)" in caplog.messages[1]


@pytest.mark.parametrize(
    ("comment", "expected"),
    [
        ("author Jane", SceneMetadata(author="Jane")),
        ("Copyright 2024 A. B.", SceneMetadata(license="Copyright 2024 A. B.")),
        ("\u00a9 2024 A. B.", SceneMetadata(license="\u00a9 2024 A. B.")),
        ("All rights reserved.", SceneMetadata(license="All rights reserved.")),
        ("licensed under CC BY 4.0", SceneMetadata(license="CC BY 4.0")),
        ("license MIT", SceneMetadata(license="MIT")),
        ("Title Old Mill", SceneMetadata("Old Mill")),
        ("credit City Museum", SceneMetadata(author="City Museum")),
        ("Credits: Jane & Joe", SceneMetadata(author="Jane & Joe")),
        ("credits to Jane", SceneMetadata(author="Jane")),
        ("Courtesy of the Museum", SceneMetadata(author="the Museum")),
        ("attribution: Jane", SceneMetadata(author="Jane")),
        ("by Jane Doe", SceneMetadata(author="Jane Doe")),
        ("By: Élodie", SceneMetadata(author="Élodie")),
        ("Photos by @jane", SceneMetadata(author="@jane")),
        ("SPDX-License-Identifier: CC-BY-4.0", SceneMetadata(license="CC-BY-4.0")),
        ("SPDX-License-Identifier MIT", SceneMetadata(license="MIT")),
        ("SPDX-FileCopyrightText: 2024 Jane", SceneMetadata(license="2024 Jane")),
        ("CC BY-SA 4.0", SceneMetadata(license="CC BY-SA 4.0")),
        ("cc0", SceneMetadata(license="cc0")),
        ("Creative Commons Attribution 4.0", SceneMetadata(license="Creative Commons Attribution 4.0")),
        (
            "https://creativecommons.org/licenses/by/4.0/",
            SceneMetadata(license="https://creativecommons.org/licenses/by/4.0/"),
        ),
        ("public domain", SceneMetadata(license="public domain")),
        ("by default scales are logarithms", NO_METADATA),
        ("shifted by 500000 0 0", NO_METADATA),
        ("Generated by Brush", NO_METADATA),
        ("cc", NO_METADATA),
        ("credit", NO_METADATA),
        ("authoring tool", NO_METADATA),
        ("Created by Studio (c) 2024", NO_METADATA),
    ],
)
def test_comments_without_a_colon_are_read(comment: str, expected: SceneMetadata) -> None:
    assert stated_metadata([comment]) == expected


@pytest.mark.parametrize(
    ("comment", "warned"),
    [("view: 1 2 3 0 0 0 0 -1 0", False), ("view: 1 2 3", True), ("view: 0 0 0 0 0 0 0 -1 0", True),
     ("start view: front", True), ("orbit: -0.1 1 2", False), ("orbit: 1 2", True), ("overview: 1 2", False),
     ("View: https://example.com/a", False), ("view: COLMAP image 12", False), ("viewpoint: 0 0 0 1 0 0 0", False)],
)  # fmt: skip
def test_views_that_cannot_be_read_give_a_warning(
    comment: str, warned: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_splats([some_splats(20, 0)], tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data.replace(b"element", f"comment {comment}\nelement".encode(), 1))
    read_content(tmp_path / "a.ply")
    assert (f"comment '{comment}' is left out: " in caplog.text) == warned


def test_comments_with_a_colon_precede_those_without() -> None:
    assert stated_metadata(["author Jane", "credit City Museum"]).author == "Jane"
    assert stated_metadata(["SPDX-License-Identifier: CC0-1.0", "CC BY 4.0"]).license == "CC0-1.0"


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        (["Copyright 2024 A. B.", "license: CC0"], SceneMetadata(license="CC0; Copyright 2024 A. B.")),
        (["license: MIT", "license: Apache-2.0", "license: MIT"], SceneMetadata(license="MIT; Apache-2.0")),
        (["license MIT", "(c) Jane"], SceneMetadata(license="MIT; (c) Jane")),
        (["author: Jane", "author: Joe"], SceneMetadata(author="Jane; Joe")),
        (["by Jane", "by Joe"], SceneMetadata(author="Jane; Joe")),
        (["title: Garden", "name: point_cloud"], SceneMetadata("Garden")),
        (["title: Garden", "title: House"], SceneMetadata("House")),
    ],
)
def test_fields_that_are_stated_several_times_are_kept(comments: list[str], expected: SceneMetadata) -> None:
    assert stated_metadata(comments) == expected


@pytest.mark.parametrize(
    "comment", ["up: north", "up: zz", "view: 1 2 3", "view: a b", "view: 0 0 0 0 0 0 0 1 0", "untitled: x", "title:"]
)
def test_empty_comments_are_left_out(comment: str) -> None:
    assert stated_metadata([comment]) == NO_METADATA


def test_metadata_texts_are_one_printable_line() -> None:
    assert clean_text("a\x1b[31m\nb\u202e\u200bc\t d ") == "a [31m bc d"
    assert len(clean_text("x" * 10_000)) == MAX_TEXT
    assert clean_text(7) == ""


@pytest.mark.parametrize(
    "text",
    [
        "\u0645\u06cc\u200c\u062e\u0648\u0627\u0647\u0645", "\U0001f468\u200d\U0001f469", "\U0001fae8 \U0001fbff",
        "a \U0001f3f4\U000e0067\U000e0062\U000e0073\U000e0063\U000e0074\U000e007f b", "\U0001f3f4 \U0001f3f4",
    ],
)  # fmt: skip
def test_characters_that_scripts_and_emoji_need_are_kept(text: str) -> None:
    assert clean_text(text) == text


def test_joiners_are_left_out_where_they_join_nothing() -> None:
    assert clean_text("\u200da \u200d b\u200c\u200dc\u200d") == "a b\u200cc"
    assert clean_text("\u200d") == ""
    assert clean_text("a" * (MAX_TEXT - 1) + "\u200db") == "a" * (MAX_TEXT - 1)
    assert clean_text("a\ufffe\ufdd0b") == "ab"


def test_tags_that_are_no_flag_are_left_out() -> None:
    scotland = "\U0001f3f4\U000e0067\U000e0062\U000e0073\U000e0063\U000e0074\U000e007f"
    assert clean_text("a" + scotland[1:]) == "a"
    assert clean_text(scotland[:-1]) == "\U0001f3f4"
    assert clean_text("\U0001f3f4" + "\U000e0067" * 20 + "\U000e007f") == "\U0001f3f4"
    for length in range(MAX_TEXT - 6, MAX_TEXT):
        assert clean_text("a" * length + scotland) == "a" * length
    assert clean_text("a" * (MAX_TEXT - 7) + scotland) == "a" * (MAX_TEXT - 7) + scotland


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("x" * 500 + " rest", "x" * 500),
        ("\u200b" * 1500 + "x" * 700, "x" * 500),
        ("\u200b" * 100_000, ""),
        ("x" * 499 + "\u200dx", "x" * 499),
        ("\u200b" * 1900 + "x" * 200, None),
        ("x" * 500 + " \u200b" * 700, None),
    ],
)
def test_each_text_that_loses_characters_gives_a_warning(
    text: str, kept: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    found = metadata_to_json(SceneMetadata(text))["title"]
    assert found == (text.replace("\u200b", "").strip() if kept is None else kept)
    assert bool(caplog.text) is (kept is not None)


@pytest.mark.parametrize("end", ENDS)
def test_texts_that_are_cut_give_a_warning(end: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_splats([some_splats(30, 0)], tmp_path / f"a{end}", metadata=SceneMetadata("x" * MAX_TEXT))
    assert read_content(tmp_path / f"a{end}").metadata.title == "x" * MAX_TEXT
    assert not caplog.text
    write_splats([some_splats(30, 0)], tmp_path / f"a{end}", metadata=SceneMetadata("x" * 501))
    assert "'title' of its metadata is longer than 500 characters and cut" in caplog.text


def test_long_texts_in_files_of_other_programs_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_splats([some_splats(20, 0)], tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data.replace(b"element", b"comment license: " + b"x" * 501 + b"\nelement", 1))
    assert read_content(tmp_path / "a.ply").metadata.license == "x" * MAX_TEXT
    write(tmp_path / "a.glb", glb(some_splats(5, 0), {"asset": {"version": "2.0", "copyright": "x" * 501}}))
    assert read_content(tmp_path / "a.glb").metadata.license == "x" * MAX_TEXT
    assert [str(tmp_path / f"a{end}") in caplog.text for end in (".ply", ".glb")] == [True, True]
    assert caplog.text.count("'license' of its metadata is longer than 500 characters") == 2


def test_metadata_texts_cannot_forge_a_header(tmp_path: Path) -> None:
    title = "x\nelement vertex 9\nend_header\n"
    write_splats([some_splats(30, 0)], tmp_path / "a.ply", metadata=SceneMetadata(title))
    content = read_content(tmp_path / "a.ply")
    assert content.splats.num_gaussians == 30
    assert content.metadata.title == "x element vertex 9 end header"


@pytest.mark.parametrize(
    ("asset", "expected"),
    [
        ({"copyright": "2026 Ana"}, SceneMetadata(license="2026 Ana")),
        (
            {"extras": {"author": "Ana (https://example.org/ana)", "license": "CC-BY-4.0", "title": "Garden", "x": 1}},
            SceneMetadata("Garden", "Ana (https://example.org/ana)", "CC-BY-4.0"),
        ),
        (
            {"copyright": "(c) Ana", "extras": {"author": "Ben", "license": "CC0"}},
            SceneMetadata(author="Ben", license="CC0; (c) Ana"),
        ),
        ({"copyright": "(c) Ana", "extras": {"author": "Ben"}}, SceneMetadata(author="Ben", license="(c) Ana")),
        ({"copyright": "Ben", "extras": {"author": "Ben"}}, SceneMetadata(author="Ben")),
        ({"extras": [], "copyright": 3}, NO_METADATA),
        ({"extras": {"title": {}, "splatwire": {"up": 3, "view": "x", "orbit": [1, 2]}}}, NO_METADATA),
    ],
)
def test_gltf_assets_of_other_programs_are_read(
    asset: dict[str, object], expected: SceneMetadata, tmp_path: Path
) -> None:
    path = write(tmp_path / "a.glb", glb(some_splats(5, 0), {"asset": {"version": "2.0", **asset}}))
    assert read_content(path).metadata == expected


XMP = {
    "dc:title": {"@type": "rdf:Alt", "rdf:_1": {"@language": "en-us", "@value": "Garden"}},
    "dc:creator": {"@list": ["Ana", "Ben"]},
    "dc:rights": "CC0",
}


@pytest.mark.parametrize("name", ["KHR_xmp_json_ld", "KHR_xmp"])
@pytest.mark.parametrize(
    ("packets", "expected"),
    [
        ([{}, XMP], SceneMetadata("Garden", "Ana; Ben", "CC0")),
        ([{}, {"dc:title": 3, "dc:creator": [{"@value": "Ana"}], "dc:rights": {}}], SceneMetadata(author="Ana")),
        ([{}, {"dc:title": json.loads('{"@value": ' * 300 + "1" + "}" * 300)}], NO_METADATA),
        ([XMP], NO_METADATA),
        ([{}, []], NO_METADATA),
        ({}, NO_METADATA),
    ],
)
def test_xmp_packets_of_gltf_are_read(
    name: str, packets: object, expected: SceneMetadata, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    asset = {"version": "2.0", "extensions": {name: {"packet": 1}}}
    path = write(
        tmp_path / "a.glb", glb(some_splats(5, 0), {"asset": asset, "extensions": {name: {"packets": packets}}})
    )
    assert read_content(path).metadata == expected
    assert not caplog.text


@pytest.mark.parametrize(
    ("asset", "expected"),
    [
        ({"copyright": "(c) Ana"}, "CC0; (c) Ana"),
        ({"copyright": "CC0"}, "CC0"),
        ({"copyright": "Ana, MIT", "extras": {"author": "Ana", "license": "MIT"}}, "MIT; CC0"),
        ({"extras": {"license": "MIT"}, "copyright": "(c) Ana"}, "MIT; CC0; (c) Ana"),
        ({"extras": {"license": "CC0"}, "copyright": "CC0"}, "CC0"),
    ],
)
def test_rights_in_xmp_are_joined_with_the_license_and_copyright_of_a_gltf_asset(
    asset: dict[str, object], expected: str, tmp_path: Path
) -> None:
    document = {
        "asset": {"version": "2.0", "extensions": {"KHR_xmp_json_ld": {"packet": 0}}, **asset},
        "extensions": {"KHR_xmp_json_ld": {"packets": [XMP]}},
    }
    assert read_content(write(tmp_path / "a.glb", glb(some_splats(5, 0), document))).metadata.license == expected


def test_a_copyright_notice_among_several_rights_in_xmp_is_stated_once(tmp_path: Path) -> None:
    document = {
        "asset": {"version": "2.0", "extensions": {"KHR_xmp_json_ld": {"packet": 0}}, "copyright": "(c) Ana"},
        "extensions": {"KHR_xmp_json_ld": {"packets": [{"dc:rights": ["CC0", "(c) Ana"]}]}},
    }
    assert read_content(write(tmp_path / "a.glb", glb(some_splats(5, 0), document))).metadata.license == "CC0; (c) Ana"


def test_long_texts_in_xmp_give_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    document = {
        "asset": {"version": "2.0", "extensions": {"KHR_xmp_json_ld": {"packet": 0}}},
        "extensions": {"KHR_xmp_json_ld": {"packets": [{"dc:title": "x" * 700}]}},
    }
    content = read_content(write(tmp_path / "a.glb", glb(some_splats(5, 0), document)))
    assert content.metadata.title == "x" * MAX_TEXT
    assert "'title' of its metadata is longer than 500 characters" in caplog.text


def test_gltf_asset_contains_the_copyright_notice(tmp_path: Path) -> None:
    write_splats([some_splats(5, 0)], tmp_path / "a.glb", metadata=ALL)
    data = (tmp_path / "a.glb").read_bytes()
    asset = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])["asset"]
    assert asset["copyright"] == "Jürgen: & <Söhne>, CC BY-SA 4.0"
    assert asset["version"] == "2.0"


def test_orbit_limits_follow_the_extension(tmp_path: Path) -> None:
    record = (0xADBE0002, struct.pack("<3f", -0.5, 0.25, 1))
    path = write(tmp_path / "a.spz", extended(modern_spz(legacy_spz(3)), record))
    assert read_content(path).metadata == SceneMetadata(orbit=(-0.5, 0.25, 1.0))


@pytest.mark.parametrize(
    ("record", "message"),
    [((0xADBE0002, b"abc"), "its limits of the orbit have 3 bytes, not 12"),
     ((0xADBE0002, struct.pack("<3f", 0, 0, math.nan)), "'orbit' of its metadata is left out: expected three numbers"),
     ((0x53570001, b"{"), "its metadata are damaged"), ((0x53570001, b"[1]"), "its metadata are list"),
     ((0x53570001, b'{"view": [1, 2, 3, 1, 2, 3, 0, 1, 0]}'), "eye and target are the same point, (1.0, 2.0, 3.0)")],
)  # fmt: skip
def test_damaged_records_of_metadata_are_left_out_with_a_warning(
    record: tuple[int, bytes], message: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / "a.spz", extended(modern_spz(legacy_spz(3)), record))
    assert read_content(path).metadata == NO_METADATA
    assert f"{path}: " in caplog.text
    assert message in caplog.text


@pytest.mark.parametrize("up", ["up", "Z", ""])
def test_an_unknown_up_axis_is_refused(up: str) -> None:
    message = f"SceneMetadata.up: expected one of x, -x, y, -y, z, -z, not {up!r}"
    with pytest.raises(InvalidValueError, match=re.escape(message)):
        SceneMetadata(up=up)


def test_coordinates_of_an_initial_view_are_finite_numbers() -> None:
    with pytest.raises(InvalidValueError, match=r"StartView\.eye: expected a tuple of 3 numbers"):
        StartView((float("nan"), 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))


@pytest.mark.parametrize(
    ("view", "problem"),
    [(((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), (0.0, 1.0, 0.0)), r"eye and target are the same point, \(1.0, 2.0, 3.0\)"),
     (((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), r"the up direction \(0.0, 0.0, 0.0\) has no length"),
     (((1e13, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), r"a coordinate is beyond 1e\+12")],
)  # fmt: skip
def test_views_in_which_nothing_can_be_seen_are_refused(view: Any, problem: str) -> None:
    with pytest.raises(InvalidValueError, match=f"StartView: {problem}"):
        StartView(*view)


@pytest.mark.parametrize("end", [".glb", ".sog"])
@pytest.mark.parametrize(
    ("view", "problem"),
    [([1, 2, 3, 1, 2, 3, 0, 1, 0], "eye and target are the same point"), ([1, 2, 3], "not 3"),
     ([1, 2, math.nan, 0, 0, 0, 0, 1, 0], "not nan"), ("front", "not 'front'")],
)  # fmt: skip
def test_a_view_in_metadata_that_is_left_out_is_named(
    end: str, view: object, problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    path = tmp_path / f"a{end}"
    with monkeypatch.context() as patched:
        patched.setattr(_asset, "metadata_to_json", lambda known: {**metadata_to_json(known), "view": view})
        write_splats([some_splats(20, 0)], path, metadata=ALL)
    assert read_content(path).metadata == dataclasses.replace(ALL, view=None)
    assert f"{path}: 'view' of its metadata is left out: " in caplog.text
    assert problem in caplog.text


def test_a_view_that_is_too_far_from_the_origin_is_left_out_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_splats([some_splats(30, 0)], tmp_path / "a.ply", origin=(-500_000.0, 4_000_000.0, 100.0))
    data = (tmp_path / "a.ply").read_bytes()
    view = b"comment view: 1e12 0 0 0 0 0 0 -1 0\nelement"
    content = read_content(write(tmp_path / "b.ply", data.replace(b"element", view, 1)))
    assert (content.splats.num_gaussians, content.metadata.view) == (30, None)
    assert (
        "view is left out: relative to the origin -500000 4000000 100: StartView: a coordinate is beyond" in caplog.text
    )


@pytest.mark.parametrize("length", [0.5000000001, 1.9999999999])
def test_an_up_direction_that_float32_rounds_to_a_bound_is_encoded(length: float) -> None:
    view = dataclasses.replace(VIEW, up=(0.0, -length, 0.0))
    stream = encode_scene(SplatScene(some_splats(30, 0), metadata=SceneMetadata(view=view)))
    same(decode_stream(stream).scene.metadata, SceneMetadata(view=VIEW))


@pytest.mark.parametrize("scale", [1e-3, 10.0])
def test_a_view_with_an_up_direction_of_any_length_is_encoded(scale: float) -> None:
    view = dataclasses.replace(VIEW, up=(0.0, -scale, 0.0))
    stream = encode_scene(SplatScene(some_splats(30, 0), metadata=SceneMetadata(view=view)))
    same(decode_stream(stream).scene.metadata, SceneMetadata(view=VIEW))


def test_a_view_that_float32_cannot_express_is_left_out_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    view = StartView((5e6, 0.0, 0.0), (5e6 + 0.01, 0.0, 0.0), (0.0, -1.0, 0.0))
    stream = encode_scene(SplatScene(some_splats(30, 0), metadata=SceneMetadata(view=view)))
    assert decode_stream(stream).scene.metadata.view is None
    assert "its eye and target, (5000000.0, 0.0, 0.0) and (5000000.01, 0.0, 0.0), are the same point" in caplog.text
