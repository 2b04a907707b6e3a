"""Reading of ZIP archives with size limits that are checked before decompression."""

import contextlib
import io
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from splatwire.errors import SplatwireError
from splatwire.files.read_limited import open_regular

MAX_DIRECTORY_BYTES = 1 << 20
"""Maximum size of the archive's directory (list of members), bytes; parsing takes about 15 times the memory."""
_FIRST_MEMBER = b"PK\x03\x04"
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Accepted compression methods; bzip2 and LZMA are excluded, because Python decompresses them in blocks of unbounded
size."""
_END, _END_BYTES, _MAX_COMMENT_BYTES = b"PK\x05\x06", 22, 0xFFFF
"""Tag and size of the record at the end of an archive, and the maximum size of the comment after it, bytes."""
_DAMAGED = (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, UnicodeDecodeError, zlib.error, OSError)


class _LimitedReader(io.BufferedReader):
    """File object from which a ZIP reader reads an archive; limits the size of the archive's list of members.

    While the attribute `limited` is True, a call of `read` that gets more than `MAX_DIRECTORY_BYTES` bytes raises an
    error.
    """

    limited = True

    def read(self, size: int | None = -1, /) -> bytes:
        if not self.limited:
            return super().read(size)
        num_requested = MAX_DIRECTORY_BYTES + 1 if size is None or size < 0 else min(size, MAX_DIRECTORY_BYTES + 1)
        data = super().read(num_requested)
        if len(data) > MAX_DIRECTORY_BYTES:
            raise zipfile.BadZipFile(f"its list of members is longer than {MAX_DIRECTORY_BYTES} bytes")
        return data


class Archive:
    """An open ZIP archive.

    Args:
        path: The file, for messages.
        file: The open file.
        bundle: ZIP reader of `file`.
        error: Exception class to raise for a damaged archive.

    Attributes:
        sizes: Decompressed size of each member in bytes, by name.
    """

    def __init__(
        self, path: Path, file: io.BufferedReader, bundle: zipfile.ZipFile, error: type[SplatwireError]
    ) -> None:
        self._path, self._file, self._bundle, self._error = path, file, bundle, error
        self.sizes = {entry.filename: entry.file_size for entry in bundle.infolist()}
        self._left = path.stat().st_size

    def bytes_outside(self) -> int:
        """Returns the number of bytes before the first member and after the end of the archive."""
        before = min((entry.header_offset for entry in self._bundle.infolist()), default=0)
        size = self._file.seek(0, io.SEEK_END)  # no second reader, which would move the position of this one
        self._file.seek(max(0, size - _END_BYTES - _MAX_COMMENT_BYTES))
        tail = self._file.read()
        at = tail.rfind(_END)
        comment = int.from_bytes(tail[at + _END_BYTES - 2 : at + _END_BYTES], "little")
        return before + max(0, len(tail) - at - _END_BYTES - comment)

    def read(self, name: str, limit: int) -> bytes:
        """Decompresses a member.

        Args:
            name: Name of the member.
            limit: Maximum decompressed size, bytes.

        Raises:
            SplatwireError: If the member is missing, larger than the limit, compressed with a method other than
                deflate, or damaged.
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
        """Reads an uncompressed member of an archive.

        Raises:
            SplatwireError: If the member is compressed, members overlap, or `read` fails.
        """
        if name in self.sizes and self._bundle.getinfo(name).compress_type != zipfile.ZIP_STORED:
            raise self._error(f"{self._path}: {name[:80]} is packed, PyTorch stores it as it is")
        data = self.read(name, limit)
        self._left -= len(data)
        if self._left < 0:
            raise self._error(f"{self._path}: its members overlap")
        return data

    def refuse_packed(self) -> None:
        """Checks that all members of the archive are uncompressed and do not overlap.

        Reading the members then needs little memory.

        Raises:
            SplatwireError: If a member is compressed, or members overlap.
        """
        for entry in self._bundle.infolist():
            if entry.compress_type != zipfile.ZIP_STORED:
                raise self._error(f"{self._path}: {entry.filename[:80]} is packed, PyTorch stores it as it is")
        if sum(self.sizes.values()) > self._path.stat().st_size or len(self.sizes) != len(self._bundle.infolist()):
            raise self._error(f"{self._path}: its members overlap")


def _begins_as_zip(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(len(_FIRST_MEMBER)) == _FIRST_MEMBER


@contextlib.contextmanager
def open_archive(path: Path, error: type[SplatwireError]) -> Iterator[Archive]:
    """Opens a ZIP archive.

    Args:
        path: The file.
        error: Exception class to raise for a damaged archive.

    Raises:
        SplatwireError: An exception of class `error` if the path is not an ordinary file, or the file is not an
            archive, is damaged, or has two members with the same name.
    """
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(_LimitedReader(open_regular(path, error).detach()))
        try:
            bundle = stack.enter_context(zipfile.ZipFile(file))
        except _DAMAGED as problem:
            raise _damaged(path, problem, error) from problem
        file.limited = False
        names = [entry.filename for entry in bundle.infolist()]
        if len(set(names)) < len(names):
            twice = next(name for name, count in Counter(names).items() if count > 1)
            raise error(f"{path}: the zip has two members {twice[:80]!r}")
        yield Archive(path, file, bundle, error)


def _damaged(path: Path, problem: Exception, error: type[SplatwireError]) -> SplatwireError:
    if isinstance(problem, zipfile.BadZipFile) and _begins_as_zip(path) and not zipfile.is_zipfile(path):
        size = path.stat().st_size
        return error(f"{path}: the zip is cut after {size:,} bytes: the list of its members at the end is missing")
    return error(f"{path}: the zip is damaged: {problem}")
