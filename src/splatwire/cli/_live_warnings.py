"""Warnings about single frames during live encoding: limited in number, and printed without blocking the encoder.

Other log messages, such as those of the readers and the encoder, go to `InputWarnings`: each is printed once.
"""

import logging
import select
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

WARN_S = 5.0
"""Minimum interval between two printed warnings, seconds; warnings in between are only counted."""
MAX_WARNING = 1000
"""Maximum length of a warning, characters."""
LOGGERS = ("splatwire.types.validity", "splatwire.codec.gaussians.outliers")
"""Loggers of warnings about single frames, which each frame may cause."""


class Warnings:
    """Prints warnings on standard error, at most one per `WARN_S`; never blocks on a full pipe.

    Args:
        clock: Returns the current time, seconds.
        show: Prints one line.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic, show: Callable[[str], None] | None = None) -> None:
        self._clock, self._show = clock, show or print_if_read
        self._next_at = -float("inf")
        self._num_suppressed = 0

    def __call__(self, text: str) -> None:
        """Prints a warning, or only counts it if a warning was printed in the last `WARN_S` seconds."""
        now = self._clock()
        if now < self._next_at:
            self._num_suppressed += 1
            return
        more = f" ({self._num_suppressed:,} other warnings since the last one)" if self._num_suppressed else ""
        self._show(f"splatwire: warning: {' '.join(text.split())[:MAX_WARNING]}{more}")
        self._next_at, self._num_suppressed = now + WARN_S, 0


def print_if_read(text: str) -> None:
    """Prints a line on standard error, and drops the line if writing would block on a full pipe."""
    try:
        writable = bool(select.select([], [sys.stderr], [], 0)[1])
    except (OSError, ValueError, TypeError, AttributeError):  # not a file with a descriptor
        writable = sys.stderr is not None
    if writable:
        print(text, file=sys.stderr, flush=True)


class _Forward(logging.Filter):
    """Log filter that passes warnings to a function instead of the log handlers.

    Args:
        warn: Function that receives the text of a warning.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        super().__init__()
        self._warn = warn

    def filter(self, record: logging.LogRecord) -> bool:
        """Passes the text of a warning or error to the function of this logging filter; drops records of lower level.

        Returns:
            False for every record, so that no log handler receives it.
        """
        if record.levelno >= logging.WARNING:
            self._warn(record.getMessage())
        return False


@contextmanager
def rate_limited_warnings(warn: Callable[[str], None]) -> Iterator[None]:
    """Context in which the log messages of `LOGGERS` are passed to `warn` instead of the log handlers.

    Args:
        warn: Function that gets the text of each warning or error, and limits how many are printed (`Warnings`).
    """
    passed, loggers = _Forward(warn), [logging.getLogger(name) for name in LOGGERS]
    for logger in loggers:
        logger.addFilter(passed)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeFilter(passed)
