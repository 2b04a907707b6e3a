"""Warnings about inputs: rows that are left out, rows that no stream holds as they are, and damaged streams."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from splatwire.cli._terminal import one_line

_DAMAGE = "splatwire.packets.stream"
_TELLING = ("splatwire.scene.rows", "splatwire.codec.schemas.gaussians.outliers", _DAMAGE)


class InputWarnings(logging.Handler):
    """Prints each warning once, however often a verb reads a file.

    Attributes:
        damaged: True once a stream with damaged bytes was read.
    """

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._said: set[str] = set()
        self.damaged = False

    def emit(self, record: logging.LogRecord) -> None:
        """One line on standard error."""
        self.damaged |= record.name == _DAMAGE
        text = one_line(record.getMessage())
        if text not in self._said:
            self._said.add(text)
            kind = "warning: " if record.levelno > logging.INFO else ""
            print(f"splatwire: {kind}{text}", file=sys.stderr, flush=True)


@contextmanager
def input_warnings() -> Iterator[InputWarnings]:
    """Prints warnings about inputs while a verb runs."""
    handler, loggers = InputWarnings(), [logging.getLogger(name) for name in _TELLING]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
    try:
        yield handler
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)
