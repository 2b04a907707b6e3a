"""The page: a thin shell of viser around `Viewer`."""

import contextlib
import io
import socket
import threading
import time
import warnings
from dataclasses import dataclass, field
from typing import Any

from splatwire.conceal import concealer_names
from splatwire.errors import BackendUnavailableError, InvalidValueError, SplatwireError
from splatwire.view.live import PreviewSource
from splatwire.view.looks import FirstLook, Look, Pace
from splatwire.view.model import Settings, Viewer
from splatwire.view.panel import Panel
from splatwire.view.sources import LiveSource

STILL_S = 0.25
"""A view that has not moved for so long gets a sharp picture."""
MOST_CLIENTS = 8
"""Further pages are told that there is no room; pictures are drawn for one after another."""


@dataclass
class _Client:
    """Someone who looks at the page."""

    handle: Any
    look: Look | None = None
    changed_at: float = 0.0
    drawn: tuple[Any, ...] | None = None
    sharp: bool = False
    pace: Pace = field(default_factory=Pace)


class ViewerServer:
    """Serves the page until told to stop.

    Args:
        viewer: What is shown.
        settings: What is chosen at first.
        first: Where to look from at first.
        concealers: Names to choose from.
        host: Address to listen on.
        port: Port; 0 lets the system choose.
        still_height: Height of a sharp picture at most, pixels.
        play_s: How long playing the transfer takes, seconds.

    Raises:
        BackendUnavailableError: If viser is not installed.
        InvalidValueError: If the port is taken, or the host no address of this machine.
    """

    def __init__(
        self,
        viewer: Viewer,
        settings: Settings,
        first: FirstLook,
        concealers: tuple[str, ...],
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        still_height: int = 720,
        play_s: float = 10.0,
    ) -> None:
        viser = require_viser()
        self._viewer, self._first, self._still_height, self._play_s = viewer, first, still_height, play_s
        self._clients: dict[int, _Client] = {}
        self._news = threading.Condition()
        self._stopped = self._cannot_open = False
        self._settings_at = self._drawn_at = time.monotonic()
        port = free_port(host, port)
        with contextlib.redirect_stdout(io.StringIO()):  # a banner that nobody asked for
            self._server = viser.ViserServer(host=host, port=port, label="splatwire", verbose=False)
        live = viewer.source.live
        self._panel = Panel(self._server, settings, concealers, live=live, changed=self._settings_changed)
        self._server.scene.set_up_direction(first.up)
        self._server.scene.world_axes.visible = False
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.up, camera.fov = first.position, first.look_at, first.up, first.fov
        self._server.on_client_connect(self._joined)
        self._server.on_client_disconnect(self._left)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    @property
    def settings(self) -> Settings:
        """What is chosen now."""
        return self._panel.settings

    @property
    def concealers(self) -> tuple[str, ...]:
        """What can be chosen now."""
        return self._panel.concealers

    @property
    def playing(self) -> bool:
        """Whether the transfer is being played."""
        return self._panel.playing

    def run(self) -> None:
        """Draws until `stop`."""
        try:
            while not self._stopped:
                self._play()
                work = self._next_work()
                if work is None:
                    with self._news:
                        self._news.wait(0.05)
                    continue
                self._draw(*work)
        finally:
            with contextlib.redirect_stdout(io.StringIO()):
                self._server.stop()

    def stop(self) -> None:
        """Makes `run` return; from any thread."""
        with self._news:
            self._stopped = True
            self._news.notify_all()

    def _joined(self, handle: Any) -> None:
        with self._news:
            if len(self._clients) >= MOST_CLIENTS:
                handle.add_notification("No room", f"{MOST_CLIENTS} pages are open already.", color="red")
                return
            client = self._clients[handle.client_id] = _Client(handle)
        handle.camera.on_update(lambda _: self._moved(client))

    def _left(self, handle: Any) -> None:
        with self._news:
            self._clients.pop(handle.client_id, None)

    def _moved(self, client: _Client) -> None:
        camera = client.handle.camera
        position, wxyz = tuple(map(float, camera.position)), tuple(map(float, camera.wxyz))
        aspect = min(max(float(camera.aspect), 0.2), 5.0)
        with self._news:
            client.look = Look(position, wxyz, float(camera.fov), aspect)  # type: ignore[arg-type]
            client.changed_at = time.monotonic()
            self._news.notify_all()

    def _settings_changed(self) -> None:
        with self._news:
            self._settings_at = time.monotonic()
            self._news.notify_all()

    def _play(self) -> None:
        """Moves a playing transfer on by the time that has passed."""
        now = time.monotonic()
        if self._panel.playing:
            passed = min(now - self._drawn_at, 0.5)
            self._panel.move_to(min(self._panel.settings.progress + passed / self._play_s, 1.0))
            self._settings_at = now
        self._drawn_at = now

    def _next_work(self) -> tuple[_Client, Look, bool] | None:
        """Whose picture is due, and whether a sharp one: moving views first, sharp pictures when all is quiet."""
        self._open()
        source, settings, now = self._viewer.source, self._panel.settings, time.monotonic()
        if isinstance(source, LiveSource) and source.has_news:
            self._settings_at = now
        with self._news:
            clients = [client for client in self._clients.values() if client.look is not None]
            for client in clients:
                assert client.look is not None
                if client.drawn != (client.look, settings, self._settings_at):
                    return client, client.look, False
            for client in clients:
                assert client.look is not None
                if not client.sharp and now - max(client.changed_at, self._settings_at) > STILL_S:
                    return client, client.look, True
        return None

    def _open(self) -> None:
        """Puts the scene in the place of its preview once it is there."""
        preview = self._viewer.source
        if not isinstance(preview, PreviewSource) or not preview.has_scene or self._cannot_open:
            return
        try:
            scene = preview.open()
        except SplatwireError as error:  # the preview is better than nothing
            self._panel.complain(str(error))
            self._cannot_open = True
            return
        self._viewer.source = scene
        self._panel.offer(concealer_names(scene.sections))
        self._settings_at = time.monotonic()

    def _draw(self, client: _Client, look: Look, sharp: bool) -> None:
        settings, at, pace = self._panel.settings, self._settings_at, client.pace
        height = self._still_height if sharp else pace.height
        client.sharp, client.drawn = sharp, (look, settings, at)
        began = time.perf_counter()
        try:
            frame = self._viewer.frame(settings, look.cameras(height), score=sharp)
        except SplatwireError as error:  # this choice cannot be shown, the next one may
            self._panel.complain(str(error))
            client.sharp = True
            return
        seconds = time.perf_counter() - began
        with self._news:
            gone = client.handle.client_id not in self._clients
        if gone:
            return
        with warnings.catch_warnings():  # who leaves just now misses nothing
            warnings.simplefilter("ignore", UserWarning)
            client.handle.scene.set_background_image(
                frame.image.numpy(), format="jpeg", jpeg_quality=90 if sharp else 75
            )
        self._panel.say(frame.status)
        if not sharp:
            client.pace = pace.after(height, seconds)


def require_viser() -> Any:
    """Loads viser.

    Raises:
        BackendUnavailableError: If it is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise BackendUnavailableError("viser", "install it with: pip install 'splatwire[view]'") from error
    return viser


def free_port(host: str, port: int) -> int:
    """Checks that a port can be listened on; viser would silently take another one.

    Args:
        host: Address.
        port: Port; 0 lets the system choose.

    Raises:
        InvalidValueError: If it cannot be listened on.
    """
    if not 0 <= port < 1 << 16:
        raise InvalidValueError(f"a port is a number from 0 to 65535, {port} is not")
    try:
        family, kind, protocol, _, target = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(target)
            return int(probe.getsockname()[1])
    except OSError as error:
        raise InvalidValueError(f"cannot listen on {host}:{port}: {error.strerror or error}") from error
