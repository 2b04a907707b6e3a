"""Store of an evaluation: a folder of finished results, which are reused and never partially written.

```
store/
  lock                        lock of the coordinating run
  inputs/<key>/...            encoded streams; rendered reference images, one file per view
  masks/<scene>/<stream>/...  loss masks, for other codecs
  units/<key>.parquet         the records of one task
  pictures/...                images of tasks for the report
```

Files are written atomically. Concurrent writers of one result write the same content.
"""

import errno
import fcntl
import json
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.arguments import CheckedFields
from splatwire.errors import SplatwireError
from splatwire.evaluation.pixels import png_pixels
from splatwire.evaluation.study.input_files import InputFiles
from splatwire.evaluation.study.records import Record, parquet, records_from_bytes, records_to_bytes
from splatwire.files.atomic_write import atomic_write, remove_unfinished

UNIT_SUFFIX = ".parquet"


@dataclass(frozen=True)
class Store(CheckedFields):
    """Folder with the inputs and results of an evaluation.

    Attributes:
        root: The folder.
        files: Reader of the streams and scene files.
    """

    root: Path
    files: InputFiles = field(default_factory=InputFiles, compare=False)

    def unit_path(self, key: str) -> Path:
        """Path of the file with the scores of a task, one record per view."""
        return self.root / "units" / f"{key}{UNIT_SUFFIX}"

    def has(self, key: str) -> bool:
        """Returns True if the results of a task are in the store."""
        return self.unit_path(key).is_file()

    def records(self, key: str) -> list[Record]:
        """Reads the records of a finished task, in the order of the views.

        Raises:
            SplatwireError: If the records are missing, or belong to another task.
        """
        path = self.unit_path(key)
        try:
            records = records_from_bytes(path.read_bytes(), str(path))
        except FileNotFoundError as error:
            raise SplatwireError(f"{path} is missing although its worker said that it is done") from error
        if not records or any(record.unit != key for record in records):
            raise SplatwireError(f"{path} does not hold the records of its unit: remove it and start again")
        return records

    def write(self, name: str, data: bytes) -> Path:
        """Writes a file of the store atomically.

        Args:
            name: Path within the store.
            data: Its content.

        Raises:
            SplatwireError: If the disk is full; nothing is left behind.
            OSError: If the system call fails for another reason.
        """
        return _write(self.root / name, data)

    def picture(self, name: str) -> np.ndarray:
        """Reads an image of the store as RGB, uint8, (H, W, 3).

        Args:
            name: Path within the store.

        Raises:
            SplatwireError: If the image is missing or damaged.
        """
        path = self.root / name
        try:
            return png_pixels(path.read_bytes())
        except (OSError, ValueError, SyntaxError, struct.error, zlib.error) as error:  # PIL raises all of them
            raise SplatwireError(f"{path} is damaged: {error}; remove it and start again") from error

    def put_records(self, key: str, records: Sequence[Record]) -> None:
        """Writes the records of a task, which marks the task as finished."""
        _write(self.unit_path(key), records_to_bytes(records))

    def check_records(self) -> None:
        """Checks, before the work starts, that records can be written.

        Raises:
            BackendUnavailableError: If the Parquet library is not installed.
        """
        parquet()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Locks the store for one run, and removes unfinished files of killed processes.

        Raises:
            SplatwireError: If another run has the lock.
            BackendUnavailableError: If records cannot be written, because the Parquet library is not installed.
        """
        self.check_records()
        self.root.mkdir(parents=True, exist_ok=True)
        with open(self.root / "lock", "a", opener=_without_links) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                reason = f"another run is working in {self.root}: wait for it, or take another folder"
                raise SplatwireError(reason) from error
            self._tidy()
            try:
                yield
            except BaseException:
                with suppress(OSError):  # the first error matters
                    self._tidy()  # workers may have been ended while they wrote, as by Ctrl-C
                raise

    def _tidy(self) -> None:
        """Removes unfinished files of killed processes."""
        folders = (path for path in self.root.rglob("*") if path.is_dir() and not path.is_symlink())
        for folder in [self.root, *folders]:
            remove_unfinished(folder)


@dataclass(frozen=True)
class MemoryStore(Store):
    """Store for an evaluation that cannot be resumed: scores are kept in memory, all other files in a folder."""

    _finished: dict[str, list[Record]] = field(default_factory=dict)

    def has(self, key: str) -> bool:
        """Returns True if the results of a task are in memory."""
        return key in self._finished

    def records(self, key: str) -> list[Record]:
        """Returns the records of a finished task, in the order of the views."""
        return self._finished[key]

    def check_records(self) -> None:
        """Does nothing, because records in memory need no optional package."""

    def put_records(self, key: str, records: Sequence[Record]) -> None:
        """Stores the records of a task in memory, which marks the task as finished."""
        self._finished[key] = list(records)


def _without_links(path: str, flags: int) -> int:
    """Opener for `open` that raises OSError for a symbolic link."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o666)


def _write(path: Path, data: bytes) -> Path:
    try:
        return atomic_write(path, data, parents=True)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            reason = f"the disk is full: {path} could not be written; make room and start again, "
            raise SplatwireError(f"{reason}finished work is kept") from error
        raise


def read_json(path: Path) -> dict[str, Any] | None:
    """Reads a JSON object of the store; None if the file is missing."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise SplatwireError(f"{path} is damaged: {error}; remove it and start again") from error
    if not isinstance(content, dict):
        raise SplatwireError(f"{path} is damaged: remove it and start again")
    return content
