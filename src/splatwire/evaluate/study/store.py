"""One folder holds everything that a protocol made: what is finished there is never computed again, nothing is half.

```
store/
  lock                        held by the run that coordinates
  inputs/<key>/...            encoded streams, reference pictures: made once
  masks/<scene>/<stream>/...  which packets arrived, for other codecs too
  units/<key>.parquet         the records of one unit of work
```

Files appear under their names only when they are complete; two writers of one unit write the same content.
"""

import errno
import fcntl
import json
import os
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatwire.errors import SplatwireError

UNIT_SUFFIX = ".parquet"
_UNFINISHED = ".part"


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

    def missing(self, keys: Iterable[str]) -> list[str]:
        """The units that are not finished, in order, each once."""
        return [key for key in dict.fromkeys(keys) if not self.has(key)]

    def write(self, name: str, data: bytes) -> Path:
        """Writes a file of the store as a whole.

        Args:
            name: Path within the store.
            data: Its content.

        Raises:
            SplatwireError: If the disk is full; nothing is left behind.
            OSError: If the disk refuses for another reason.
        """
        return write_whole(self.root / name, data)

    def put_unit(self, key: str, data: bytes) -> None:
        """Writes the records of a unit."""
        self.write(str(self.unit_path(key).relative_to(self.root)), data)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Makes sure that one run at a time coordinates this store, and removes what a killed one left unfinished.

        Raises:
            SplatwireError: If another run holds it.
        """
        self.root.mkdir(parents=True, exist_ok=True)
        with (self.root / "lock").open("a") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                reason = f"another run is working in {self.root}: wait for it, or take another folder"
                raise SplatwireError(reason) from error
            for path in self.root.rglob(f".*{_UNFINISHED}"):
                path.unlink(missing_ok=True)
            yield


def write_whole(path: Path, data: bytes) -> Path:
    """Writes a file so that it is there as a whole or not at all.

    Raises:
        SplatwireError: If the disk is full.
        OSError: If the disk refuses for another reason.
    """
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.{uuid.uuid4().hex[:8]}{_UNFINISHED}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with unfinished.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise SplatwireError(
                f"the disk is full: {path} could not be written; make room and start again, finished work is kept"
            ) from error
        raise
    finally:
        unfinished.unlink(missing_ok=True)
    return path


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
