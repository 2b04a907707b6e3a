"""`splatwire view`: a page on this machine that shows a stream, its losses and how they are hidden."""

import asyncio
import sys
import webbrowser
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli._background import start_thread
from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE
from splatwire.cli._files import input_path, is_stream, stream_name
from splatwire.cli._listening import check_port, stop_on_signals
from splatwire.cli._output import JsonFlag, print_json, print_summary
from splatwire.cli._receiving import TrustOptions
from splatwire.errors import BitstreamError, InvalidValueError

if TYPE_CHECKING:
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras
    from splatwire.transport.page_content import PageContent
    from splatwire.view import Relay


@dataclass(frozen=True)
class View:
    """Look at a stream in a browser: losses, concealers, and the transfer as it happens."""

    stream: tyro.conf.Positional[str] = ""
    """Stream, udp:// or quic://HOST[:PORT][/NAME] of a server, or - for standard input; the bundled scene if absent."""
    cameras: Path | None = None
    """Cameras file, whose first view is where the page begins."""
    host: str = "127.0.0.1"
    """Address to listen on; others than this machine get in only if you choose an address that they can reach."""
    port: int = 8080
    """Port of the page; 0 lets the system choose."""
    open: bool = True
    """Open the page in this machine's browser."""
    trust: TrustOptions = field(default_factory=TrustOptions)
    json: JsonFlag = False
    """Print one JSON object, with the address of the page, when it is ready."""

    def run(self) -> None:
        """Runs the verb until Ctrl-C."""
        from splatwire.data import load_cameras

        check_port(self.port)
        if self.trust.given and "://" not in self.stream:
            raise InvalidValueError("--fingerprint, --authority and --insecure are for quic://")
        cameras = None if self.cameras is None else load_cameras(self.cameras)
        if not self.stream and cameras is None:
            cameras = load_cameras(ASSETS / CAMERAS)
        if "://" in self.stream:
            asyncio.run(self._hand_on(cameras))
        else:
            from splatwire.view import page_of_stream

            name = stream_name(self.stream or SCENE)
            asyncio.run(self._serve(page_of_stream(name, self._read(), cameras, self.host)))

    def _read(self) -> "SceneStream":
        from splatwire.packets import read_stream

        with input_path(self.stream or str(ASSETS / SCENE)) as path:
            if not is_stream(path):
                raise BitstreamError(f"{path} is not a splatwire stream; `splatwire encode` makes one of a scene")
            return read_stream(path)[0]

    async def _hand_on(self, cameras: "Cameras | None") -> None:
        """Serves what another server sends, while it sends it."""
        from splatwire.transport.address import parse_url
        from splatwire.view import page_of_relay

        name = parse_url(self.stream).name or "scene"
        relay = self._relay()
        receiving = asyncio.create_task(relay.run())
        try:
            await relay.begun()
            if receiving.done():
                await receiving  # raises what went wrong
            if relay.is_live:
                print(
                    f"splatwire: {self.stream} is live: the page shows what there is when it is loaded", file=sys.stderr
                )
            await self._serve(page_of_relay(name, relay, cameras, self.host), receiving)
        finally:
            receiving.cancel()
            await asyncio.gather(receiving, return_exceptions=True)

    async def _serve(self, content: "PageContent", receiving: "asyncio.Task[None] | None" = None) -> None:
        """Serves the page until a signal, or until receiving fails."""
        from splatwire.transport.page import PageServer

        stop = stop_on_signals()
        if receiving is not None:
            receiving.add_done_callback(lambda task: None if _went_well(task) else stop.set())
        async with PageServer(content, self.port) as page:
            if self.json:
                print_json({"url": page.url})
            else:
                print_summary(f"{page.url} (Ctrl-C ends it)")
                if self.open:
                    start_thread(lambda: webbrowser.open(page.url), "browser")  # one in a terminal returns at its end
            await stop.wait()
        if receiving is not None and receiving.done():
            receiving.result()

    def _relay(self) -> "Relay":
        """What receives the stream that the address names."""
        from splatwire.transport import ReceiverOptions
        from splatwire.transport.address import parse_url
        from splatwire.view import Relay

        address = parse_url(self.stream)
        transfer, options = self.trust.transfer(address), ReceiverOptions(name=address.name)
        return Relay(self.stream, lambda note: transfer(options, note))


def _went_well(task: "asyncio.Task[None]") -> bool:
    return not task.cancelled() and task.exception() is None
