"""Who may connect to the viewer: its own page, and no other page that the same browser has open.

A browser lets every page open web sockets to this machine, and says in `Origin` which page it is. A page can also have
its own name point to this machine once it is loaded (DNS rebinding); then `Host` tells that name.
"""

import ipaddress
import logging
import socket
import threading
from collections.abc import Callable, Mapping
from http import HTTPStatus
from typing import Any

from splatwire.errors import BackendUnavailableError

_starting = threading.Lock()


def refusal(headers: Mapping[str, str], host: str) -> str | None:
    """Says why a request gets no answer.

    Args:
        headers: Its headers, found by name whatever their case.
        host: The address that the viewer was told to listen on.

    Returns:
        The reason, or None for the viewer's own page and for who opens it.
    """
    asked, origin = headers.get("Host", ""), headers.get("Origin")
    if not _is_ours(_hostname(asked), host):
        return f"{asked[:80]!r} is no address of this viewer; open it by its IP address, or start it with --host NAME"
    if (origin is not None or "Upgrade" in headers) and origin != f"http://{asked}":
        return "only the viewer's own page may connect"
    return None


def _hostname(asked: str) -> str:
    """The host of `HOST[:PORT]`; an IPv6 address is in brackets."""
    return asked[1:].partition("]")[0] if asked.startswith("[") else asked.partition(":")[0]


def _is_ours(name: str, host: str) -> bool:
    """Whether a name cannot be one that somebody else had point here; an IP address is nobody's name."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name.lower() in ("localhost", host.lower(), socket.gethostname().lower())
    return True


def start_guarded(start: Callable[[], Any], host: str) -> Any:
    """Starts a viser server that answers its own page only.

    viser has no option for it, so the function of `websockets` that it calls is replaced while it starts.

    Args:
        start: Starts the server and gives it back.
        host: The address that it listens on.

    Raises:
        BackendUnavailableError: If this release of viser starts in another way: rather none than an open one.
    """
    from websockets.asyncio import server as websockets_server

    serve, guarded = websockets_server.serve, 0

    def serve_guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        nonlocal guarded
        guarded += 1

        def check(connection: Any, request: Any) -> Any:
            reason = refusal(request.headers, host)
            if reason is None:
                return process_request(connection, request)
            return connection.respond(HTTPStatus.FORBIDDEN, f"{reason}\n")

        return serve(*arguments, process_request=check, logger=_logger(), **options)

    with _starting:
        websockets_server.serve = serve_guarded  # type: ignore[misc, assignment]
        try:
            server = start()
        finally:
            websockets_server.serve = serve  # type: ignore[misc]
    if not guarded:
        server.stop()
        raise BackendUnavailableError("viser", "this release of it lets every page connect; install viser 1.1")
    # A page may ask viser for a tunnel that makes it public; nobody gets one.
    server.request_share_url = lambda *_: None
    return server


def _logger() -> logging.Logger:
    """Says nothing of who connects and speaks no HTTP; everything else as ever."""
    logger = logging.getLogger("splatwire.view.guard")
    logger.addFilter(_speaks)
    return logger


def _speaks(record: logging.LogRecord) -> bool:
    return record.getMessage() != "opening handshake failed"
