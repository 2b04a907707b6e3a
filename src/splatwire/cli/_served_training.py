"""Training that is served while it runs (`train --serve`): clients get the changes of the Gaussians."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from splatwire.api.training import STREAM_NAME, TrainingServer, serve_training
from splatwire.cli.train import Train
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.transport.address import check_port
from splatwire.types import SplatScene
from splatwire.types.background import Background
from splatwire.types.origin import Origin

PUSH_S = 1.0
"""Minimum interval between two states that are sent, seconds."""
ENCODING_SHARE = 0.25
"""Maximum share of the time in which states are encoded, because the encoder takes processor time from the training."""
DRAIN_S = 60.0
"""Maximum time that clients have to receive the last state, seconds."""


class ServedTraining:
    """Sends the scene to the clients of a server during training.

    Errors of the server do not end the training; they are printed as warnings.

    Args:
        server: The server; None to send nothing.
    """

    # Errors are reported without ending the training.

    def __init__(self, server: TrainingServer | None) -> None:
        self._server = server
        self._next = 0.0
        self._error = ""

    def iterated(self, scene: Callable[[], SplatScene]) -> None:
        """Sends the scene after a training iteration, but at most once in a few seconds.

        Args:
            scene: Function that returns the scene; only called if the scene is sent.
        """
        if self._server is None or (now := time.monotonic()) < self._next:
            return
        self._next = now + max(PUSH_S, self._server.encoding_seconds / ENCODING_SHARE)
        with self._reported():
            self._server.push(**vars(scene().splats))

    def finish(self, scene: SplatScene) -> None:
        """Sends all changes of the trained scene, and waits until clients have received the changes.

        Args:
            scene: The trained scene.
        """
        if self._server is None:
            return
        with self._reported():  # an earlier state may have failed
            self._server.drain(DRAIN_S)
        with self._reported():
            self._server.push(**vars(scene.splats), share=1.0)
            self._server.drain(DRAIN_S)

    @contextmanager
    def _reported(self) -> Iterator[None]:
        """Context manager that prints an error as a warning instead of raising the error."""
        # A warning that repeats itself is printed once. Hours of training must not be lost to an unexpected error, such
        # as a lack of memory in the encoder, which `push` raises, too.
        try:
            yield
        except Exception as error:
            text = str(error) if isinstance(error, SplatwireError) else repr(error)
            if text != self._error:
                self._error = text
                print(f"splatwire: warning: the scene is not served: {text}", file=sys.stderr, flush=True)


def check_serving(command: Train) -> None:
    """Checks the options of a served training.

    Raises:
        InvalidValueError: If a port is out of range, or an option needs `--serve`.
    """
    if command.serve is None and (command.page is not None or command.host != Train.host):
        raise InvalidValueError("--page and --host are for --serve")
    check_port(command.serve or 0)
    check_port(command.page or 0)


@contextmanager
def served_training(command: Train, origin: Origin, background: Background) -> Iterator[ServedTraining]:
    """Opens the server of a training, if requested, and prints how to watch.

    Args:
        command: Options of `splatwire train`.
        origin: World coordinates that the trained positions are relative to.
        background: Colour of the background.

    Raises:
        InvalidValueError: If a port cannot be bound.
    """
    if command.serve is None:
        yield ServedTraining(None)
        return
    with serve_training(
        host=command.host, port=command.serve, page=command.page, origin=origin, background=background
    ) as server:
        if "page" in server.facts:
            print(f"watch it: {server.facts['page']}", file=sys.stderr, flush=True)
        else:
            url = f"udp://{_connectable(command.host)}:{server.port}/{STREAM_NAME}"
            print(f"watch it: splatwire view {url}", file=sys.stderr, flush=True)
        yield ServedTraining(server)


def _connectable(host: str) -> str:
    """Returns the host for a URL with which clients on this machine can connect to a server.

    The address for all interfaces becomes the loopback address. IPv6 addresses are put in brackets.

    Args:
        host: Address on which the server listens.
    """
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host)
    return f"[{host}]" if ":" in host else host
