"""Verbs keep the metadata of a scene."""

from pathlib import Path
from typing import Any

import pytest

from splat_io.formats.handmade import some_splats
from splatwire.bitstream import read_stream
from splatwire.bitstream.sections import sections_of
from splatwire.codec.metadata import read_metadata
from splatwire.io.formats import write_splats
from splatwire.io.formats.dispatch import read_content
from splatwire.types.metadata import SceneMetadata, StartView

KNOWN = SceneMetadata("Garden [/b]", "Ana", "CC0")


def metadata_in(path: Path) -> SceneMetadata:
    return read_metadata(sections_of(read_stream(path)[0]))


@pytest.fixture
def ply(tmp_path: Path) -> Path:
    write_splats([some_splats(200, 1)], tmp_path / "a.ply", metadata=KNOWN)
    return tmp_path / "a.ply"


@pytest.mark.parametrize("up", ["y", "-y", "z"])
def test_explicit_gaussians_keep_metadata_on_a_round_trip(
    run: Any, journey: Path, ply: Path, tmp_path: Path, up: str
) -> None:
    words = ("--up", up, "--cameras", journey / "cameras.json")
    for done in (
        run("encode", ply, "-o", tmp_path / "a.swz", *words),
        run("decode", tmp_path / "a.swz", "-o", tmp_path / "b.spz"),
        run("export", "sog", tmp_path / "b.spz", "-o", tmp_path / "c.sog"),
        run("import", "splats", tmp_path / "c.sog", "-o", tmp_path / "d.ply"),
        run("export", "glb", tmp_path / "d.ply", "-o", tmp_path / "e.glb"),
        run("encode", tmp_path / "e.glb", "-o", tmp_path / "f.swz"),
    ):
        assert done.status == 0, done.err
    first, last = metadata_in(tmp_path / "a.swz"), metadata_in(tmp_path / "f.swz")
    assert (first.title, first.author, first.license, first.up) == ("Garden [/b]", "Ana", "CC0", up)
    assert first.view is not None
    assert last == first


def test_scenes_of_anchors_keep_metadata_on_a_round_trip(run: Any, journey: Path, tmp_path: Path) -> None:
    for done in (
        run("encode", journey / "tiny.scene", "-o", tmp_path / "a.swz", "--up", "z", "--cameras",
            journey / "cameras.json"),
        run("decode", tmp_path / "a.swz", "-o", tmp_path / "b.scene", "--conceal", "drop"),
        run("encode", tmp_path / "b.scene", "-o", tmp_path / "c.swz"),
        run("export", "ply", tmp_path / "b.scene", "-o", tmp_path / "d.ply", "--views", 16),
    ):  # fmt: skip
        assert done.status == 0, done.err
    first = metadata_in(tmp_path / "a.swz")
    assert first.up == "z"
    assert first.view is not None
    assert metadata_in(tmp_path / "c.swz") == first
    assert read_content(tmp_path / "d.ply").metadata == first


def test_metadata_option_overrides_the_file(run: Any, tmp_path: Path) -> None:
    write_splats([some_splats(200, 1)], tmp_path / "a.ply", metadata=SceneMetadata(up="z"))
    for words, up in (((), "z"), (("--up", "-y"), "-y"), (("--up", "y"), "y")):
        assert run("encode", tmp_path / "a.ply", "-o", tmp_path / "a.swz", *words).status == 0
        assert metadata_in(tmp_path / "a.swz").up == up


def test_inspect_shows_metadata(run: Any, ply: Path, tmp_path: Path) -> None:
    assert run("encode", ply, "-o", tmp_path / "a.swz", "--up", "z").status == 0
    expected = {"title": "Garden [/b]", "author": "Ana", "license": "CC0"}
    assert run("inspect", ply, "--json").json["metadata"] == expected
    assert run("inspect", tmp_path / "a.swz", "--json").json["metadata"] == expected | {"up": "z"}
    assert "Garden [/b]" in run("inspect", tmp_path / "a.swz").out


def test_format_without_metadata_warns(run: Any, ply: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert run("export", "splat", ply, "-o", tmp_path / "a.splat").status == 0
    assert "no place for metadata: title, author, license" in caplog.text


@pytest.mark.slow
def test_formats_of_gaussians_warn_of_a_lost_background(run: Any, ply: Path, tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for number in range(2):
        write_splats([some_splats(60, 0)], tmp_path / "frames" / f"{number}.ply")
    for words in ((), ("--background", "1", "1", "0.5")):
        assert run("encode", ply, "-o", tmp_path / "a.swz", *words).status == 0
        assert run("encode", tmp_path / "frames", "-o", tmp_path / "clip.swz", *words).status == 0
        for number, command in enumerate(
            (
                ("decode", tmp_path / "a.swz", "-o", tmp_path / "b.ply"),
                ("export", "sog", tmp_path / "a.swz", "-o", tmp_path / "b.sog"),
                ("convert", tmp_path / "a.swz", tmp_path / f"tiles{len(words)}", "--to", "3dtiles"),
                ("convert", tmp_path / "a.swz", tmp_path / f"levels{len(words)}", "--to", "streamed-sog"),
                ("decode", tmp_path / "clip.swz", "-o", tmp_path / f"clip{len(words)}"),
            )
        ):
            done = run(*command)
            assert done.status == 0, done.err
            text = "such files have no background colour: that of the scene (1, 1, 0.5) will be lost"
            assert done.err.count(text) == bool(words), (number, done.err)


def test_clips_keep_metadata_on_a_round_trip(run: Any, tmp_path: Path) -> None:
    known = SceneMetadata("Garden", "Ana", "CC0", "z", StartView((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
    (tmp_path / "frames").mkdir()
    for number in range(3):
        metadata = known if number == 0 else SceneMetadata("later frame")
        write_splats([some_splats(60, 0)], tmp_path / "frames" / f"{number}.ply", metadata=metadata)
    for done in (
        run("encode", tmp_path / "frames", "-o", tmp_path / "a.swz"),
        run("decode", tmp_path / "a.swz", "-o", tmp_path / "b"),
        run("encode", tmp_path / "b", "-o", tmp_path / "c.swz"),
    ):
        assert done.status == 0, done.err
    assert metadata_in(tmp_path / "a.swz") == metadata_in(tmp_path / "c.swz") == known
    assert read_content(tmp_path / "b" / "frame_2.ply").metadata == known
    shown = run("inspect", tmp_path / "a.swz")
    assert all(text in shown.out for text in ("Garden", "Ana", "CC0"))


def test_up_axis_option_overrides_that_of_the_frames(run: Any, tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    write_splats([some_splats(60, 0)], tmp_path / "frames" / "0.ply", metadata=SceneMetadata(up="z"))
    for up, expected in (("-y", None), ("y", "y")):
        assert run("encode", tmp_path / "frames", "-o", tmp_path / "a.swz", "--up", up).status == 0
        assert metadata_in(tmp_path / "a.swz").up == expected
