"""`splatwire view`: a scene, its losses and how they are hidden, in a browser."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE
from splatwire.cli._files import input_path, is_stream
from splatwire.cli._output import JsonFlag, Reporter, print_json, print_summary, progress_bars
from splatwire.cli._scenes import BackgroundOption, chosen_background
from splatwire.errors import BitstreamError, InvalidValueError

if TYPE_CHECKING:
    from splatwire.view.live import LiveTransfer, Receive
    from splatwire.view.model import Source


@dataclass(frozen=True)
class View:
    """Look at a stream in a browser: losses, concealers, damage, and the transfer as it happens."""

    stream: tyro.conf.Positional[str] = ""
    """Stream, udp:// or quic://HOST[:PORT][/NAME] of a server, or - for standard input; the bundled scene if absent."""
    cameras: Path | None = None
    """Cameras file, whose first view is where the viewer starts."""
    host: str = "127.0.0.1"
    """Address to listen on; others than this machine get in only if you choose an address that they can reach."""
    port: int = 8080
    """Port of the page; 0 lets the system choose."""
    loss: float = 0.2
    """Share of packets that is lost at first, 0 to 0.9."""
    burst: float = 1.0
    """Mean length of bursts at first, in packets; 1 loses each on its own."""
    seed: int = 0
    """Seed of the losses at first."""
    conceal: str = "grow"
    """Concealer at first."""
    rate: float = 10.0
    """Rate of the link that is played, Mbit/s."""
    height: int = 720
    """Height of a sharp picture, pixels."""
    renderer: str = "cpu"
    """Renderer: cpu or gsplat."""
    background: BackgroundOption = None
    """RGB from 0 to 1 behind everything; what the scene was trained in front of where absent."""
    fingerprint: str | None = None
    """With quic://: SHA-256 of the server's certificate, as the server tells it; nothing else about it matters then."""
    insecure: bool = False
    """With quic://: take any certificate; somebody on the path can pose as the server."""
    json: JsonFlag = False
    """Print one JSON object, with the address of the page, when it is ready."""

    def run(self) -> None:
        """Runs the verb until Ctrl-C."""
        from splatwire.conceal import concealer_names, create_concealer
        from splatwire.model import SplatScene
        from splatwire.render.importance import cameras_around
        from splatwire.view.looks import first_look
        from splatwire.view.model import Settings, Viewer
        from splatwire.view.server import ViewerServer, require_viser

        self._check()
        background = chosen_background(self.background)
        require_viser()
        create_concealer(self.conceal)
        settings = Settings(self.loss, self.burst, self.seed, self.conceal)
        settings.loss_model()
        with progress_bars() as show:
            source, transfer, cameras = self._open(show)
        names = source.progressive.concealers if source.progressive else concealer_names()
        names = names if self.conceal in names else (*names, self.conceal)
        try:
            play_s = getattr(source, "transfer_seconds", 10.0)
            viewer = Viewer(source, self.renderer, background)
            with progress_bars() as show:  # what is compiled for the first picture is, before anybody looks
                show("drawing a picture", 0.0)
                viewer.frame(settings, cameras_around(source.positions, 1, 96))
            server = ViewerServer(
                viewer, settings, first_look(source.positions, cameras), names,
                host=self.host, port=self.port, still_height=self.height, play_s=max(play_s, 2.0),
            )  # fmt: skip
            count, early = len(source.positions), source.preview is not None
            elements = source.progressive.decoder.manifest.elements if source.progressive else SplatScene.ELEMENTS
            with _stopping(server.stop):
                if self.json:
                    about = {elements.lower(): count, "preview": early, "live": source.live, "concealers": names}
                    print_json({"url": server.url, **about})
                else:
                    what = f"a preview of {count} Gaussians" if early else f"{count:,} {elements}"
                    print_summary(f"{what} at {server.url} (Ctrl-C ends it)")
                server.run()
        finally:
            if transfer is not None:
                transfer.stop()

    def _check(self) -> None:
        for what, value, low, high in (
            ("--loss", self.loss, 0, 0.9),
            ("--burst", self.burst, 1, 50),
            ("--rate", self.rate, 0.001, 1e6),
            ("--height", self.height, 64, 4320),
            ("--seed", self.seed, 0, 2**31),
        ):
            if not low <= value <= high:
                raise InvalidValueError(f"{what} must be from {low:g} to {high:g}, not {value:g}")

    def _open(self, show: Reporter):  # type: ignore[no-untyped-def]
        """The source, its transfer if it is live, and cameras if there are any."""
        from splatwire.data import load_cameras
        from splatwire.packets import read_stream
        from splatwire.view.live import LiveTransfer
        from splatwire.view.sources import FileSource

        cameras = None if self.cameras is None else load_cameras(self.cameras)
        if "://" in self.stream:
            transfer = LiveTransfer(self.stream, self._receive())
            return _started(transfer, show), transfer, cameras
        if not self.stream and cameras is None:
            cameras = load_cameras(ASSETS / CAMERAS)
        with input_path(self.stream or str(ASSETS / SCENE)) as path:
            if not is_stream(path):
                raise BitstreamError(f"{path} is not a splatwire stream; `splatwire encode` makes one of a scene")
            stream, _ = read_stream(path)
        source = FileSource(
            stream, bytes_per_second=self.rate * 125_000, progress=lambda share: show("decoding", share)
        )
        return source, None, cameras

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


def _started(transfer: "LiveTransfer", show: Reporter) -> "Source":
    try:
        return transfer.start(show)
    except BaseException:
        transfer.stop()
        raise


@contextmanager
def _stopping(stop) -> Iterator[None]:  # type: ignore[no-untyped-def]
    """Ctrl-C and a polite end of the process stop the server instead of tearing it down in the middle."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, lambda *_: stop()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
