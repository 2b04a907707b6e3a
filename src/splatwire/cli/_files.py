"""What the verbs read and write; `-` is standard input or output."""

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.files.kinds import EMPTY, TEXT, UNKNOWN, kind_of_bytes

if TYPE_CHECKING:
    from splatwire.packets import ReadReport

STANDARD = "-"
STREAM_SUFFIX = ".swz"
_FORMATS = {
    STREAM_SUFFIX: "a stream",
    ".ply": "a PLY",
    ".splat": "a .splat file",
    ".spz": "an SPZ file",
    ".ksplat": "a .ksplat file",
    ".sog": "a SOG file",
    ".glb": "a glTF file",
    ".json": "JSON",
    ".toml": "a protocol",
    ".html": "a page",
    ".zip": "a ZIP archive",
    ".png": "a picture",
    ".jpg": "a picture",
    ".jpeg": "a picture",
}
"""What a name promises by its suffix."""
_HEAD_BYTES = 1 << 16


def stream_name(path: str) -> str:
    """What a stream is called: clients ask for it by this name, pages have it as their title."""
    return "scene" if path == STANDARD else Path(path).resolve().name.removesuffix(STREAM_SUFFIX)


@contextmanager
def input_path(name: str) -> Iterator[Path]:
    """Gives the path to read from; standard input is first copied to a temporary file.

    Raises:
        InvalidValueError: If standard input is closed.
        BitstreamError: If what it begins with is nothing that is read here.
    """
    if name != STANDARD:
        yield Path(name)
        return
    if sys.stdin is None:
        raise InvalidValueError("standard input is closed: there is nothing to read")
    head = sys.stdin.buffer.read(_HEAD_BYTES)
    kind = kind_of_bytes(head, len(head))
    if kind in (EMPTY, UNKNOWN, TEXT):  # an endless pipe would fill the disk before anybody looked at it
        raise BitstreamError(f"standard input is neither stream nor scene, but {kind}")
    with tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
        path = Path(folder) / "standard_input"
        with path.open("wb") as file:
            file.write(head)
            shutil.copyfileobj(sys.stdin.buffer, file)
        yield path


@contextmanager
def output_path(name: str, *, suffix: str = "", json: bool = False) -> Iterator[Path]:
    """Gives the path to write to; for standard output a temporary file whose content is copied at the end.

    Args:
        name: What the user said.
        suffix: Suffix that names of such a file have, with its dot; empty for scene files, which have no fixed one.
        json: Whether standard output is promised to a JSON object.

    Raises:
        InvalidValueError: If both the data and the JSON object would go to standard output, or nothing can be written
            under that name.
    """
    if name != STANDARD:
        yield prepared_output(Path(name), folder=suffix == STREAM_SUFFIX, suffix=suffix)
        return
    if sys.stdout is None:
        raise InvalidValueError("standard output is closed: give -o a file")
    if json:
        raise InvalidValueError("--json and -o - both want standard output; give -o a file")
    with tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
        path = Path(folder) / f"standard_output{suffix}"
        yield path
        with path.open("rb") as file:
            shutil.copyfileobj(file, sys.stdout.buffer)
        sys.stdout.buffer.flush()


def prepared_output(path: Path, *, folder: bool = False, suffix: str | None = None) -> Path:
    """Checks an output before the work.

    Files are written beside an old one and then take its name, which must not happen to a device such as `/dev/null`.

    Args:
        path: The output.
        folder: Whether it may be a folder, too.
        suffix: Suffix that names of such a file have; None for any.

    Returns:
        The path.

    Raises:
        InvalidValueError: If there is something else under that name, its folder does not exist, or the name is that
            of another format.
    """
    found = path.suffix.lower()
    if suffix is not None and found in _FORMATS and found != suffix:
        written = _FORMATS.get(suffix, "a scene file")
        raise InvalidValueError(
            f"{path}: the name says {_FORMATS[found]}, but {written} would be in it: end it in {suffix or '.scene'}"
        )
    if path.is_dir() and not folder:
        raise InvalidValueError(f"{path} is a folder: name a file")
    if path.exists() and not path.is_dir() and not path.is_file():
        raise InvalidValueError(f"{path} is no ordinary file and would be replaced by one: name another")
    _check_parent(path)
    return path


def _check_parent(path: Path) -> None:
    """Checks that the folder of an output exists; it is not made, because a mistyped path would make many.

    Raises:
        InvalidValueError: If it does not exist, or is no folder.
    """
    parent = path.absolute().parent
    there = next(folder for folder in (parent, *parent.parents) if folder.exists())
    if not there.is_dir():
        raise InvalidValueError(f"{there}: not a folder, so nothing can be written into it")
    if there != parent:
        raise InvalidValueError(f"{parent}: no such folder, so {path.name} cannot be written into it: make it first")


def check_folder(path: Path) -> None:
    """Checks a folder for outputs before the work; it is made later, but the folder that it is in must exist.

    Raises:
        InvalidValueError: If it cannot be a folder, or the folder that it is in does not exist.
    """
    if path.exists() and not path.is_dir():
        raise InvalidValueError(f"{path}: not a folder, so nothing can be written into it")
    if not path.exists():
        _check_parent(path)


def check_inputs(*paths: Path | None) -> None:
    """Says before the work which input is not there.

    Raises:
        InvalidValueError: If one does not exist; None is none.
    """
    for path in paths:
        if path is not None and not path.exists():
            raise InvalidValueError(f"{path}: no such file or folder")


def is_stream(path: Path) -> bool:
    """See `splatwire.packets.is_stream`."""
    from splatwire.packets import is_stream as found

    return found(path)


def read_report_json(report: "ReadReport") -> dict[str, object]:
    """What reading a stream met with, as JSON."""
    return {
        "num_expected": report.num_expected,
        "num_received": report.num_received,
        "num_missing": report.num_missing,
        "num_corrupt": report.num_corrupt,
        "num_foreign": report.num_foreign,
        "num_duplicate": report.num_duplicate,
        "problems": list(report.problems),
    }
