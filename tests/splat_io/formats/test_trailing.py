"""Bytes outside of a file's content, such as a second file that was appended, give a warning."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from splat_io.formats.handmade import ksplat, some_splats, write
from splatwire.io.formats import read_splats, write_splats
from splatwire.io.formats.spz_writer import write_spz


def _write(path: Path) -> None:
    write_splats([some_splats(30, degree=1)], path)


WRITERS: dict[str, Callable[[Path], object]] = {
    "a.spz": _write,
    "a.sog": _write,
    "a.glb": _write,
    "b.ksplat": lambda path: path.write_bytes(ksplat()),
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("appended", ["text", "zeros", "the file itself"])
def test_bytes_after_the_end_give_a_warning(
    name: str, appended: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / name
    WRITERS[name](path)
    before, data = read_splats(path), path.read_bytes()
    assert not caplog.messages
    more = {"text": b"and more", "zeros": bytes(64), "the file itself": data}[appended]
    after = read_splats(write(tmp_path / f"longer_{name}", data + more))
    assert after.num_gaussians == before.num_gaussians
    (message,) = caplog.messages
    assert f"{len(more):,} bytes" in message
    assert f"longer_{name}" in message


def test_a_comment_of_a_zip_is_part_of_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.sog"
    _write(path)
    data = path.read_bytes()
    write(path, data[:-2] + (5).to_bytes(2, "little") + b"hello")
    read_splats(path)
    assert not caplog.messages


def test_a_sog_is_read_with_its_members_in_any_order(tmp_path: Path) -> None:
    """Members are larger than the buffer of a file."""
    write_splats([some_splats(8000, degree=0)], tmp_path / "a.sog")
    with zipfile.ZipFile(tmp_path / "a.sog") as source:
        names = source.namelist()
        for first in names:
            path = tmp_path / f"{first}.sog"
            with zipfile.ZipFile(path, "w") as target:
                for name in sorted(names, key=lambda name: (name != first, name)):
                    target.writestr(name, source.read(name))
            assert read_splats(path).num_gaussians == 8000


def test_a_second_spz_of_version_3_gives_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.spz"
    write_spz([some_splats(30)], path, version=3)
    read_splats(write(tmp_path / "twice.spz", path.read_bytes() * 2))
    (message,) = caplog.messages
    assert "may be extensions" in message
