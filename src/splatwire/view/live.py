"""Receiving in a thread of its own, so that drawing never holds up the network."""

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable
from typing import TypeAlias

from splatwire.errors import MissingSideInfoError, SplatwireError
from splatwire.transport import Event, Finished, PacketArrived, Receiver, SideInfoArrived
from splatwire.view.sources import LiveSource

Receive: TypeAlias = Callable[[Callable[[Event], None]], Awaitable[Receiver]]
"""Receives one stream and calls back with everything that happens."""
_WORDS = {"complete": "everything has arrived", "sent": "everything was sent, some was lost"}


class LiveTransfer:
    """A transfer that fills a `LiveSource` while it is drawn.

    Args:
        url: Where from, for messages.
        receive: Receives it; runs in an event loop of its own.
    """

    def __init__(self, url: str, receive: Receive) -> None:
        self._url, self._receive = url, receive
        self._began = time.perf_counter()
        self._ready, self._lock = threading.Event(), threading.Lock()
        self._source: LiveSource | None = None
        self._early: list[Event] = []
        self._over = ""
        self._problem: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Future[Receiver] | None = None
        self._thread = threading.Thread(target=self._run, name="splatwire-receive", daemon=True)

    def start(self, progress: Callable[[str, float], None]) -> LiveSource:
        """Waits for the side information and prepares the scene; packets go on arriving meanwhile.

        Args:
            progress: Called with what is being done and the share of it that is done.

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
        first = next((event for event in self._early if isinstance(event, SideInfoArrived)), None)
        if first is None:
            raise MissingSideInfoError(f"{self._url}: no scene arrived ({self._over or self._problem or 'stopped'})")
        progress(f"waiting for {self._url}", 1.0)
        source = LiveSource(
            first.manifest, first.side_info, progress=lambda share: progress("preparing the scene", share)
        )
        with self._lock:
            for event in self._early:
                self._pass_on(event, source)
            self._early.clear()
            self._source = source
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
            if self._source is not None:
                self._source.note = f"the transfer failed: {error}"
        finally:
            self._ready.set()

    async def _transfer(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._task = asyncio.ensure_future(self._receive(self._note))
        await self._task

    def _note(self, event: Event) -> None:
        """Called in the receiving thread."""
        with self._lock:
            if self._source is None:
                self._early.append(event)
            else:
                self._pass_on(event, self._source)
        if isinstance(event, (SideInfoArrived, Finished)):
            if isinstance(event, Finished):
                self._over = event.reason
            self._ready.set()

    def _pass_on(self, event: Event, source: LiveSource) -> None:
        source.seconds = time.perf_counter() - self._began
        match event:
            case PacketArrived():
                source.hand_over(event.packet)
            case Finished():
                source.note = _WORDS.get(event.reason, event.reason)
