"""Signals that stop a command, and their exit status."""

import _thread
import signal
import threading
import time
from collections.abc import Callable
from types import FrameType

_RETRY_S = 0.02
"""Time after which a signal is tried again, seconds."""
_FOREIGN = ("llvmlite.binding", "weakref")
"""Modules whose functions, and all that these call, lose an error: LLVM calls them, or Python while it frees objects.
An error in `llvmlite.binding` can also leave a lock held for ever."""
_LOCKING = ("numba.core.compiler_lock", "contextlib")
"""Modules in which an error can leave a lock held for ever; not so in what they call with the lock held: the compiler.
Numba acquires its lock in a `contextlib.ExitStack`."""
_CALLBACKS = ("__del__", "_remove", "on_disposal", "_on_type_disposal")
"""Functions that Python calls while it frees objects; errors in them are printed and ignored."""


class StoppedError(KeyboardInterrupt):
    """Error of a command that a signal stopped before its end; the exit status is 128 plus the signal's number."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def status_of(interrupt: KeyboardInterrupt) -> int:
    """Returns the exit status after a signal: 130 for SIGINT (Ctrl-C), 143 for SIGTERM."""
    return 128 + (interrupt.number if isinstance(interrupt, StoppedError) else signal.SIGINT)


def raising(error: Callable[[int], BaseException]) -> Callable[[int, FrameType | None], None]:
    """Returns a signal handler that raises an error in the main thread, as soon as the error cannot get lost.

    Args:
        error: Function that returns the error for the number of a signal.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        if _may_raise(frame):
            raise error(number)
        # A thread of `threading` would need locks that the interrupted code may hold.
        _thread.start_new_thread(_repeat, (number,))

    return handle


def _repeat(number: int) -> None:
    """Sends a signal to the main thread again, unless the command has ended meanwhile."""
    time.sleep(_RETRY_S)
    main = threading.main_thread().ident
    if not callable(signal.getsignal(number)) or main is None:
        return
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(main, number)  # also interrupts a wait
    else:
        _thread.interrupt_main(signal.Signals(number))


def _may_raise(frame: FrameType | None) -> bool:
    """True if no function that is running loses an error or would leave a lock held.

    Args:
        frame: Innermost function that is running.
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
