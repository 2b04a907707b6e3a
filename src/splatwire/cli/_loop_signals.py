"""Signals that a running event loop handles."""

import asyncio
import signal
from collections.abc import Callable, Sequence


class LoopSignals:
    """Lets the running event loop call a function for signals.

    Args:
        callback: Called with the number of a signal.
        numbers: Numbers of the signals, by default SIGINT (Ctrl-C) and SIGTERM.
        ignored: True to handle ignored signals, too. If False, signals that are ignored stay ignored, as in background
            jobs of a shell script.
    """

    def __init__(
        self, callback: Callable[[int], None], numbers: Sequence[int] = (signal.SIGINT, signal.SIGTERM), *,
        ignored: bool = False,
    ) -> None:  # fmt: skip
        self._loop = asyncio.get_running_loop()
        handlers = {int(number): signal.getsignal(number) for number in numbers}
        self._before = {
            number: handler for number, handler in handlers.items() if ignored or handler is not signal.SIG_IGN
        }
        for number in self._before:
            self._loop.add_signal_handler(number, callback, number)

    def restore(self, *numbers: int) -> None:
        """Restores the earlier action of signals.

        Args:
            *numbers: Numbers of the signals; without arguments, all signals that this object handles. Other signals
                stay unchanged.
        """
        # The event loop would leave the default actions, with which SIGTERM leaves temporary files.
        for number in self._before.keys() & (numbers or self._before.keys()):
            handler = self._before.pop(number)
            blocked = signal.pthread_sigmask(signal.SIG_BLOCK, (number,))  # the event loop sets the default action
            try:
                self._loop.remove_signal_handler(number)
                if handler is not None:  # None: it was not Python's, and Python cannot set it again
                    signal.signal(number, handler)
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
