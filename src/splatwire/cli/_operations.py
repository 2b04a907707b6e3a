"""Log output and HTTP monitoring of the servers that `splatwire serve` and `splatwire live` start."""

import contextlib
import logging
import sys

from splatwire.cli._options import Listening
from splatwire.errors import InvalidValueError
from splatwire.transport.event_log import JsonFormatter, TextFormatter, log_event
from splatwire.transport.http.server import PageServer
from splatwire.transport.running_server import RunningServer

_LOG = logging.getLogger("splatwire.transport")
_ASYNCIO = logging.getLogger("asyncio")


def start_log(listening: Listening, stack: contextlib.ExitStack | contextlib.AsyncExitStack) -> None:
    """Writes the log of the server to standard error until the exit stack is closed.

    Args:
        listening: Options of the server: level and format of the log.
        stack: Exit stack that removes the log handler.
    """
    handler, before = logging.StreamHandler(sys.stderr), _LOG.level
    handler.setFormatter(JsonFormatter() if listening.log_format == "json" else TextFormatter())
    _LOG.setLevel(listening.log_level.upper())
    stack.callback(_LOG.setLevel, before)
    for logger in (_LOG, _ASYNCIO):
        logger.addHandler(handler)
        stack.callback(logger.removeHandler, handler)


def log_error(text: str) -> None:
    """Logs an error of the server that belongs to no request."""
    log_event(_LOG, logging.ERROR, "server error", error=text)


def monitoring_address(text: str) -> tuple[str, int]:
    """Parses `PORT` or `HOST:PORT` into host and port; the default host is 127.0.0.1.

    Raises:
        InvalidValueError: If the text has another form, or the port is out of range.
    """
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and int(port) < 1 << 16) or "/" in host:
        raise InvalidValueError(f"--monitor takes PORT or HOST:PORT such as 9464 or 0.0.0.0:9464, not '{text}'")
    return host.strip("[]") or "127.0.0.1", int(port)


async def open_monitoring(
    running: RunningServer, listening: Listening, stack: contextlib.AsyncExitStack
) -> dict[str, str]:
    """Starts the HTTP server for monitoring, if requested.

    Args:
        running: Server to monitor.
        listening: Options of the server.
        stack: Exit stack that closes the HTTP server.

    Returns:
        Mapping with the address of the HTTP server as `monitor`; empty if not requested.
    """
    if listening.monitor is None:
        return {}
    from splatwire.transport.monitoring import MonitoringContent  # imports prometheus_client

    host, port = monitoring_address(listening.monitor)
    server = PageServer(MonitoringContent(running, host), port, logged=False)
    return {"monitor": (await stack.enter_async_context(server)).url}
