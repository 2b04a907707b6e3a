"""What somebody is told of a scene's rows: those that are left out, and those that no stream holds as they are."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_TELLING = ("splatwire.scene.rows", "splatwire.codec.schemas.gaussians.outliers")


class _Told(logging.Handler):
    """Says each thing once, however often a verb looks at a file."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """One line on standard error."""
        text = record.getMessage()
        if text not in self._said:
            self._said.add(text)
            kind = "warning: " if record.levelno > logging.INFO else ""
            print(f"splatwire: {kind}{text}", file=sys.stderr, flush=True)


@contextmanager
def telling_what_is_left_out() -> Iterator[None]:
    """Listens while a verb runs."""
    handler, loggers = _Told(), [logging.getLogger(name) for name in _TELLING]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)
