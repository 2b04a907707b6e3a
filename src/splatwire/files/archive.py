"""ZIP archives within limits: what a file of some kilobytes unpacks to is asked before it is unpacked."""

import contextlib
import io
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from splatwire.errors import SplatwireError
from splatwire.files.capped import open_regular

MAX_DIRECTORY_BYTES = 1 << 20
"""Of the list of members; each byte of it takes some 15 in memory."""
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""How members may be packed. Python unpacks those of bzip2 and LZMA a block at a time, whatever comes out of it."""
_DAMAGED = (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, UnicodeDecodeError, zlib.error, OSError)


class _Measured(io.BufferedReader):
    """A file that, while its directory is read, gives no more than such a list may have."""

    limited = True

    def read(self, size: int | None = -1, /) -> bytes:
        if not self.limited:
            return super().read(size)
        asked = MAX_DIRECTORY_BYTES + 1 if size is None or size < 0 else min(size, MAX_DIRECTORY_BYTES + 1)
        data = super().read(asked)
        if len(data) > MAX_DIRECTORY_BYTES:
            raise zipfile.BadZipFile(f"its list of members is longer than {MAX_DIRECTORY_BYTES} bytes")
        return data


class Archive:
    """An open archive.

    Args:
        path: The file, for messages.
        bundle: The open archive.
        error: What is raised.

    Attributes:
        sizes: Bytes of each member when it is unpacked, by name.
    """

    def __init__(self, path: Path, bundle: zipfile.ZipFile, error: type[SplatwireError]) -> None:
        self._path, self._bundle, self._error = path, bundle, error
        self.sizes = {entry.filename: entry.file_size for entry in bundle.infolist()}
        self._left = path.stat().st_size

    def read(self, name: str, limit: int) -> bytes:
        """Unpacks a member.

        Args:
            name: Its name.
            limit: Most bytes that it may have.

        Raises:
            SplatwireError: If it is missing, larger, packed in another way than deflate, or damaged.
        """
        if name not in self.sizes:
            raise self._error(f"{self._path}: {name[:80]} is missing")
        if self.sizes[name] > limit:
            raise self._error(f"{self._path}: {name[:80]} has {self.sizes[name]} bytes, the limit is {limit}")
        method = self._bundle.getinfo(name).compress_type
        if method not in _METHODS:
            raise self._error(f"{self._path}: {name[:80]} is packed with method {method}, only deflate is read")
        try:
            with self._bundle.open(name) as member:
                return member.read(limit)
        except _DAMAGED as problem:
            raise _damaged(self._path, problem, self._error) from problem

    def read_stored(self, name: str, limit: int) -> bytes:
        """Reads a member that is stored as it is; all that are read so together are no larger than the file.

        Raises:
            SplatwireError: If it is packed, as `read` says, or members overlap.
        """
        if name in self.sizes and self._bundle.getinfo(name).compress_type != zipfile.ZIP_STORED:
            raise self._error(f"{self._path}: {name[:80]} is packed, PyTorch stores it as it is")
        data = self.read(name, limit)
        self._left -= len(data)
        if self._left < 0:
            raise self._error(f"{self._path}: its members overlap")
        return data

    def refuse_packed(self) -> None:
        """Checks that members are stored as they are, side by side: then all of them are no larger than the file.

        Raises:
            SplatwireError: If one is packed, or they overlap.
        """
        for entry in self._bundle.infolist():
            if entry.compress_type != zipfile.ZIP_STORED:
                raise self._error(f"{self._path}: {entry.filename[:80]} is packed, PyTorch stores it as it is")
        if sum(self.sizes.values()) > self._path.stat().st_size or len(self.sizes) != len(self._bundle.infolist()):
            raise self._error(f"{self._path}: its members overlap")


@contextlib.contextmanager
def open_archive(path: Path, error: type[SplatwireError]) -> Iterator[Archive]:
    """Opens a ZIP archive.

    Args:
        path: The file.
        error: What is raised: the kind of error that the caller's room speaks of.

    Raises:
        SplatwireError: An `error` if it is no ordinary file, no archive, or damaged.
    """
    open_regular(path, error).close()
    with contextlib.ExitStack() as stack:
        try:
            file = stack.enter_context(_Measured(io.FileIO(path)))
            bundle = stack.enter_context(zipfile.ZipFile(file))
        except _DAMAGED as problem:
            raise _damaged(path, problem, error) from problem
        file.limited = False
        yield Archive(path, bundle, error)


def _damaged(path: Path, problem: Exception, error: type[SplatwireError]) -> SplatwireError:
    return error(f"{path}: the zip is damaged: {problem}")
