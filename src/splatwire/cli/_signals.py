"""Exit status of a command that a signal stopped."""

import signal


class StoppedError(KeyboardInterrupt):
    """Error of a command that a signal stopped before its end; the exit status is 128 plus the signal's number."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def status_of(interrupt: KeyboardInterrupt) -> int:
    """Returns the exit status after a signal: 130 for SIGINT (Ctrl-C), 143 for SIGTERM."""
    return 128 + (interrupt.number if isinstance(interrupt, StoppedError) else signal.SIGINT)
