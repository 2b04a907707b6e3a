"""One thread for small work: waking other threads, and waiting for them on busy processors, can cost ten times more."""

import collections
import functools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Result = TypeVar("Result")


@functools.cache
def _matrix_library() -> ThreadpoolController:
    """The loaded matrix library; finding it takes 100 times longer than setting its limit."""
    return ThreadpoolController().select(user_api="blas")


class _Holders:
    """Those who hold the matrix library, whose limit is one for the whole process, at one thread."""

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


_LIMIT = threading.Event()
"""Set while work of this process stays on one thread."""


def use_single_thread() -> None:
    """Keeps the shared work of this process to the calling thread, for good: for worker processes."""
    _LIMIT.set()


def allowed_threads() -> int:
    """Number of threads that work may use here: at most the processors, `OMP_NUM_THREADS` and numba's number."""
    from numba import config

    if _LIMIT.is_set():
        return 1
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(processors, int(asked) if asked.isdecimal() else processors, config.NUMBA_NUM_THREADS))


@functools.cache
def _helpers() -> ThreadPoolExecutor:
    """Threads that wait for work without using a processor."""
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix="splatwire")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # threads do not survive a fork


def share(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Does `work` for each item, on this thread and on others that have time for it.

    Whoever is free takes the next item, and nobody waits for a thread that has not begun: on busy processors the caller
    does nearly everything itself, as if there were no other threads.

    Args:
        work: What to do; spends its time in code that releases the interpreter lock. What it does for one item must
            not depend on the others.
        items: What to do it with; some hundred microseconds each, or waking threads costs more than they do.

    Returns:
        The results in the order of the items.
    """
    turns = _Turns(work, collections.deque(enumerate(items)), {})
    wanted = min(allowed_threads(), len(items)) - 1
    helpers = [_helpers().submit(turns.take) for _ in range(wanted)]
    try:
        turns.take()
    finally:
        turns.waiting.clear()
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()
    return [turns.results[place] for place in range(len(items))]


@dataclass(frozen=True)
class _Turns(Generic[Item, Result]):
    """Work that threads share.

    Attributes:
        work: What is done for each item.
        waiting: Items and their places.
        results: What was found so far, by place.
    """

    work: Callable[[Item], Result]
    waiting: collections.deque[tuple[int, Item]]
    results: dict[int, Result]

    def take(self) -> None:
        """Does the next item, as long as any waits."""
        while self.waiting:
            try:
                place, item = self.waiting.popleft()
            except IndexError:  # somebody else took the last one
                return
            self.results[place] = self.work(item)
