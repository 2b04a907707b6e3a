"""Work beside the event loop that cannot keep the process from ending."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any


def start_thread(work: Callable[[], Any], name: str) -> "asyncio.Future[Any]":
    """Starts work in a thread that the end of the process does not wait for, as it does for those of an executor.

    Args:
        work: The work.
        name: Name of the thread.

    Returns:
        A future with the result of the work.
    """
    loop = asyncio.get_running_loop()
    future: asyncio.Future[Any] = loop.create_future()

    def settle(setter: Callable[[Any], None], value: object) -> None:
        if not future.done():
            setter(value)

    def run() -> None:
        setter, value = future.set_result, None
        try:
            value = work()
        except BaseException as error:
            setter, value = future.set_exception, error
        with suppress(RuntimeError):  # the loop is closed: nothing waits for the result
            loop.call_soon_threadsafe(settle, setter, value)

    threading.Thread(target=run, name=name, daemon=True).start()
    return future


async def first_of(work: "asyncio.Future[Any]", stop: asyncio.Event, grace_s: float) -> None:
    """Waits for work, or for a stop and then so many seconds more for the work.

    Args:
        work: The work.
        stop: Set when it is time to end.
        grace_s: Longest time that the work may take to end, seconds.
    """
    stopping = asyncio.ensure_future(stop.wait())
    await asyncio.wait({work, stopping}, return_when=asyncio.FIRST_COMPLETED)
    if not work.done():
        await asyncio.wait({work}, timeout=grace_s)
    stopping.cancel()
