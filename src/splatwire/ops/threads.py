"""Parallel loops for functions that release the interpreter lock, and limits on the number of threads."""

import collections
import functools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Generic, TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Result = TypeVar("Result")


@functools.cache
def _matrix_library() -> ThreadpoolController:
    """Returns the controller of the loaded BLAS library."""
    return ThreadpoolController().select(user_api="blas")


class _BlasLimit:
    """Process-wide limit of BLAS to one thread, active while at least one context manager requires it."""

    def __init__(self) -> None:
        self.lock, self.num, self.limit = threading.Lock(), 0, ExitStack()

    def enter(self) -> None:
        with self.lock:
            if self.num == 0:
                self.limit.enter_context(_matrix_library().limit(limits=1))
            self.num += 1

    def leave(self) -> None:
        with self.lock:
            self.num -= 1
            if self.num == 0:
                self.limit.close()


_HOLDERS = _BlasLimit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Context manager in which every matrix product of numpy runs on one thread: the thread that calls it.

    The limit applies to all threads of the process. Several threads may enter the context at the same time. The limit
    ends when the last of them leaves it.
    """
    _HOLDERS.enter()
    try:
        yield
    finally:
        _HOLDERS.leave()


_LIMIT = threading.Event()
"""Set if `parallel_map` uses only the calling thread in this process."""


def use_single_thread() -> None:
    """Restricts the function `parallel_map`, which distributes work over threads, to the calling thread.

    This limit stays for the rest of the process.
    """
    _LIMIT.set()


_CHOSEN: ContextVar[int | None] = ContextVar("threads", default=None)
"""Number of threads on which `parallel_map` distributes work; None for `allowed_threads`."""


@contextmanager
def limit_threads(threads: int | None) -> Iterator[None]:
    """Context manager that sets the number of threads on which `parallel_map` distributes the calling thread's work.

    Args:
        threads: The number, at least 1; None for `allowed_threads`.
    """
    before = _CHOSEN.set(threads)
    try:
        yield
    finally:
        _CHOSEN.reset(before)


def allowed_threads() -> int:
    """Returns the maximum number of threads on which `parallel_map` distributes work."""
    from numba import config

    if _LIMIT.is_set():
        return 1
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    setting = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(processors, int(setting) if setting.isdecimal() else processors, config.NUMBA_NUM_THREADS))


@functools.cache
def _helper_pool() -> ThreadPoolExecutor:
    """Returns the pool of threads that help the calling thread in `parallel_map`."""
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix="splatwire")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helper_pool.cache_clear)  # threads do not survive a fork


def parallel_map(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Applies a function to all items in parallel, on this thread and on helper threads.

    Args:
        work: Function of one item; should release the interpreter lock most of the time.
        items: Items, each with at least some hundred microseconds of work.

    Returns:
        The results in the order of the items.
    """
    wanted = min(_CHOSEN.get() or allowed_threads(), len(items)) - 1 if len(items) > 1 else 0
    if not wanted:
        return [work(item) for item in items]
    queue = _WorkQueue(work, collections.deque(enumerate(items)), {})
    helpers = [_helper_pool().submit(queue.take) for _ in range(wanted)]
    try:
        queue.take()
    finally:
        queue.waiting.clear()
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()
    return [queue.results[index] for index in range(len(items))]


@dataclass(frozen=True)
class _WorkQueue(Generic[Item, Result]):
    """Queue of items that several threads process.

    Attributes:
        work: Function of one item.
        waiting: Remaining items with their indices.
        results: Results so far, by index.
    """

    work: Callable[[Item], Result]
    waiting: collections.deque[tuple[int, Item]]
    results: dict[int, Result]

    def take(self) -> None:
        """Processes items on the calling thread until the queue is empty."""
        while self.waiting:
            try:
                index, item = self.waiting.popleft()
            except IndexError:  # another thread took the last one
                return
            self.results[index] = self.work(item)
