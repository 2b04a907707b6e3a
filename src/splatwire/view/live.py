"""Receiving in a thread of its own, so that drawing never holds up the network; until there is a scene, its preview."""

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable
from typing import TypeAlias

import torch
from jaxtyping import Bool
from torch import Tensor

from splatwire.codec.preview import preview_splats
from splatwire.errors import BitstreamError, MissingSideInfoError, SplatwireError
from splatwire.model import AnchorScene
from splatwire.scene import Anchors
from splatwire.transport import Event, Finished, PacketArrived, Receiver, SideInfoArrived, Welcomed
from splatwire.view.model import PreviewScene, Settings, Status
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
        self._first: SideInfoArrived | None = None
        self._preview: tuple[PreviewScene, Welcomed] | None = None
        self._damaged = ""
        self._over = ""
        self._problem: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Future[Receiver] | None = None
        self._thread = threading.Thread(target=self._run, name="splatwire-receive", daemon=True)

    def start(self, progress: Callable[[str, float], None]) -> "LiveSource | PreviewSource":
        """Waits until there is something to look at; packets go on arriving meanwhile.

        Args:
            progress: Called with what is being done and the share of it that is done.

        Returns:
            The preview if that came first, as a rule with the server's first answer; else the scene, prepared.

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
        if self._preview is not None and not self.has_scene:
            return PreviewSource(self, *self._preview)
        return self.open(progress)

    @property
    def has_scene(self) -> bool:
        """Whether the side information is there."""
        return self._first is not None

    @property
    def seconds(self) -> float:
        """Since the beginning."""
        return time.perf_counter() - self._began

    @property
    def note(self) -> str:
        """What a person who looks at the preview should know."""
        over = self._over or (f"the transfer failed: {self._problem}" if self._problem else "")
        return f"no scene arrived ({over}): this is its preview" if over else "a preview, until the scene is there"

    def open(self, progress: Callable[[str, float], None]) -> LiveSource:
        """Prepares the scene, from which on it is what packets go to.

        Args:
            progress: As for `start`.

        Raises:
            MissingSideInfoError: If its side information is not there.
            BitstreamError: If it cannot be read.
        """
        first = self._first
        if first is None:
            raise MissingSideInfoError(f"{self._url}: no scene arrived ({self._over or self._problem or 'stopped'})")
        source = LiveSource(
            first.manifest, first.side_info, progress=lambda share: progress("preparing the scene", share)
        )
        source.note += self._damaged
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
        match event:
            case Welcomed(preview=preview) if preview:
                self._shows(event)
            case SideInfoArrived():
                self._first = event
                self._ready.set()
            case Finished():
                self._over = event.reason
                self._ready.set()

    def _shows(self, welcomed: Welcomed) -> None:
        """Takes a preview, if it is one: the scene may be good all the same."""
        try:
            self._preview = PreviewScene(*preview_splats(welcomed.preview)), welcomed
        except BitstreamError as error:
            self._damaged = f"; what should have been its {error}"
        else:
            self._ready.set()

    def _pass_on(self, event: Event, source: LiveSource) -> None:
        source.seconds = time.perf_counter() - self._began
        match event:
            case PacketArrived():
                source.hand_over(event.packet)
            case Finished():
                source.note = _WORDS.get(event.reason, event.reason)


class PreviewSource:
    """What a transfer's first datagram shows, until there is a scene.

    Args:
        transfer: The transfer.
        preview: What is shown.
        welcomed: The event that brought it.
    """

    live = True
    sections: tuple[str, ...] = ()

    def __init__(self, transfer: LiveTransfer, preview: PreviewScene, welcomed: Welcomed) -> None:
        self._transfer, self._preview, self._welcomed = transfer, preview, welcomed

    @property
    def anchors(self) -> Anchors:
        """See `Source`: where the Gaussians are."""
        means, count = self._preview.splats.means, self._preview.splats.num_gaussians
        zeros, nothing = means.new_zeros, torch.zeros(count, 0, dtype=torch.bool)
        return Anchors(means, zeros(count, 0), zeros(count, 6), zeros(count, 0, 3), nothing)

    @property
    def known(self) -> Bool[Tensor, "N"]:
        """See `Source`."""
        return torch.zeros(self._preview.splats.num_gaussians, dtype=torch.bool)

    has_news: bool = False

    @property
    def has_scene(self) -> bool:
        """Whether it is time to open the scene."""
        return self._transfer.has_scene

    def open(self) -> LiveSource:
        """The scene that takes its place.

        Raises:
            BitstreamError: If its side information is not there, or cannot be read.
        """
        return self._transfer.open(lambda task, share: None)

    def reference(self) -> AnchorScene | None:
        """See `Source`; there is none."""
        return None

    def scene(self, settings: Settings) -> PreviewScene:
        """See `Source`; nothing can be chosen about a preview."""
        return self._preview

    def status(self) -> Status:
        """See `Source`."""
        return Status(
            len(self._welcomed.preview), None, self._transfer.seconds, 0, self._welcomed.num_packets, 0, 0,
            note=self._transfer.note,
        )  # fmt: skip
