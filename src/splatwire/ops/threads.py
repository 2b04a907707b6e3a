"""One thread for small work: waking other threads, and waiting for them on busy processors, can cost ten times more."""

import functools
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import torch
from threadpoolctl import ThreadpoolController


@functools.cache
def _libraries(kind: str) -> ThreadpoolController:
    """The loaded libraries of a kind, "blas" or "openmp": to look for them takes 100 times longer than a limit."""
    return ThreadpoolController().select(user_api=kind)


class _Holders:
    """Those who hold the matrix library, whose limit is one for the whole process, at one thread."""

    def __init__(self) -> None:
        self.lock, self.num, self.limit = threading.Lock(), 0, ExitStack()

    def enter(self) -> None:
        with self.lock:
            if self.num == 0:
                self.limit.enter_context(_libraries("blas").limit(limits=1))
            self.num += 1

    def leave(self) -> None:
        with self.lock:
            self.num -= 1
            if self.num == 0:
                self.limit.close()


_HOLDERS = _Holders()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keeps numpy's matrix products to the calling thread; what was allowed before is again when the last one leaves.

    Threads may hold it at once, in any order: the limit belongs to the process, so each restoring what it found would
    leave the process with whatever the last one found.
    """
    _HOLDERS.enter()
    try:
        yield
    finally:
        _HOLDERS.leave()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keeps torch's loops to the calling thread, and lets all others have theirs.

    `torch.set_num_threads` would also tell every thread that first uses torch meanwhile, for good. Nor does calling it
    once last: numba's parallel kernels set the number of OpenMP threads, which is torch's too, whenever they run.
    """
    torch.get_num_threads()  # a thread's first question sets its number: before the limit, not over it
    with _libraries("openmp").limit(limits=1):
        yield
