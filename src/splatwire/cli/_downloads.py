"""Downloads of `splatwire serve --downloads`: streams converted to other formats, in separate processes."""

import asyncio
import hashlib
import logging
import mmap
import shutil
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from splatwire.cli._processes import OWN_PROGRAM
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.transport.event_log import log_event
from splatwire.transport.http.downloads import FOLDERS, DownloadedFile

LOG = logging.getLogger("splatwire.transport.downloads")
FORMATS = ("ply", "spz", "sog", "glb", "splat", *FOLDERS)
"""Formats that can be offered."""
MAX_BYTES = 4 << 30
"""Maximum bytes of all files on the disk; the oldest are removed first, and made again on request."""
MAX_SECONDS = 600.0
"""Maximum duration of one conversion, seconds; conversions wait for each other."""
RETRY_S = 600.0
"""Time after a failed conversion in which it is not tried again, seconds. The cause may pass: a busy machine, a full
disk, too little memory."""


@dataclass(frozen=True)
class _FinishedConversion:
    """Result of converting a stream to a file format, ready for download.

    Attributes:
        num_bytes: Size of the file, or of all files of the folder.
        file: The file; None for a folder.
        tags: For a folder, the entity tag (ETag) of each file, by its path in the folder.
    """

    num_bytes: int
    file: DownloadedFile | None = None
    tags: dict[str, str] = field(default_factory=dict)


def check_formats(formats: tuple[str, ...]) -> None:
    """Checks the value of `--downloads`.

    Raises:
        InvalidValueError: If a format is unknown or named twice.
    """
    if unknown := [form for form in formats if form not in FORMATS]:
        raise InvalidValueError(f"--downloads takes {', '.join(FORMATS)}, not {', '.join(unknown)}")
    if twice := next((form for form in formats if formats.count(form) > 1), None):
        raise InvalidValueError(f"--downloads names {twice} twice")


class MadeDownloads:
    """Converter of streams to files of other formats for download.

    Each file is made once and kept in a folder.

    Args:
        folder: Folder of the files; the caller removes it.
        formats: File name suffixes without their dot, or names of folder formats.
        most_bytes: Maximum bytes of all files.
        most_seconds: Maximum duration of one conversion, seconds.
        retry_s: Minimum time between attempts of a failed conversion, seconds.
    """

    def __init__(
        self, folder: Path, formats: tuple[str, ...], most_bytes: int = MAX_BYTES, most_seconds: float = MAX_SECONDS,
        retry_s: float = RETRY_S,
    ) -> None:  # fmt: skip
        self._folder, self._formats = folder, formats
        self._most_bytes, self._most_seconds, self._retry_s = most_bytes, most_seconds, retry_s
        self._turn = asyncio.Semaphore(1)
        self._files: dict[tuple[str, str], asyncio.Task[_FinishedConversion]] = {}

    @property
    def formats(self) -> tuple[str, ...]:
        """File formats offered for download: suffixes without dot, such as `spz`, or names of folder formats."""
        return self._formats

    async def file(self, stream_bytes: bytes, tag: str, format_name: str, part: str = "") -> DownloadedFile | None:
        """Returns a stream converted to the file format `format_name`.

        The conversion takes place at the first request.

        Args:
            stream_bytes: Content of the stream's `.swz` file.
            tag: Entity tag of the stream.
            format_name: One of `formats`.
            part: For a format with several files, path of the requested file in the folder.

        Returns:
            The file; None if the folder has no such file.

        Raises:
            SplatwireError: If the stream cannot be converted.
        """
        # Requests for the same file wait for one process.
        key = (tag, format_name)
        if key not in self._files:
            self._files[key] = asyncio.get_running_loop().create_task(self._make(stream_bytes, tag, format_name))
        download = await asyncio.shield(self._files[key])
        await self._evict(key)
        if download.file is not None or part not in download.tags:
            return download.file
        return DownloadedFile((self._target(tag, format_name) / part).read_bytes(), download.tags[part])

    async def close(self) -> None:
        """Ends a running conversion process, if any."""
        for task in self._files.values():
            task.cancel()
        await asyncio.gather(*self._files.values(), return_exceptions=True)

    def _target(self, tag: str, format_name: str) -> Path:
        return self._folder / f"{tag}.{format_name}"

    async def _make(self, stream_bytes: bytes, tag: str, format_name: str) -> _FinishedConversion:
        try:
            return await self._convert(stream_bytes, tag, format_name)
        except OSError as error:  # such as a full disk: the next request tries again
            del self._files[tag, format_name]
            log_event(LOG, logging.ERROR, "download failed", format=format_name, error=str(error))
            raise SplatwireError(str(error)) from error
        except SplatwireError:
            asyncio.get_running_loop().call_later(self._retry_s, self._files.pop, (tag, format_name), None)
            raise

    async def _convert(self, stream_bytes: bytes, tag: str, format_name: str) -> _FinishedConversion:
        target = self._target(tag, format_name)
        async with self._turn:
            folder = Path(tempfile.mkdtemp(dir=self._folder))
            try:
                source, made = folder / f"{tag}.swz", folder / f"{tag}.{format_name}"
                await asyncio.to_thread(source.write_bytes, stream_bytes)  # files may be large: other responses go on
                try:
                    await self._run("convert", str(source), str(made), "--to", format_name, "--json")
                except SplatwireError as error:
                    log_event(LOG, logging.ERROR, "download failed", format=format_name, error=str(error))
                    raise
                made.replace(target)
            finally:
                await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)
        download = await asyncio.to_thread(_opened_folder if format_name in FOLDERS else _opened_file, target)
        log_event(LOG, logging.INFO, "download made", format=format_name, bytes=download.num_bytes)
        return download

    async def _run(self, *words: str) -> None:
        """Runs a splatwire subcommand in a separate process, and waits for the process to end.

        Raises:
            SplatwireError: If the subcommand fails, or takes longer than the maximum duration.
        """
        process = await asyncio.create_subprocess_exec(
            *OWN_PROGRAM, *words, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            async with asyncio.timeout(self._most_seconds):
                _, errors = await process.communicate()
        except TimeoutError as error:
            raise SplatwireError(f"the conversion took longer than {self._most_seconds:g} seconds") from error
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        if process.returncode:
            raise SplatwireError(" ".join(errors.decode(errors="replace").split())[-500:])

    async def _evict(self, kept_key: tuple[str, str]) -> None:
        """Removes the oldest converted files until the total size of all is within the limit.

        Args:
            kept_key: Key of a file that is not removed.
        """
        # Responses that are still sending a removed file are not affected.
        done = {key: task for key, task in self._files.items() if task.done() and not task.exception()}
        total = sum(task.result().num_bytes for task in done.values())
        removed = []
        for key, task in done.items():
            if total <= self._most_bytes:
                break
            if key != kept_key:
                total -= task.result().num_bytes
                folder = Path(tempfile.mkdtemp(dir=self._folder))
                self._target(*key).replace(folder / "removed")  # the file may be made again while this one is removed
                del self._files[key]
                removed.append(folder)
        for folder in removed:  # a folder may have thousands of files: other responses go on
            await asyncio.to_thread(shutil.rmtree, folder, ignore_errors=True)


def _opened_file(path: Path) -> _FinishedConversion:
    with path.open("rb") as file:
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    return _FinishedConversion(len(data), DownloadedFile(data, _tag(data)))


def _opened_folder(path: Path) -> _FinishedConversion:
    """Prepares a folder for download: computes the total size, and the entity tag of each file."""
    # Unlike a single file, the files of a folder are not kept open, because there may be thousands.
    total, tags = 0, {}
    for file in path.rglob("*"):
        if file.is_file():
            data = file.read_bytes()
            total += len(data)
            tags[file.relative_to(path).as_posix()] = _tag(data)
    return _FinishedConversion(total, tags=tags)


def _tag(data: bytes | mmap.mmap) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
