"""Packets are independent, so runs of them are worked on in threads of their own.

Compiled kernels and matrix products release the interpreter lock. Each thread computes alone: two pools of worker
threads (the kernels' and the matrix library's) that wait for each other cost more than the work itself.
"""

import collections
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from splatwire.ops.threads import allowed_threads, one_blas_thread

Item = TypeVar("Item")
Result = TypeVar("Result")


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int | None = None
) -> Iterator[Result]:
    """Applies a function to items in threads and yields the results in the order of the items.

    At most two results for each thread wait at a time, which bounds memory.

    Args:
        function: What to do; spends its time in code that releases the interpreter lock.
        items: What to do it with.
        threads: Number of threads; None for as many as there may be.
    """
    threads = threads or allowed_threads()
    if threads == 1:
        with one_blas_thread():
            yield from map(function, items)
        return
    with one_blas_thread(), ThreadPoolExecutor(threads) as pool:
        waiting: collections.deque[Future[Result]] = collections.deque()
        try:
            for item in items:
                if len(waiting) >= 2 * threads:
                    yield waiting.popleft().result()
                waiting.append(pool.submit(function, item))
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
