"""Limits of the memory and time of a process that reads an OpenUSD scene, in proportion to the size of the scene."""

import faulthandler
import os
import time
from pathlib import Path

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

_FREE_BYTES = 1 << 30
"""Additional memory that any scene may use, bytes of address space; usd-core itself takes 0.43 GB."""
_BYTES_PER_BYTE, _BYTES_PER_CHARACTER = 24, 120
"""Additional memory for each byte of binary files and Gaussians, and of text files and packages, which may have text.

The largest measured values were 6.4 for binary files, and 55 for text files whose numbers have one digit.
"""
_FREE_SECONDS = 10.0
"""Processor time for a scene of any size, and for each frame, seconds."""
_SECONDS_PER_BYTE = 1e-6
"""Additional processor time for each byte of files and Gaussians, seconds; the largest measured value was 0.05e-6."""
_PATIENCE = 10.0
"""Ratio of the wall-clock time limit to the processor time limit, for busy machines and slow disks."""
_BINARY = b"PXR-USDC"
"""First bytes of binary files."""


class Limits:
    """Memory and time limits of the process that reads an OpenUSD scene.

    The limits grow with the size of the scene. Beyond the memory limit, allocations fail. After the time limit, the
    process ends.

    Args:
        are_set: False to limit nothing.
    """

    def __init__(self, *, are_set: bool) -> None:
        self._are_set = are_set
        self._files, self._bytes, self._characters = set[str](), 0, 0
        self._gaussians = self._most_gaussians = 0
        status = Path("/proc/self/statm")
        self._before = int(status.read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE") if status.exists() else None
        if are_set and resource is not None:
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        self.restart()

    @property
    def file_bytes(self) -> int:
        """Total size of the files passed to `add_file`, bytes."""
        return self._bytes + self._characters

    @property
    def memory(self) -> int:
        """Memory that the reading process may use in addition to its use at the start, bytes."""
        binary = self._bytes + self._most_gaussians  # the previous frame may still be in memory
        return _FREE_BYTES + _BYTES_PER_BYTE * binary + _BYTES_PER_CHARACTER * self._characters

    def add_file(self, file: Path) -> None:
        """Raises the limits on memory and time of the current process, before it reads a file.

        The limits grow with the size of the file. A file that was passed before is ignored.

        Args:
            file: Path of the file; a path without a readable file is ignored.
        """
        name = os.path.realpath(file)
        if name in self._files or not os.path.isfile(name):
            return
        self._files.add(name)
        try:
            with open(name, "rb") as opened:
                is_binary = opened.read(len(_BINARY)) == _BINARY
        except OSError:  # usd-core cannot read it either, and reports it
            return
        if is_binary:
            self._bytes += os.path.getsize(name)
        else:
            self._characters += os.path.getsize(name)
        self._set()

    def add_gaussians(self, size: int) -> None:
        """Raises the limits on memory and time of the current process, after it has read more Gaussians.

        Args:
            size: Size of these Gaussians in bytes.
        """
        self._gaussians += size
        self._most_gaussians = max(self._most_gaussians, self._gaussians)
        self._set()

    def restart(self) -> None:
        """Restarts the measurement of processor time and wall-clock time for the limits of the current process.

        This method is called at the start, and before each further frame is read. Earlier calls of `add_gaussians` no
        longer extend the time limits.
        """
        self._gaussians = 0
        self._since, self._since_clock = time.process_time(), time.monotonic()
        self._set()

    def pause(self) -> None:
        """Suspends the limit on the wall-clock time of the current process, until `resume` is called."""
        faulthandler.cancel_dump_traceback_later()
        self._paused = time.monotonic()

    def resume(self) -> None:
        """Restores the limit on the wall-clock time of the current process; time since `pause` does not count."""
        self._since_clock += time.monotonic() - self._paused
        self._set()

    def _set(self) -> None:
        if not self._are_set:
            return
        seconds = _FREE_SECONDS + _SECONDS_PER_BYTE * (self._bytes + self._characters + self._gaussians)
        if resource is not None:
            _limit(resource.RLIMIT_CPU, int(self._since + seconds) + 1)
            if self._before is not None:
                _limit(resource.RLIMIT_AS, self._before + self.memory)
        passed = time.monotonic() - self._since_clock
        faulthandler.dump_traceback_later(max(1.0, _PATIENCE * seconds - passed), exit=True)


def _limit(kind: int, value: int) -> None:
    """Sets the soft limit of a resource of the current process, to at most its hard limit.

    Args:
        kind: The resource, such as `resource.RLIMIT_AS`.
        value: New limit, in the unit of the resource.
    """
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
