"""`publish` writes a static site, and `thumb` a picture of a scene."""

import errno
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from explicit import ball_of_gaussians
from splatwire.cli._run_publish import _write
from splatwire.io.formats import write_splats


@pytest.fixture
def cloud(tmp_path):
    write_splats([ball_of_gaussians()], tmp_path / "cloud.ply")
    return tmp_path / "cloud.ply"


@pytest.mark.slow
def test_a_site_is_written_and_updated(run, cloud, tmp_path):
    assert run("encode", cloud, "-o", tmp_path / "room.swz").status == 0
    done = run("publish", tmp_path / "room.swz", cloud, "-o", tmp_path / "site", "--json")
    assert done.status == 0, done.err
    written = {str(path.relative_to(tmp_path / "site")) for path in (tmp_path / "site").rglob("*") if path.is_file()}
    assert written == set(done.json["files"])
    assert {"index.html", "cloud.html"} <= written
    (picture,) = (tmp_path / "site" / "thumbnails").glob("room.*.jpg")
    with Image.open(picture) as image:
        assert (image.format, image.size) == ("JPEG", (1200, 630))
    assert json.loads((tmp_path / "site" / "streams.json").read_text())["streams"][0].startswith("/streams/room.")
    assert run("publish", cloud, "-o", tmp_path / "site", "--no-thumbnails").status == 0
    assert written <= {
        str(path.relative_to(tmp_path / "site")) for path in (tmp_path / "site").rglob("*") if path.is_file()
    }


FILES = {"index.html": b"a", "streams/a.swz": b"b", "streams.json": b"c"}
"""Files of a site, by path."""


def _write_to_a_full_disk(folder, monkeypatch):
    """Writes `FILES` to a folder; the disk is full at the second one."""
    write = Path.write_bytes

    def full(path, data):
        if path.name == "a.swz":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        return write(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(OSError, match="No space left"):
            _write(FILES, folder)


def test_a_full_disk_leaves_no_part_of_a_site(cloud, tmp_path, monkeypatch):
    _write_to_a_full_disk(tmp_path / "site", monkeypatch)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cloud.ply"]
    _write(FILES, tmp_path / "site")
    _write({"index.html": b"d", "b/x.html": b"e"}, tmp_path / "site")
    written = {str(path.relative_to(tmp_path / "site")): path.read_bytes() for path in (tmp_path / "site").rglob("*.*")}
    assert written == FILES | {"index.html": b"d", "b/x.html": b"e"}


def test_an_empty_folder_stays_empty_if_the_disk_is_full_and_keeps_its_permissions(tmp_path, monkeypatch):
    folder = tmp_path / "site"
    folder.mkdir(mode=0o750)
    number = folder.stat().st_ino
    _write_to_a_full_disk(folder, monkeypatch)
    assert not list(folder.iterdir())
    assert folder.stat().st_ino == number
    _write(FILES, folder)
    assert folder.stat().st_mode & 0o777 == 0o750
    written = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*.*")}
    assert written == FILES


@pytest.mark.slow
def test_warnings_about_published_files_are_printed(run, cloud, tmp_path):
    cloud.write_bytes(cloud.read_bytes().replace(b"element vertex", b"comment unit: cm\nelement vertex", 1))
    done = run("publish", cloud, "-o", tmp_path / "site", "--no-thumbnails")
    assert done.status == 0, done.err
    assert f"splatwire: warning: {cloud}: comment 'unit: cm' may be the unit of the positions" in done.err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "site"], "name the streams"),
        (["-", "-o", "site"], "name the streams"),
        (["cloud.ply", "-o", "."], "did not write"),
        (["cloud.ply", "-o", "site", "--public-url", "example.org"], "--public-url"),
        (["cloud.ply", "cloud.spz", "-o", "site"], "both called cloud"),
        (["missing.swz", "-o", "site"], "no such file"),
    ],
)
def test_invalid_arguments_are_one_error_line(run, cloud, tmp_path, monkeypatch, words, message):
    write_splats([ball_of_gaussians()], tmp_path / "cloud.spz")
    monkeypatch.chdir(tmp_path)
    done = run("publish", *words)
    assert done.status == 2
    assert message in done.err
    assert not (tmp_path / "site").exists()


@pytest.mark.parametrize("suffix", ["jpg", "png", "webp"])
def test_a_thumbnail_shows_all_of_the_scene(run, cloud, tmp_path, suffix):
    done = run("thumb", cloud, "-o", tmp_path / f"a.{suffix}", "--size", 200, 120, "--json")
    assert done.status == 0, done.err
    with Image.open(io.BytesIO((tmp_path / f"a.{suffix}").read_bytes())) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert pixels.shape == (120, 200, 3)
    assert pixels.max() > 60  # the scene is shown
    edges = [pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]]
    assert max(int(edge.mean()) for edge in edges) < pixels[40:80, 80:120].mean() / 4  # and nothing of it is cut off


def test_a_thumbnail_of_a_stream_is_its_initial_view(run, cloud, journey, tmp_path):
    words = ("encode", cloud, "-o", tmp_path / "a.swz", "--cameras", journey / "cameras.json")
    assert run(*words).status == 0
    assert run("thumb", tmp_path / "a.swz", "-o", tmp_path / "a.png", "--size", 64, 64).status == 0
    assert run("encode", cloud, "-o", tmp_path / "b.swz").status == 0
    assert run("thumb", tmp_path / "b.swz", "-o", tmp_path / "b.png", "--size", 64, 64).status == 0
    assert (tmp_path / "a.png").read_bytes() != (tmp_path / "b.png").read_bytes()


def test_other_suffixes_and_sizes_are_refused(run, cloud, tmp_path):
    assert ".jpg" in run("thumb", cloud, "-o", tmp_path / "a.gif").err
    assert "4096" in run("thumb", cloud, "-o", tmp_path / "a.jpg", "--size", 0, 5).err
