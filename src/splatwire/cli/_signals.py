"""Signals that stop a command, and their exit status."""

import _thread
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_RETRY_S = 0.02
"""Time after which a signal is tried again, seconds."""
_CLEANUP_S = 5.0
"""Time for a command to remove its temporary files after a signal, seconds; further signals wait meanwhile."""
_FOREIGN = ("llvmlite.binding", "weakref")
"""Modules in which raised errors are lost, because LLVM calls their functions, or Python does so while it frees
objects. Errors in all functions that these functions call are lost, too. An error in `llvmlite.binding` can also leave
a lock held for ever.
"""
_LOCKING = ("numba.core.compiler_lock", "contextlib")
"""Modules in which an error can leave a lock acquired for ever. Errors in the compiler, which numba calls with its lock
acquired, leave none: a `contextlib.ExitStack` releases the lock."""
_CALLBACKS = ("__del__", "_remove", "on_disposal", "_on_type_disposal")
"""Functions that Python calls while it frees objects; errors in them are printed and ignored."""


class StoppedError(KeyboardInterrupt):
    """Error that ends a command after a signal such as SIGTERM. The exit status is 128 plus the signal's number."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def status_of(interrupt: KeyboardInterrupt) -> int:
    """Returns the exit status after a signal: 130 for SIGINT (Ctrl-C), 143 for SIGTERM."""
    return 128 + (interrupt.number if isinstance(interrupt, StoppedError) else signal.SIGINT)


class SignalErrors:
    """Signal handler that raises an error in the main thread.

    The error is raised later if the signal interrupts a function that would discard the error, such as one that Python
    calls while it frees objects. After the error, the command has `_CLEANUP_S` seconds to remove its temporary files;
    signals that arrive during this time take effect afterwards.

    Args:
        error: Function that returns the error to raise, given the number of the signal.
        clock: Function that returns the time, seconds.
    """

    def __init__(self, error: Callable[[int], BaseException], clock: Callable[[], float] = time.monotonic) -> None:
        self._error, self._clock = error, clock
        self._raised: tuple[int, int] | None = None
        self._cleaned_at = 0.0

    def handle(self, number: int, frame: FrameType | None) -> None:
        """Raises the error for a signal, or schedules the signal again for a later time.

        Args:
            number: Number of the signal.
            frame: Stack frame of the interrupted function, as for handlers of `signal.signal`.
        """
        now = self._clock()
        if now < self._cleaned_at or not _may_raise(frame):
            _repeat_later(number)
            return
        self._cleaned_at = now + _CLEANUP_S
        error = self._error(number)
        self._raised = id(error), number  # the error itself would keep alive what is cleaned up when it is freed
        raise error

    @contextmanager
    def lost_ones_repeated(self) -> Iterator[None]:
        """Context manager that repeats signals whose error Python has discarded.

        The handler of a signal raises an error. If Python is calling a function to free an object, or a callback from
        C, it only prints this error, and the command would continue. In this context, the signal is sent again.
        """
        before = sys.unraisablehook

        def lost(unraisable: Any) -> None:
            if self._raised is None or self._raised[0] != id(unraisable.exc_value):
                before(unraisable)
                return
            self._cleaned_at = 0.0
            _repeat_later(self._raised[1])

        sys.unraisablehook = lost
        try:
            yield
        finally:
            sys.unraisablehook = before


@contextmanager
def first_interrupt(callback: Callable[[], None]) -> Iterator[None]:
    """Context in which the first SIGINT (Ctrl-C) only calls a function, in another thread.

    Each further SIGINT has the action that was set before the context. If SIGINT is ignored, as in background jobs of a
    shell script, the context changes nothing. Outside of the main thread, it changes nothing, either.

    Args:
        callback: Function to call.
    """
    before = signal.getsignal(signal.SIGINT)
    if before in (None, signal.SIG_IGN) or threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        signal.signal(number, before)
        _thread.start_new_thread(callback, ())  # here, printing could fail within the printing that was interrupted

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _repeat_later(number: int) -> None:
    # A thread of `threading` would need locks that the interrupted code may hold.
    _thread.start_new_thread(_repeat, (number,))


def _repeat(number: int) -> None:
    """Sends a signal to the main thread again, unless the command has ended in the meantime."""
    time.sleep(_RETRY_S)
    handler, main = signal.getsignal(number), threading.main_thread().ident
    if not callable(handler) or handler is signal.default_int_handler or main is None:
        return
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(main, number)  # also interrupts a wait
    else:
        _thread.interrupt_main(signal.Signals(number))


def _may_raise(frame: FrameType | None) -> bool:
    """True if a signal handler may raise an error now.

    False while a function is running that would discard the error, or that would leave a lock held after the error.

    Args:
        frame: Stack frame of the innermost running function.
    """
    if frame is not None and _module(frame) in _LOCKING:
        return False
    while frame is not None:
        if frame.f_code.co_name in _CALLBACKS or _module(frame).startswith(_FOREIGN):
            return False
        frame = frame.f_back
    return True


def _module(frame: FrameType) -> str:
    return str(frame.f_globals.get("__name__"))
