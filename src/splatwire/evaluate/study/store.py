"""One folder holds everything that a protocol made: what is finished there is never computed again, nothing is half.

```
store/
  lock                        held by the run that coordinates
  inputs/<key>/...            encoded streams; reference pictures that were drawn, a file for each view: made once
  masks/<scene>/<stream>/...  which packets arrived, for other codecs
  units/<key>.parquet         the records of one unit of work
  pictures/...                what the report shows of units
```

Files appear under their names only when they are complete; two writers of one unit write the same content.
"""

import errno
import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splatwire.errors import SplatwireError
from splatwire.evaluate.study.records import Record, parquet, records_from_bytes, records_to_bytes
from splatwire.files.whole import remove_unfinished, write_whole

UNIT_SUFFIX = ".parquet"


@dataclass(frozen=True)
class Store:
    """Paths of a store, and how its files come to be.

    Attributes:
        root: The folder.
    """

    root: Path

    def unit_path(self, key: str) -> Path:
        """Where the records of a unit lie."""
        return self.root / "units" / f"{key}{UNIT_SUFFIX}"

    def has(self, key: str) -> bool:
        """Whether a unit is finished."""
        return self.unit_path(key).is_file()

    def records(self, key: str) -> list[Record]:
        """Reads the records of a finished unit, views in order.

        Raises:
            SplatwireError: If they are not there, or not of this unit.
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
        """Writes a file of the store as a whole.

        Args:
            name: Path within the store.
            data: Its content.

        Raises:
            SplatwireError: If the disk is full; nothing is left behind.
            OSError: If the disk refuses for another reason.
        """
        return _write(self.root / name, data)

    def put_records(self, key: str, records: Sequence[Record]) -> None:
        """Writes the records of a unit, which is then finished."""
        _write(self.unit_path(key), records_to_bytes(records))

    def check_records(self) -> None:
        """Checks before the work that records can be written.

        Raises:
            BackendUnavailableError: If the Parquet library is not installed.
        """
        parquet()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Makes sure that one run at a time coordinates this store, and removes what a killed one left unfinished.

        Raises:
            SplatwireError: If another run holds it.
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
            for folder in [
                self.root,
                *(path for path in self.root.rglob("*") if path.is_dir() and not path.is_symlink()),
            ]:
                remove_unfinished(folder)
            yield


@dataclass(frozen=True)
class MemoryStore(Store):
    """A store for one run in one process: records stay in memory, files in a folder that may go away afterwards."""

    _finished: dict[str, list[Record]] = field(default_factory=dict)

    def has(self, key: str) -> bool:
        """See `Store.has`."""
        return key in self._finished

    def records(self, key: str) -> list[Record]:
        """See `Store.records`."""
        return self._finished[key]

    def check_records(self) -> None:
        """See `Store.check_records`; memory takes any records."""

    def put_records(self, key: str, records: Sequence[Record]) -> None:
        """See `Store.put_records`."""
        self._finished[key] = list(records)


def _without_links(path: str, flags: int) -> int:
    """Opens a file; raises OSError for a symbolic link."""
    return os.open(path, flags | os.O_NOFOLLOW, 0o666)


def _write(path: Path, data: bytes) -> Path:
    try:
        return write_whole(path, data)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            reason = f"the disk is full: {path} could not be written; make room and start again, "
            raise SplatwireError(f"{reason}finished work is kept") from error
        raise


def read_json(path: Path) -> dict[str, Any] | None:
    """Reads a JSON object of the store; None if it is not there."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise SplatwireError(f"{path} is damaged: {error}; remove it and start again") from error
    if not isinstance(content, dict):
        raise SplatwireError(f"{path} is damaged: remove it and start again")
    return content
