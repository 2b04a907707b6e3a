"""Runs independent work, such as decoding packets, in parallel threads."""
# Compiled kernels and matrix products release the interpreter lock. The matrix library is limited to one thread,
# because two competing thread pools cost more than the work itself.

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
    """Applies a function to items in parallel threads and yields the results in the order of the items.

    Args:
        function: The function; should spend its time in code that releases the interpreter lock.
        items: The items; the function is called once for each.
        threads: Number of threads; None for one per processor.
    """
    # At most two results per thread are pending at a time, which bounds memory.
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
