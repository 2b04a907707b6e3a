"""The page: a thin shell of viser around `Viewer`."""

import contextlib
import io
import math
import socket
import threading
import time
import warnings
from dataclasses import dataclass, field
from typing import Any

from splatwire.conceal import concealer_names
from splatwire.errors import BackendUnavailableError, InvalidValueError, SplatwireError
from splatwire.view.guard import start_guarded
from splatwire.view.looks import FirstLook, Look, Pace, Triple
from splatwire.view.model import Settings, Viewer
from splatwire.view.panel import Panel

STILL_S = 0.25
"""A view that has not moved for so long gets a sharp picture."""
ARRIVAL_S = 3.0
"""A new page first says some place of its own; when it has not gone to the starting place for so long, it is let be."""
MOST_CLIENTS = 8
"""Further pages are told that there is no room; pictures are drawn for one after another."""


@dataclass
class _Client:
    """Someone who looks at the page.

    Attributes:
        look: What is drawn for them.
        said: Where their page said it was, last.
        arrived: Whether that is what is drawn.
    """

    handle: Any
    look: Look
    said: Look
    joined_at: float
    arrived: bool = False
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
        self._reach = first.limits.farthest
        self._clients: dict[int, _Client] = {}
        self._news = threading.Condition()
        self._stopped = False
        self._settings_at = self._drawn_at = time.monotonic()
        port = free_port(host, port)
        with contextlib.redirect_stdout(io.StringIO()):  # a banner that nobody asked for
            self._server = start_guarded(
                lambda: viser.ViserServer(host=host, port=port, label="splatwire", verbose=False), host
            )
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
        host = self._server.get_host()
        return f"http://{f'[{host}]' if ':' in host else host}:{self._server.get_port()}"

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
        said = _look_of(handle.camera)
        client = _Client(handle, self._first.look(said.aspect), said, time.monotonic())
        with self._news:
            if len(self._clients) >= MOST_CLIENTS:
                handle.add_notification("No room", f"{MOST_CLIENTS} pages are open already.", color="red")
                return
            self._clients[handle.client_id] = client
        limits = self._first.limits
        handle.camera.max_orbit_distance, handle.camera.min_orbit_distance = limits.farthest, limits.nearest
        handle.camera.on_update(lambda _: self._moved(client))

    def _left(self, handle: Any) -> None:
        with self._news:
            self._clients.pop(handle.client_id, None)

    def _moved(self, client: _Client) -> None:
        said = _look_of(client.handle.camera)
        with self._news:
            client.said = said
            client.arrived = client.arrived or math.dist(said.position, self._first.position) < 1e-3 * self._reach
            if client.arrived and self._stays_within(client.handle):
                client.look, client.changed_at = said, time.monotonic()
            self._news.notify_all()

    def _stays_within(self, handle: Any) -> bool:
        """Brings a view back that left the place where there is something to see; says whether it had not."""
        camera = handle.camera
        position, look_at = _triple(camera.position), _triple(camera.look_at)
        place, target = self._first.limits.within(position, look_at)
        if max(math.dist(place, position), math.dist(target, look_at)) < 1e-3 * self._reach:
            return True
        with handle.atomic():  # the first moves the second along, which nobody should see
            camera.position = place
            camera.look_at = target
        return False

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
        self._advance()
        settings, now = self._panel.settings, time.monotonic()
        with self._news:
            clients = list(self._clients.values())
            for client in clients:
                if not client.arrived and now - client.joined_at > ARRIVAL_S:
                    client.arrived, client.look = True, client.said
                if client.drawn != (client.look, settings, self._settings_at):
                    return client, client.look, False
            for client in clients:
                if not client.sharp and now - max(client.changed_at, self._settings_at) > STILL_S:
                    return client, client.look, True
        return None

    def _advance(self) -> None:
        """Takes what came meanwhile; with a scene come its concealers."""
        source = self._viewer.source
        try:
            news = source.advance()
        except SplatwireError as error:  # the preview is better than nothing
            self._panel.complain(str(error))
            return
        if news:
            self._settings_at = time.monotonic()
            self._panel.offer(source.progressive.concealers if source.progressive else concealer_names())

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


def _look_of(camera: Any) -> Look:
    """Where a page is."""
    w, x, y, z = map(float, camera.wxyz)
    return Look(_triple(camera.position), (w, x, y, z), float(camera.fov), min(max(float(camera.aspect), 0.2), 5.0))


def _triple(vector: Any) -> Triple:
    x, y, z = map(float, vector)
    return x, y, z


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
