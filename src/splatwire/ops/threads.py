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

import torch
from threadpoolctl import ThreadpoolController

Item = TypeVar("Item")
Result = TypeVar("Result")


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


def allowed_threads() -> int:
    """Threads that work may use here: no more than processors, than torch's number (`OMP_NUM_THREADS`) or numba's."""
    from numba import config

    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(processors, torch.get_num_threads(), config.NUMBA_NUM_THREADS))


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
