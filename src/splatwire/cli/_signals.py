"""Signals that stop a command, and their exit status."""

import asyncio
import signal
from collections.abc import Iterator
from contextlib import contextmanager


class StoppedError(KeyboardInterrupt):
    """Error of a command that a signal stopped before its end; the exit status is 128 plus the signal's number."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def status_of(interrupt: KeyboardInterrupt) -> int:
    """Returns the exit status after a signal: 130 for SIGINT (Ctrl-C), 143 for SIGTERM."""
    return 128 + (interrupt.number if isinstance(interrupt, StoppedError) else signal.SIGINT)


@contextmanager
def canceling_on_signals(stop: asyncio.Future[None]) -> Iterator[list[int]]:
    """Context in which SIGINT and SIGTERM cancel a future of the running event loop.

    Args:
        stop: The future.

    Yields:
        List of the numbers of the received signals, which grows.
    """
    loop, received = asyncio.get_running_loop(), list[int]()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def on_signal(number: int) -> None:
        received.append(number)
        stop.cancel()

    for number in before:
        loop.add_signal_handler(number, on_signal, number)
    try:
        yield received
    finally:
        # The event loop would leave the default actions, with which SIGTERM leaves temporary files.
        for number, handler in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, handler)
