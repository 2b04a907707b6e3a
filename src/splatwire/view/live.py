"""Receiving in a thread of its own, so that drawing never holds up the network."""

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable
from typing import TypeAlias

from splatwire.errors import MissingSideInfoError, SplatwireError
from splatwire.transport import Event, Finished, Receiver
from splatwire.view.sources import LiveSource

Receive: TypeAlias = Callable[[Callable[[Event], None]], Awaitable[Receiver]]
"""Receives one stream and calls back with everything that happens."""


class LiveTransfer:
    """A transfer that fills a `LiveSource` while it is drawn.

    Args:
        url: Where from, for messages.
        receive: Receives it; runs in an event loop of its own.
    """

    def __init__(self, url: str, receive: Receive) -> None:
        self._url, self._receive = url, receive
        self._began = time.perf_counter()
        self._ready = threading.Event()
        self._source = LiveSource()
        self._over = "stopped"
        self._problem: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Future[Receiver] | None = None
        self._thread = threading.Thread(target=self._run, name="splatwire-receive", daemon=True)

    def start(self, progress: Callable[[str, float], None]) -> LiveSource:
        """Waits until there is something to look at; packets go on arriving meanwhile.

        Args:
            progress: Called with what is being done and the share of it that is done.

        Returns:
            With its preview if that came first, as a rule with the server's first answer; else with the scene.

        Raises:
            MissingSideInfoError: If the transfer is over before there is a scene.
            BitstreamError: If the side information cannot be read.
        """
        self._thread.start()
        progress(f"waiting for {self._url}", 0.0)
        while not self._ready.wait(0.1):  # in slices, so that Ctrl-C is heard
            pass
        if isinstance(self._problem, SplatwireError):
            raise self._problem
        progress(f"waiting for {self._url}", 1.0)
        source = self._source
        if source.preview is None or source.has_scene:
            if not source.has_scene:
                raise MissingSideInfoError(f"{self._url}: no scene arrived ({self._problem or self._over})")
            source.advance(lambda share: progress("preparing the scene", share))
        return source

    def stop(self) -> None:
        """Ends the transfer and waits for its thread; the server is told."""
        loop, task = self._loop, self._task
        if loop is not None and task is not None and not loop.is_closed():
            loop.call_soon_threadsafe(task.cancel)
        if self._thread.is_alive():
            self._thread.join(5)

    def _run(self) -> None:
        try:
            asyncio.run(self._transfer())
        except asyncio.CancelledError:
            pass
        except Exception as error:  # told by whoever waits in `start`, or by the note
            self._problem = error
            self._source.end(f"the transfer failed: {error}")
        finally:
            self._ready.set()

    async def _transfer(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._task = asyncio.ensure_future(self._receive(self._note))
        await self._task

    def _note(self, event: Event) -> None:
        """Called in the receiving thread."""
        self._source.take(event, time.perf_counter() - self._began)
        if isinstance(event, Finished):
            self._over = event.reason
        if self._source.preview is not None or self._source.has_scene or isinstance(event, Finished):
            self._ready.set()
