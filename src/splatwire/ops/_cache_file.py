"""Files of compiled kernels that any number of processes may read and write at once, without locks."""

import contextlib
import glob
import hashlib
import logging
import os
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

LOG = logging.getLogger("splatwire.ops.compiled")
_DIGEST_BYTES = 16
_HOLDS_OPEN_FILES = os.name == "nt"
"""True if the system refuses to replace a file that another process reads."""
_REPORTED: set[str] = set()
"""Reasons for which machine code could not be kept, each logged once."""


class CacheFile(IndexDataCacheFile):
    """Cache of a kernel's machine code in a folder: an index file, and a data file for each signature.

    Several processes may write to the cache at once, and a process may be killed while it writes. Nevertheless, an
    index file never refers to the code of another signature or of earlier sources: each data file is named after the
    hash of its content, and is written before the index file. Code that is absent or damaged counts as not cached.

    Args:
        numba_cache: numba's own cache object for the kernel, which gives the folder and the file names.
        source_stamp: Identifier of the kernel's sources; code compiled from other sources counts as not cached.
    """

    # numba numbers data files and writes the index first: two processes may then give one number to two signatures, and
    # a process that is killed in between leaves an index of new sources with the code of old ones.

    def __init__(self, numba_cache: IndexDataCacheFile, source_stamp: object) -> None:
        self._stem = numba_cache._index_name.removesuffix(".nbi")
        super().__init__(numba_cache._cache_path, self._stem, source_stamp)

    def save(self, key: Any, data: Any) -> None:
        """Stores the machine code of the kernel that was compiled for one signature (types of the arguments).

        An error of the file system is only logged, because the kernel also works without a cache.

        Args:
            key: Key in the index file of the cache, which identifies the signature and the processor.
            data: The code, which can be pickled.
        """
        packed = self._dump(data)
        name = self._data_name_of(packed)
        try:
            if self._data(name) != packed:
                self._replace(name, packed)
            names = {**self._load_index(), key: name}
            index = self._dump((self._source_stamp, names))
            self._replace(self._index_name, self._dump(self._version) + index)
        except FileNotFoundError:
            pass  # another process has removed the unfinished file, or the whole folder
        except OSError as error:
            log_unwritable(Path(self._cache_path), error)
        else:
            self._remove_all_but({self._index_name, *names.values()})

    def load(self, key: Any) -> Any:
        """Returns the kernel's machine code for one signature (types of the arguments); None if it is not cached.

        Args:
            key: Key in the index file of the cache, which identifies the signature and the processor.
        """
        name = self._load_index().get(key)
        if name is None or self._data(name) is None:
            return None
        try:
            return self._load_data(name)
        except OSError:  # another process has removed it meanwhile
            return None

    def _load_index(self) -> dict[Any, str]:
        """Returns the names of the data files by key; empty for an unreadable index, such as one of another release."""
        try:
            index: dict[Any, str] = super()._load_index()
        except Exception:  # unpickling may raise anything
            return {}
        return index

    def _data_name_of(self, packed: bytes) -> str:
        return f"{self._stem}.{hashlib.blake2b(packed, digest_size=_DIGEST_BYTES).hexdigest()}.nbc"

    def _data(self, name: str) -> bytes | None:
        """Returns the content of a data file; None if it is absent, unreadable or does not match its name."""
        try:
            packed = Path(self._cache_path, name).read_bytes()
        except OSError:
            return None
        return packed if self._data_name_of(packed) == name else None

    def _replace(self, name: str, content: bytes) -> None:
        """Writes a file of the cache folder atomically.

        Some systems do not replace a file that another process has open. The file then stays as it is, without an
        error.

        Raises:
            OSError: If the file cannot be written for another reason.
        """
        unfinished = Path(self._cache_path, f"{self._stem}.{uuid.uuid4().hex[:16]}.tmp")
        try:
            unfinished.write_bytes(content)
            os.replace(unfinished, Path(self._cache_path, name))
        except PermissionError:
            if not (_HOLDS_OPEN_FILES and unfinished.exists()):  # else a later process writes it
                raise
        finally:
            with contextlib.suppress(OSError):
                unfinished.unlink()

    def _remove_all_but(self, kept: set[str]) -> None:
        """Removes all files of this kernel's cache except the files named in `kept`.

        The removed files contain code of earlier sources, or were left unfinished by killed processes.
        """
        # Another process that is about to name such a file in its index compiles its kernel once more.
        for path in self._files():
            if path.name not in kept:
                with contextlib.suppress(OSError):
                    path.unlink()

    def _files(self) -> Iterator[Path]:
        return Path(self._cache_path).glob(f"{glob.escape(self._stem)}.*")


def log_unwritable(folder: Path, error: OSError) -> None:
    """Logs once that compiled kernels cannot be written to a folder."""
    reason = error.strerror or str(error)
    if reason not in _REPORTED:
        _REPORTED.add(reason)
        LOG.warning("compiled kernels cannot be kept in %s, so each process compiles them: %s", folder, reason)
