"""Serving a scene while it is trained: receivers and pages get the changes."""

import asyncio
import contextlib
import logging
import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splatwire.api.offered_updates import OfferedUpdates
from splatwire.arguments import array_of, checked
from splatwire.bitstream import SceneStream
from splatwire.errors import InvalidValueError, shown
from splatwire.rate_control.partial_updates import SHARE, PartialUpdates
from splatwire.transport import Protection, ServedStream, ServerLimits, make_served_stream
from splatwire.transport.http.content import PageContent
from splatwire.transport.protocol.preview import stream_preview
from splatwire.transport.running_server import DRAIN_INTERVAL_S, RunningServer
from splatwire.transport.udp import UdpServer
from splatwire.types.background import BLACK, Background, check_background
from splatwire.types.origin import NO_ORIGIN, Origin, check_origin
from splatwire.types.splats import Splats

LOG = logging.getLogger(__name__)
STREAM_NAME = "scene"
"""Name of the stream that a training server offers."""
REQUEST_S = 2.0
"""Time within which clients that follow a scene request its next update, seconds; pages do so once a second."""


@dataclass(frozen=True)
class _Settings:
    """Settings of a training server; the fields are arguments of `serve_training`."""

    host: str
    port: int
    page: int | None
    share: float
    antialiased: bool
    origin: Origin
    background: Background
    protection: Protection
    limits: ServerLimits


@dataclass(frozen=True, eq=False)
class _Opened:
    """A training server that runs in a separate thread.

    Attributes:
        running: The server.
        loop: Event loop of the thread.
        stop: Event that stops the server.
    """

    running: RunningServer
    loop: asyncio.AbstractEventLoop
    stop: asyncio.Event


class TrainingServer:
    """Server of a scene in training, created by `serve_training`.

    The methods may be called by any thread.
    """

    # One thread sends, and one encodes. A forked process, such as that of a data loader, has neither of them.

    def __init__(self, settings: _Settings) -> None:
        self._settings = settings
        self._process = os.getpid()
        self._condition = threading.Condition()
        self._waiting: tuple[Splats, float] | None = None
        self._num_pushed = self._num_done = 0
        self._encoding_s = 0.0
        self._error: Exception | None = None
        self._closed = False
        opened: Future[_Opened] = Future()
        self._serving = threading.Thread(target=self._serve, args=(opened,), name="splatwire-serving", daemon=True)
        self._serving.start()
        try:
            self._opened = opened.result()
        except BaseException:  # also Ctrl-C, while the server is opened
            opened.add_done_callback(_stop_opened)
            self._serving.join()
            raise
        self._encoding = threading.Thread(target=self._encode, name="splatwire-encoding", daemon=True)
        self._encoding.start()

    @property
    def port(self) -> int:
        """UDP port that receivers connect to."""
        return self._opened.running.server.port

    @property
    def facts(self) -> dict[str, str]:
        """Information that clients need to connect, by name; empty without a viewer page.

        `page` is the URL of the viewer page. `fingerprint` is the SHA-256 of the server's certificate.
        """
        return dict(self._opened.running.facts)

    @property
    def encoding_seconds(self) -> float:
        """Duration of the last encoding, seconds; 0 before the first one."""
        with self._condition:
            return self._encoding_s

    @checked
    def push(
        self, means: Any, quats: Any, scales: Any, opacities: Any, sh: Any, *, wait: bool = False,
        share: float | None = None,
    ) -> None:  # fmt: skip
        """Sends the Gaussians of the trainer: all of them in the first call, later the most important changes.

        The arrays (numpy, or torch on any device) are copied and encoded in another thread. While this thread is busy,
        the Gaussians of the latest call wait. They replace Gaussians of an earlier call that still wait.

        Args:
            means: Coordinates of the centres relative to the origin of the server, world units, (G, 3).
            quats: Rotations, quaternions (w, x, y, z) of any length, (G, 4).
            scales: Standard deviations along the axes, not their logarithms, world units, (G, 3).
            opacities: Opacities in (0, 1), not logits, (G,).
            sh: Coefficients of spherical harmonics, (G, D, 3).
            wait: True to return only when clients can receive the changes.
            share: Maximum share of the Gaussians to send, 1 for all changes; None for the share of the server.

        Raises:
            InvalidValueError: If the arrays are not valid Gaussians, `share` is out of range, the server is closed or
                belongs to the parent process (after a fork), or the Gaussians of an earlier call could not be encoded.
        """
        _check_share(share)
        arrays = {"means": means, "quats": quats, "scales": scales, "opacities": opacities, "sh": sh}
        shapes: dict[str, tuple[int | str, ...]] = {
            "means": ("G", 3), "quats": ("G", 4), "scales": ("G", 3), "opacities": ("G",), "sh": ("G", "D", 3)
        }  # fmt: skip
        # A trainer changes its arrays in place.
        rows = {name: np.array(_floats(value, name, shapes[name]), np.float32) for name, value in arrays.items()}
        for name, values in rows.items():
            if len(values) != len(rows["means"]):
                raise InvalidValueError(f"{name}: expected {len(rows['means'])} rows, as in means, not {len(values)}")
        splats = Splats(**rows).with_unit_quats()
        if not splats.num_gaussians:
            raise InvalidValueError("means: expected at least one Gaussian")
        self._check_process()
        with self._condition:
            self._raise_error()
            if self._closed:
                raise InvalidValueError("push: the server is closed")
            self._waiting = splats, self._settings.share if share is None else share
            self._num_pushed += 1
            number = self._num_pushed
            self._condition.notify_all()
            while wait and self._num_done < number and not self._closed:
                self._condition.wait()
            self._raise_error()
            if wait and self._num_done < number:
                raise InvalidValueError("push: the server was closed before the Gaussians were encoded")

    @checked
    def drain(self, most_s: float = 10.0) -> None:
        """Waits until clients have received the Gaussians of all previous calls of `push`.

        Args:
            most_s: Maximum duration, seconds.

        Raises:
            InvalidValueError: If the duration is not a number of at least 0, or the last pushed Gaussians could not be
                encoded.
        """
        # Clients that follow the scene get `REQUEST_S` to request the last state.
        if not most_s >= 0:
            raise InvalidValueError(f"most_s: expected a number of at least 0, not {shown(most_s)}")
        self._check_process()
        end = time.monotonic() + most_s
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._num_done == self._num_pushed, most_s)
            self._raise_error()
        time.sleep(max(min(REQUEST_S, end - time.monotonic()), 0))
        while time.monotonic() < end and self._opened.running.is_busy:
            time.sleep(DRAIN_INTERVAL_S)

    def close(self) -> None:
        """Stops the server and its transfers. Call `drain` first to let the transfers finish."""
        if os.getpid() != self._process:
            return
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._encoding.join()
        _stop(self._opened)
        self._serving.join()

    def _check_process(self) -> None:
        """Raises an error if the current process is a fork, in which the threads of the server do not run."""
        if os.getpid() != self._process:
            raise InvalidValueError("push: the server belongs to another process, from which this one was forked")

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error

    def _encode(self) -> None:
        """Encodes the scenes that `push` has passed, until the server is closed. Runs in a separate thread."""
        try:
            self._encode_until_closed()
        finally:  # no call waits for a thread that has ended
            with self._condition:
                self._closed = True
                self._condition.notify_all()

    def _encode_until_closed(self) -> None:
        state: PartialUpdates | None = None
        updates = OfferedUpdates(self._prepared)
        while True:
            with self._condition:
                while self._waiting is None and not self._closed:
                    self._condition.wait()
                if self._closed:
                    return
                waiting, number, self._waiting = self._waiting, self._num_pushed, None
            assert waiting is not None
            error: Exception | None = None
            started = time.monotonic()
            try:
                state = self._published(state, *waiting, updates)
            except Exception as raised:  # the next push raises it
                error = raised
                LOG.warning("the pushed Gaussians are not sent: %s", raised)
            with self._condition:
                self._num_done, self._error, self._encoding_s = number, error, time.monotonic() - started
                self._condition.notify_all()

    def _published(
        self, state: PartialUpdates | None, splats: Splats, share: float, updates: OfferedUpdates
    ) -> PartialUpdates:
        """Encodes a new state of the scene, and offers it to clients, both as a complete stream and as an update.

        Args:
            state: Return value of the previous call; None for the first scene.
            splats: The scene.
            share: Maximum share of the Gaussians to send.
            updates: Updates that clients can request.

        Returns:
            State to pass to the next call.
        """
        if state is None:
            settings = self._settings
            after = PartialUpdates.start(splats, settings.antialiased, settings.origin, settings.background)
        else:
            after = state.pushed(splats, share)
        if state is None or after.chain is not state.chain:
            self._publish(self._prepared(after.chain.scene), updates.prepared(after.chain.offers()))
        return after

    def _prepared(self, stream: SceneStream) -> ServedStream:
        preview = stream_preview(stream.side_info, stream.manifest.schema_name)
        return make_served_stream(stream, self._settings.protection, preview=preview)

    def _publish(self, scene: ServedStream, updates: dict[str, ServedStream | None]) -> None:
        """Offers a new training state to clients; returns when clients can request the state.

        Args:
            scene: The state as a stream.
            updates: Updates that clients can request, by name; None for an update that does not exist yet.
        """
        done: Future[None] = Future()

        def publish() -> None:
            try:
                self._opened.running.publish({STREAM_NAME: scene}, updates)
            except BaseException as error:
                done.set_exception(error)
                raise
            done.set_result(None)

        self._opened.loop.call_soon_threadsafe(publish)
        done.result()

    def _serve(self, opened: "Future[_Opened]") -> None:
        try:
            asyncio.run(self._serve_until_stopped(opened))
        except BaseException as error:
            if opened.done():
                raise
            opened.set_exception(error)

    async def _serve_until_stopped(self, opened: "Future[_Opened]") -> None:
        async with contextlib.AsyncExitStack() as stack:
            running = await _open_server(self._settings, stack)
            stop = asyncio.Event()
            opened.set_result(_Opened(running, asyncio.get_running_loop(), stop))
            await stop.wait()


def _stop(opened: _Opened) -> None:
    """Stops a server, unless the server has already stopped."""
    with contextlib.suppress(RuntimeError):  # the loop is closed already
        opened.loop.call_soon_threadsafe(opened.stop.set)


def _stop_opened(opened: "Future[_Opened]") -> None:
    if opened.exception() is None:
        _stop(opened.result())


def _check_share(share: float | None) -> None:
    if share is not None and not 0 < share <= 1:
        raise InvalidValueError(f"share: expected a number above 0, at most 1, not {shown(share)}")


def _floats(value: Any, name: str, shape: tuple[int | str, ...]) -> np.ndarray:
    """Converts an array or a tensor to float32; also accepts bfloat16, which numpy lacks."""
    if hasattr(value, "detach"):
        value = value.detach().float()
    return array_of(value, name, shape)


async def _open_server(settings: _Settings, stack: contextlib.AsyncExitStack) -> RunningServer:
    if settings.page is None:
        server = UdpServer({}, settings.host, settings.port, limits=settings.limits)
        stack.callback(server.close)
        return RunningServer(server, {})
    from splatwire.transport.quic.certificate import RenewedIdentity  # aioquic is optional
    from splatwire.transport.quic.page import Page, open_quic_server

    running = await open_quic_server(
        {}, settings.host, settings.port, RenewedIdentity(("localhost", "127.0.0.1", "::1", settings.host)),
        settings.limits, stack, page=Page(settings.page),
    )  # fmt: skip
    assert running.page is not None
    assert isinstance(running.page.content, PageContent)
    running.page.content = replace(running.page.content, attributes={"updates": ""})
    return running


@checked
@contextmanager
def serve_training(
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    page: int | None = None,
    share: float = SHARE,
    antialiased: bool = False,
    origin: Origin = NO_ORIGIN,
    background: Background = BLACK,
    protection: Protection | None = None,
    limits: ServerLimits | None = None,
) -> Iterator[TrainingServer]:
    """Serves a scene while it is trained, by any trainer in Python; `TrainingServer.push` sends its Gaussians.

    The stream is called `scene`. Nothing can be received before the first `push`.

    Args:
        host: Address to listen on; the default accepts clients of this machine only.
        port: UDP port; 0 selects a free port.
        page: TCP port of the viewer page, 0 for a free one; the streams are then sent over QUIC (`splatwire[relay]`).
            None for plain UDP without a page.
        share: Maximum share of the Gaussians that each `push` after the first one sends, above 0, at most 1.
        antialiased: True if the trainer renders antialiased (Mip-Splatting).
        origin: World coordinates (x, y, z) that the pushed positions are relative to, within 1e12.
        background: Colour of the background, RGB, each 0 to 1.
        protection: Amount of redundancy; None for the default.
        limits: Limits on the transfers of clients; None for the defaults.

    Yields:
        The running server, which is closed at the end of the block.

    Raises:
        InvalidValueError: If a port cannot be bound, or a value is out of range.

    Example:
        >>> import splatwire
        >>> splats = splatwire.open_scene("scene.ply").splats
        >>> with splatwire.serve_training() as server:
        ...     for _ in range(3):
        ...         server.push(splats.means, splats.quats, splats.scales, splats.opacities, splats.sh)
        ...     server.drain()
    """
    _check_share(share)
    for name, number in (("port", port), ("page", page or 0)):
        if not 0 <= number < 1 << 16:
            raise InvalidValueError(f"{name}: expected a port from 0 to 65535, not {shown(number)}")
    settings = _Settings(
        host, port, page, share, antialiased, check_origin(origin), check_background(background),
        protection or Protection(), limits or ServerLimits(),
    )  # fmt: skip
    server = TrainingServer(settings)
    try:
        yield server
    finally:
        server.close()
