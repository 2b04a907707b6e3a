"""`splatwire view`: the page that shows a stream, its losses and how they are hidden."""

import asyncio
import signal
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE
from splatwire.cli._files import input_path, is_stream
from splatwire.cli._output import JsonFlag, print_json, print_summary, progress_bars
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.errors import BitstreamError, InvalidValueError

if TYPE_CHECKING:
    from splatwire.packets import SceneStream
    from splatwire.scene import Cameras
    from splatwire.transport.page_content import PageContent
    from splatwire.view.live import Receive
    from splatwire.view.model import Source


@dataclass(frozen=True)
class View:
    """Look at a stream in a browser: losses, concealers, damage, and the transfer as it happens."""

    stream: tyro.conf.Positional[str] = ""
    """Stream, udp:// or quic://HOST[:PORT][/NAME] of a server, or - for standard input; the bundled scene if absent."""
    cameras: Path | None = None
    """Cameras file, whose first view is where the page begins."""
    host: str = "127.0.0.1"
    """Address to listen on; others than this machine get in only if you choose an address that they can reach."""
    port: int = 8080
    """Port of the page; 0 lets the system choose."""
    renderer: str = "cpu"
    """What draws streams of format 1: cpu or gsplat. All others are drawn by the browser."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind streams of format 1; what the scene was trained in front of where absent."""
    fingerprint: str | None = None
    """With quic://: SHA-256 of the server's certificate, as the server tells it; nothing else about it matters then."""
    insecure: bool = False
    """With quic://: take any certificate; somebody on the path can pose as the server."""
    json: JsonFlag = False
    """Print one JSON object, with the address of the page, when it is ready."""

    def run(self) -> None:
        """Runs the verb until Ctrl-C."""
        from splatwire.data import load_cameras

        if not 0 <= self.port < 1 << 16:
            raise InvalidValueError(f"a port is a number from 0 to 65535, {self.port} is not")
        cameras = None if self.cameras is None else load_cameras(self.cameras)
        if not self.stream and cameras is None:
            cameras = load_cameras(ASSETS / CAMERAS)
        with ExitStack() as stack:
            asyncio.run(self._serve(self._content(cameras, stack)))

    def _content(self, cameras: "Cameras | None", stack: ExitStack) -> "PageContent":
        """What is served: a stream that the browser draws, or pictures."""
        from splatwire.packets import ANCHORS
        from splatwire.view.live import LiveTransfer
        from splatwire.view.page import page_of_pictures, page_of_stream
        from splatwire.view.sources import FileSource

        chosen = chosen_background(self.background)
        with progress_bars() as show:
            source: Source
            if "://" in self.stream:
                transfer = LiveTransfer(self.stream, self._receive())
                stack.callback(transfer.stop)
                source = transfer.start(show)
            else:
                stream = self._read()
                if stream.manifest.codec != ANCHORS:
                    return page_of_stream(stream, cameras, self.host)
                source = FileSource(stream, progress=lambda share: show("decoding", share))
            return page_of_pictures(source, cameras, self.host, self.renderer, chosen, show)

    def _read(self) -> "SceneStream":
        from splatwire.packets import read_stream

        with input_path(self.stream or str(ASSETS / SCENE)) as path:
            if not is_stream(path):
                raise BitstreamError(f"{path} is not a splatwire stream; `splatwire encode` makes one of a scene")
            return read_stream(path)[0]

    async def _serve(self, content: "PageContent") -> None:
        from splatwire.transport.page import PageServer

        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stop.set)
        async with PageServer(content, self.port) as page:
            if self.json:
                print_json({"url": page.url, "drawn_by": "browser" if content.pictures is None else "server"})
            else:
                print_summary(f"{page.url} (Ctrl-C ends it)")
            await stop.wait()

    def _receive(self) -> "Receive":
        """What receives the stream that the address names."""
        from splatwire.transport import ReceiverOptions
        from splatwire.transport.address import parse_url

        address = parse_url(self.stream)
        options = ReceiverOptions(name=address.name)
        if address.scheme != "quic" and (self.fingerprint or self.insecure):
            raise InvalidValueError("--fingerprint and --insecure are for quic://")
        if address.scheme == "udp":
            from splatwire.transport.udp import receive_udp

            return lambda note: receive_udp(address, options, note)
        from splatwire.transport.quic import need_aioquic

        need_aioquic()
        from splatwire.transport.quic_client import Trust, receive_quic

        trust = Trust(fingerprint=self.fingerprint, insecure=self.insecure)
        return lambda note: receive_quic(address, options, trust, note)
