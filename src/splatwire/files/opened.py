"""Paths that keep their file open, so that format detection and readers open each file only once."""

import os
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from splatwire.files.kinds import Kind

    _NativePath = Path
else:
    _NativePath = type(Path())


class OpenedFile(_NativePath):
    """Path of a file that stays open, created by `splatwire.files.kinds.opened`.

    Format detection and readers of this package use the open file. All other code can use the object as a path.
    """

    _file: BufferedReader | None = None
    _kind: "Kind | None" = None

    @property
    def kind(self) -> "Kind | None":
        """Detected file format, or None if the path is not open."""
        return self._kind

    def attach(self, kind: "Kind", file: BufferedReader | None) -> None:
        """Stores the detected format and the open file.

        Args:
            kind: The detected format.
            file: The open file; None for a folder or an unreadable path.
        """
        self._kind, self._file = kind, file

    def detach(self) -> None:
        """Closes the open file of this path and forgets its detected format; only the path itself remains.

        Readers then open the file again by its path. Without an open file, nothing is closed.
        """
        if self._file is not None:
            self._file.close()
        self._kind = self._file = None

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        """Returns the status of the open file (see `Path.stat`), even if another file has replaced it at this path."""
        if self._file is not None and follow_symlinks:
            return os.fstat(self._file.fileno())
        return super().stat(follow_symlinks=follow_symlinks)

    def reader(self) -> BufferedReader | None:
        """Returns a file object for reading the open file from its first byte; None if no file is open.

        The caller must close the file object. File objects from several calls share one reading position. Reading from
        any of these objects moves the position. Each further call resets it to the first byte.
        """
        if self._file is None:
            return None
        # all file objects share one position in the file
        file = os.fdopen(os.dup(self._file.fileno()), "rb")
        file.seek(0)
        return file
