"""Implementation of `splatwire publish`: writes the files of a static web site."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import urlsplit

from splatwire.bitstream import SceneStream, is_stream, read_stream
from splatwire.cli._files import STANDARD, check_folder, check_inputs, stream_name
from splatwire.cli._output import Reporter, print_json, print_summary, progress_bars
from splatwire.cli._subprocess import in_fresh_process
from splatwire.cli.publish import Publish
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.evaluation.thumbnail import picture_bytes, stream_thumbnail
from splatwire.files.atomic_write import atomic_output, atomic_write, remove_unfinished
from splatwire.files.scene_formats import FORMATS
from splatwire.transport.http.pack import check_page_support
from splatwire.transport.http.publish import PublishedScene, published_files

_MARK = "streams.json"
"""File by which a folder of an earlier `publish` is recognised."""


def run(command: Publish) -> None:
    """Runs `splatwire publish`: writes the folder of a static web site with scenes."""
    if not command.scenes or STANDARD in command.scenes:
        raise InvalidValueError("name the streams or files of Gaussians to publish")
    _check_url(command.public_url)
    check_inputs(*map(Path, command.scenes))
    _check_output(command.output)
    named: dict[str, str] = {}
    for source in command.scenes:
        if (other := named.setdefault(_scene_name(source), source)) != source:
            raise InvalidValueError(f"{other} and {source} are both called {_scene_name(source)}: rename one")
    with progress_bars() as report:
        scenes = {
            name: _published(source, report, index / len(named), with_thumbnail=not command.no_thumbnails)
            for index, (name, source) in enumerate(named.items())
        }
        report("reading and drawing", 1.0)
    files = published_files(scenes, command.public_url)
    _write(files, command.output)
    num_bytes = sum(map(len, files.values()))
    if command.json:
        print_json(
            {
                "output": str(command.output),
                "files": {path: len(data) for path, data in files.items()},
                "num_bytes": num_bytes,
            }
        )
    else:
        print_summary(f"{len(scenes)} scenes, {len(files)} files, {num_bytes:,} bytes -> {command.output}")


def _write(files: Mapping[str, bytes], folder: Path) -> None:
    """Writes the files of a site into a folder.

    A new or empty folder gets all files at the same time. In a folder of an earlier `publish`, files are replaced one
    after another.

    Args:
        files: Contents of the files by relative path.
        folder: Folder of the site.
    """
    if folder.is_dir() and any(folder.iterdir()):
        for path, data in files.items():
            atomic_write(folder / path, data, parents=True)
        return
    with atomic_output(folder) as unfinished:
        for path, data in files.items():
            (unfinished / path).parent.mkdir(parents=True, exist_ok=True)
            (unfinished / path).write_bytes(data)


def _check_url(url: str | None) -> None:
    if url is not None and (urlsplit(url).scheme not in ("http", "https") or not urlsplit(url).netloc):
        raise InvalidValueError(f"--public-url is an address such as https://example.org/splats, '{url}' is not")


def _check_output(folder: Path) -> None:
    """Checks that a folder is new, empty, or one that `publish` wrote before.

    Raises:
        InvalidValueError: If the folder has other files, which would be published with the scenes.
    """
    check_folder(folder)
    remove_unfinished(folder)
    if folder.is_dir() and any(folder.iterdir()) and not (folder / _MARK).is_file():
        raise InvalidValueError(f"{folder} has files that `publish` did not write: name a new folder")


def _scene_name(source: str) -> str:
    name = stream_name(source)
    suffixes = sorted((form.suffix for form in FORMATS.all().values()), key=len, reverse=True)
    return next((name[: -len(suffix)] for suffix in suffixes if name.lower().endswith(suffix)), name)


def _published(source: str, report: Reporter, share: float, *, with_thumbnail: bool) -> PublishedScene:
    report("reading and drawing", share)
    stream = _complete_stream(Path(source))
    check_page_support(stream.manifest)
    if not with_thumbnail:
        return PublishedScene(stream)
    return PublishedScene(stream, picture_bytes(stream_thumbnail(stream), ".jpg"))


def _complete_stream(path: Path) -> SceneStream:
    """Returns the stream in a file, or encodes a scene file with the defaults of `encode`.

    Raises:
        BitstreamError: If packets are missing or damaged.
    """
    if not is_stream(path):
        with tempfile.TemporaryDirectory(prefix="splatwire-") as folder:
            encoded = Path(folder) / "scene.swz"
            with in_fresh_process("encode", path, "-o", encoded) as finish:
                finish()
            return read_stream(encoded)[0]
    stream, report = read_stream(path)
    stream.require_scene(path)
    if not report.complete:
        raise BitstreamError(f"{path}: {report.num_missing:,} packets are missing, and a site keeps what it has")
    return stream
