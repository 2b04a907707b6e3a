"""Messages during long startup phases: loading of libraries and compilation of kernels."""

import logging
import math
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

_PATIENCE_S = 1.0
_INTERVAL_S = 5.0
_COMPILER = logging.getLogger("splatwire.ops.compiled")


class StartupProgress(logging.Handler):
    """Log handler that prints why a subcommand is slow to start: libraries are loaded, or kernels are compiled."""

    def __init__(self, verb: str) -> None:
        super().__init__(logging.INFO)
        self._loading = threading.Timer(_PATIENCE_S, self.loading, (verb,))
        self._loading.daemon = True
        self._kernels, self._began, self._printed_at = 0, 0.0, -math.inf

    def loading(self, verb: str) -> None:
        """Prints that libraries are being loaded.

        Args:
            verb: Name of the subcommand, such as `encode`.
        """
        print(f"splatwire {verb}: loading", file=sys.stderr, flush=True)

    def start(self) -> None:
        """Starts the timer for the message that libraries are being loaded, if standard error is a terminal."""
        if sys.stderr.isatty():
            self._loading.start()

    def stop(self) -> None:
        """Cancels the timer that would print the message about the loading of libraries."""
        self._loading.cancel()

    def emit(self, record: logging.LogRecord) -> None:
        """Prints a log record about the compilation of kernels: its progress or a warning.

        Args:
            record: Log record of a compiled kernel, of waiting for the compilation in another process, or of a warning.
        """
        if record.levelno > logging.INFO:
            print(f"splatwire: {record.getMessage()}", file=sys.stderr)
            return
        now = time.monotonic()
        if getattr(record, "waits", False):
            if now - self._printed_at > _INTERVAL_S:
                self._printed_at = now
                self._loading.cancel()
                print(record.getMessage(), file=sys.stderr, flush=True)
            return
        if self._kernels == 0:
            self._began = self._printed_at = now
            self._loading.cancel()
            print("compiling kernels, once on this machine", file=sys.stderr, flush=True)
        elif now - self._printed_at > _INTERVAL_S:
            self._printed_at = now
            kernels = "1 kernel" if self._kernels == 1 else f"{self._kernels} kernels"
            done = f"{kernels} compiled after {now - self._began:.0f} s"
            print(f"{done}, {record.getMessage()}", file=sys.stderr, flush=True)
        self._kernels += 1


@contextmanager
def startup_messages(verb: str) -> Iterator[None]:
    """Context that prints a message if loading of libraries or compilation of kernels takes long."""
    handler, before = StartupProgress(verb), _COMPILER.level
    _COMPILER.addHandler(handler)
    _COMPILER.setLevel(logging.INFO)
    handler.start()
    try:
        yield
    finally:
        handler.stop()
        _COMPILER.removeHandler(handler)
        _COMPILER.setLevel(before)
