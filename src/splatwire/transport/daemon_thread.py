"""Daemon threads for blocking work of an event loop."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any


def start_thread(work: Callable[[], Any], name: str) -> "asyncio.Future[Any]":
    """Runs a function in a daemon thread, which does not delay the end of the process.

    Args:
        work: Function without arguments.
        name: Name of the thread.

    Returns:
        Future with the result of the function.
    """
    # The threads of an executor would delay it.
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
