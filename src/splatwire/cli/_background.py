"""Waiting for background work of commands."""

import asyncio
from typing import Any


async def wait_for_work(work: "asyncio.Future[Any]", stop: asyncio.Event, grace_s: float) -> None:
    """Waits until a task ends, but after a stop request no longer than a grace period; the task goes on.

    Args:
        work: The task.
        stop: Event that requests the end.
        grace_s: Maximum duration of the task after the stop request, seconds.
    """
    stopping = asyncio.ensure_future(stop.wait())
    await asyncio.wait({work, stopping}, return_when=asyncio.FIRST_COMPLETED)
    if not work.done():
        await asyncio.wait({work}, timeout=grace_s)
    stopping.cancel()
