"""Warnings about inputs: dropped Gaussians, values that a stream cannot represent, and damaged streams."""

import logging
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from splatwire.cli._terminal import one_line
from splatwire.files.atomic_write import with_final_names

DAMAGED = 3
"""Exit status of a verb whose input is damaged."""
_DAMAGE_LOGGER = "splatwire.bitstream.stream"
"""Name of the logger of damaged streams. After one of its warnings, the exit status is `DAMAGED`, unless the user
accepts damage."""
LOGGERS = (
    *("splatwire.types", "splatwire.codec", "splatwire.plugins", _DAMAGE_LOGGER, "splatwire.lod"),
    *("splatwire.rate_control", "splatwire.render", "splatwire.evaluation"),
    *("splatwire.io", "splatwire.data", "splatwire.sequence", "splatwire.files", "splatwire.cli._encoded_sequences"),
)
"""Loggers of warnings about inputs."""
_MAX_FILES = 100_000
"""Maximum number of files of a folder that are counted per warning."""
_NUMBER = re.compile(r"[-+]?\d[\d.,]*(?:e[-+]?\d+)?")


class InputWarnings(logging.Handler):
    """Log handler that prints each warning once, even if a file is read several times.

    If several files of a folder, such as frames, have the same warning, only the first file is named. `summarize`
    prints the number of the other files.

    Attributes:
        damaged: True if a stream with damaged bytes was read.
    """

    # Warnings that differ only in numbers count as the same.

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._printed: set[str] = set()
        self._repeated: dict[tuple[Path, str], _Repeated] = {}
        self.damaged = False

    def emit(self, record: logging.LogRecord) -> None:
        """Prints a warning as one line on standard error, unless the same warning was printed before.

        Args:
            record: Log record of the warning.
        """
        self.damaged |= record.name == _DAMAGE_LOGGER
        kind = "warning: " if record.levelno > logging.INFO else ""
        text = record.getMessage()
        path = record.args[0] if isinstance(record.args, tuple) and record.args else None
        if isinstance(path, Path):
            reason = text.removeprefix(str(path))
            same = (path.parent, kind + _NUMBER.sub("0", reason))
            if same in self._repeated:
                self._repeated[same].add(path)
                if path != self._repeated[same].first:
                    return
            else:
                self._repeated[same] = _Repeated(path, kind, reason)
        self._print(kind, text)

    def summarize(self) -> None:
        """Prints, for each warning, how many further files of a folder had the same warning."""
        for repeated in self._repeated.values():
            if text := repeated.describe_others():
                self._print(repeated.kind, text)

    def _print(self, kind: str, text: str) -> None:
        line = f"splatwire: {kind}{one_line(with_final_names(text))}"
        if line not in self._printed:
            self._printed.add(line)
            print(line, file=sys.stderr, flush=True)


@dataclass
class _Repeated:
    """A warning about several files of a folder.

    Attributes:
        first: The file that the printed warning names.
        kind: Start of the printed line: `warning: `; empty for messages of a lower log level.
        reason: Text of the warning after the name of the file.
        others: Names of other files with the same warning.
    """

    first: Path
    kind: str
    reason: str
    others: set[str] = field(default_factory=set)

    def add(self, path: Path) -> None:
        if path != self.first and len(self.others) < _MAX_FILES:
            self.others.add(path.name)

    def describe_others(self) -> str:
        """Returns one line with the number of further files with the same warning, or an empty text."""
        if not self.others:
            return ""
        count = f"{len(self.others):,}{' or' if len(self.others) == _MAX_FILES else ''} more"
        files = "file" if len(self.others) == 1 else "files"
        return f"{self.first.parent}: {count} {files} like {self.first.name}{self.reason}"


@contextmanager
def input_warnings() -> Iterator[InputWarnings]:
    """Context that prints warnings about input files, each only once."""
    handler, loggers = InputWarnings(), [logging.getLogger(name) for name in LOGGERS]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
    try:
        yield handler
    finally:
        handler.summarize()
        for logger, level in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)
