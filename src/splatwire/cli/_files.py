"""Input and output paths of subcommands; `-` means standard input or standard output."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splatwire.bitstream import ReadReport, is_stream
from splatwire.bitstream.stream import FILE_SUFFIX
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.files.atomic_write import atomic_output, check_writable, remove_unfinished
from splatwire.files.kinds import EMPTY, TEXT, UNKNOWN, kind_of_bytes, opened
from splatwire.files.names import real_path

STANDARD = "-"
_FORMATS = {
    FILE_SUFFIX: "a stream",
    ".ply": "a PLY",
    ".splat": "a .splat file",
    ".spz": "an SPZ file",
    ".ksplat": "a .ksplat file",
    ".sog": "a SOG file",
    ".glb": "a glTF file",
    ".gltf": "a .gltf file",
    ".usd": "a USD file",
    ".usda": "a USD file",
    ".usdc": "a USD file",
    ".usdz": "a USD file",
    ".4dgs": "a .4dgs file",
    ".splat4d": "a .splat4d file",
    ".splatv": "a .splatv file",
    ".json": "JSON",
    ".toml": "a protocol",
    ".html": "a page",
    ".htm": "a page",
    ".pdf": "a PDF",
    ".csv": "a CSV table",
    ".parquet": "a Parquet table",
    ".md": "a text",
    ".txt": "a text",
    ".zip": "a ZIP archive",
    ".png": "a PNG picture",
    ".jpg": "a JPEG picture",
    ".jpeg": "a JPEG picture",
    ".webp": "a WebP picture",
    ".gif": "a GIF picture",
    ".apng": "an APNG picture",
    ".avif": "an AVIF picture",
    ".bmp": "a BMP picture",
    ".tif": "a TIFF picture",
    ".tiff": "a TIFF picture",
    ".exr": "an EXR picture",
    ".mp4": "a video",
    ".m4v": "a video",
    ".mov": "a video",
    ".mkv": "a video",
    ".avi": "a video",
    ".webm": "a video",
}
"""File format that each known suffix stands for. Suffixes of one format have the same text."""
_HEAD_BYTES = 1 << 16


def stream_name(path: str) -> str:
    """Returns the name under which clients request a stream.

    Raises:
        InvalidValueError: If the name of the file is not valid UTF-8.
    """
    # The name is part of addresses and pages, which need valid Unicode.
    name = "scene" if path == STANDARD else real_path(Path(path)).name.removesuffix(FILE_SUFFIX)
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise InvalidValueError(f"{path}: the name of the file is not valid UTF-8: rename it") from error
    return name


@contextmanager
def input_path(name: str) -> Iterator[Path]:
    """Yields the path of an input; standard input is first copied to a temporary file.

    Raises:
        InvalidValueError: If standard input is closed.
        BitstreamError: If standard input is empty, text, or of an unknown format.
    """
    if name != STANDARD:
        with opened(Path(name)) as path:
            yield path
        return
    if sys.stdin is None:
        raise InvalidValueError("standard input is closed: there is nothing to read")
    head = sys.stdin.buffer.read(_HEAD_BYTES)
    kind = kind_of_bytes(head, len(head))
    if kind in (EMPTY, UNKNOWN, TEXT):  # an endless pipe would fill the disk
        raise BitstreamError(f"standard input is neither stream nor scene, but {kind}")
    with tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
        path = Path(folder) / "standard_input"
        with path.open("wb") as file:
            file.write(head)
            shutil.copyfileobj(sys.stdin.buffer, file)
        with opened(path) as source:
            yield source


@contextmanager
def output_path(name: str, *, expected_suffix: str = "", json: bool = False) -> Iterator[Path]:
    """Yields the path to write to.

    For standard output, this is a temporary file that is copied to standard output at the end.

    Args:
        name: Output path given by the user, or `-`.
        expected_suffix: File name suffix of the written format, with its dot; empty for a scene file. A name with the
            suffix of another known format is refused; names with unknown or no suffix are accepted.
        json: True if standard output is reserved for a JSON object.

    Raises:
        InvalidValueError: If both the data and the JSON object would go to standard output, the suffix is that of
            another format, or the output cannot be written.
    """
    if name != STANDARD:
        yield prepared_output(Path(name), folder=expected_suffix == FILE_SUFFIX, expected_suffix=expected_suffix)
        return
    if sys.stdout is None:
        raise InvalidValueError("standard output is closed: give -o a file")
    if json:
        raise InvalidValueError("--json and -o - both want standard output; give -o a file")
    with tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
        path = Path(folder) / f"standard_output{expected_suffix}"
        yield path
        with path.open("rb") as file:
            shutil.copyfileobj(file, sys.stdout.buffer)
        sys.stdout.buffer.flush()


def prepared_output(path: Path, *, folder: bool = False, expected_suffix: str | None = None) -> Path:
    """Checks, before any computation, that an output path can be written; returns the path unchanged.

    Args:
        path: Output path.
        folder: True if the output may be a folder.
        expected_suffix: File name suffix of the written format, with its dot; empty for a scene file. A name with the
            suffix of another known format is refused; names with unknown or no suffix are accepted. None for no check
            of the suffix.

    Returns:
        The path.

    Raises:
        InvalidValueError: If the path exists and is not an ordinary file, its parent folder does not exist or is not
            writable, or the suffix is that of another format.
    """
    # Outputs are written to a temporary file that then replaces the target, which must not happen to a device such as
    # `/dev/null`.
    if expected_suffix is not None and (named := _FORMATS.get(path.suffix.lower())) is not None:
        expected = expected_suffix.lower()
        written = _FORMATS.get(expected) or (f"a {expected} file" if expected else "a scene file")
        if named != written:
            raise InvalidValueError(
                f"{path}: the name says {named}, but {written} would be in it: end it in {expected or '.scene'}"
            )
    if path.is_dir() and not folder:
        raise InvalidValueError(f"{path} is a folder: name a file")
    if path.exists() and not path.is_dir() and not path.is_file():
        raise InvalidValueError(f"{path} is no ordinary file and would be replaced by one: name another")
    check_writable(path)
    return path


def refuse_own_input(output: str | Path, *inputs: str | Path | None) -> None:
    """Checks that an output does not replace an input, whose content would be lost.

    Args:
        output: Output path given by the user; `-` for standard output.
        *inputs: Inputs given by the user; `-` for standard input, None for options that are not set.

    Raises:
        InvalidValueError: If the output is the file or folder of an input, under any name.
    """
    for name in inputs:
        is_standard = str(name) == STANDARD
        if name is None or str(output) == STANDARD or (is_standard and sys.stdin is None):
            continue
        try:
            source = sys.stdin.fileno() if is_standard else name  # of a shell's `< FILE`
            is_same = os.path.samestat(os.stat(source), os.stat(output))
        except (OSError, ValueError):  # one of them does not exist
            continue
        if is_same:
            shown = "standard input" if is_standard else name
            raise InvalidValueError(f"{output} is the input {shown}, which would be lost: name another output")


@contextmanager
def output_folder(name: str) -> Iterator[Path]:
    """Yields a temporary folder that becomes the output folder on success.

    Raises:
        InvalidValueError: If a folder of that name exists and is not empty.
    """
    target = Path(name)
    check_folder(target)
    remove_unfinished(target)
    check_empty(target)
    with atomic_output(target) as made:
        made.mkdir()
        yield made


def check_empty(path: Path) -> None:
    """Checks that an output folder is missing or empty, so that its files are not mixed with earlier ones.

    Raises:
        InvalidValueError: If the path exists and is not an empty folder.
    """
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InvalidValueError(f"{path} is there already and not empty: name a new folder")


def check_folder(path: Path, instead: str = "name a folder") -> None:
    """Checks that an output folder can be created, before the work starts.

    Args:
        path: Output path given by the user.
        instead: Hint for users who want a file.

    Raises:
        InvalidValueError: If the path exists and is not a folder, its parent folder does not exist or is not writable,
            a new folder would have the suffix of a file format, or the path means standard output.
    """
    if str(path) == STANDARD:
        raise InvalidValueError("a folder is written, which standard output cannot be: give -o a name")
    if path.exists() and not path.is_dir():
        raise InvalidValueError(f"{path}: not a folder, so nothing can be written into it")
    if not path.exists() and (named := _FORMATS.get(path.suffix.lower())) is not None:
        raise InvalidValueError(f"{path}: the name says {named}, but a folder is written: {instead}")
    check_writable(path, inside=True)


def check_folder_name(name: str, instead: str) -> None:
    """Checks that the name of an output folder does not have the suffix of a file format.

    Args:
        name: Output path given by the user.
        instead: Hint for users who want a file.

    Raises:
        InvalidValueError: If the name has such a suffix.
    """
    if Path(name).suffix.lower() in _FORMATS:
        raise InvalidValueError(f"{name}: a clip is written to a folder, whose name has no such suffix; {instead}")


def check_output(command: Any) -> None:
    """Checks, before a subcommand starts to compute, that its output can be written.

    Args:
        command: The subcommand's options; `output` is the path to check.

    Raises:
        InvalidValueError: If the output cannot be written.
    """
    # subcommands of `calibrate` have their options in `addition`
    for holder in (command, getattr(command, "addition", None)):
        output = getattr(holder, "output", None)
        if output is not None and str(output) != STANDARD:
            path = Path(output)
            check_writable(path, inside=path.is_dir() and not is_stream(path))


def check_inputs(*paths: Path | None) -> None:
    """Raises an error if an input file or folder is missing, before any computation.

    Raises:
        InvalidValueError: If a path does not exist.
    """
    for path in paths:
        if path is not None and not path.exists():
            raise InvalidValueError(f"{path}: no such file or folder")


def read_report_json(report: ReadReport) -> dict[str, object]:
    """Converts the report on missing and damaged packets of a stream to JSON values."""
    return {
        "num_expected": report.num_expected,
        "num_received": report.num_received,
        "num_missing": report.num_missing,
        "num_corrupt": report.num_corrupt,
        "num_foreign": report.num_foreign,
        "num_duplicate": report.num_duplicate,
        "problems": list(report.problems),
    }
