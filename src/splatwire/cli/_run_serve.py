"""Implementation of `splatwire serve`: sends streams to clients that request them."""

import asyncio
import contextlib
import logging
import sys
import tempfile
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from splatwire.bitstream import SceneStream, read_stream
from splatwire.cli import _bundled
from splatwire.cli._datagrams import in_datagrams
from splatwire.cli._downloads import MadeDownloads, check_formats
from splatwire.cli._files import stream_name
from splatwire.cli._listening import (
    check_listening,
    first_event,
    open_server,
    print_ready,
    reload_on_hangup,
    stop_on_signals,
)
from splatwire.cli._protection import plan_of_file, protection_of
from splatwire.cli._publishing import publish_stream
from splatwire.cli._terminal import one_line
from splatwire.cli.serve import Serve
from splatwire.errors import InvalidValueError, SplatwireError
from splatwire.transport import Protection, ServedStream, ServerLimits, make_served_stream
from splatwire.transport.access import Access
from splatwire.transport.daemon_thread import start_thread
from splatwire.transport.event_log import log_event
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.origins import parse_origin
from splatwire.transport.protocol.messages import MAX_NAME
from splatwire.transport.protocol.preview import stream_preview
from splatwire.transport.running_server import RunningServer

if TYPE_CHECKING:
    from splatwire.cli._served_updates import UpdateFolder

LOG = logging.getLogger("splatwire.transport.serve")
UPDATE_POLL_S = 0.2
"""Interval between two checks of the folder of updates, seconds."""


def run(command: Serve) -> None:
    """Runs `splatwire serve`: serves streams to clients until it is stopped."""
    check_listening(command)
    if not command.over_quic and command.origins:
        raise InvalidValueError("--certificate, --key and --origins are for --quic")
    allowed_origins(command)
    check_formats(command.downloads)
    if command.updates is not None and (command.moq is not None or command.private):
        raise InvalidValueError("--updates is for public scenes without --moq")
    if command.updates is not None and not command.updates.is_dir():
        raise InvalidValueError(f"--updates is a folder, {command.updates} is none")
    if command.downloads and command.page is None:
        raise InvalidValueError("--downloads is for --page")
    access = _access(command)
    if command.moq is not None:
        if command.over_quic or command.plan or command.protect or len(command.streams) > 1:
            raise InvalidValueError("--moq publishes one stream, which the relay sends: no --page, --quic, --plan")
        path = Path((command.streams or (str(_bundled.ASSETS / _bundled.SPLATS),))[0])
        asyncio.run(publish_stream(command.moq, path, command.trust, json=command.json))
        return
    if command.trust.given:
        raise InvalidValueError("--fingerprint, --authority and --insecure are for --moq")
    (protected, planned), _ = protection(command), limits(command)  # reports invalid options before streams are read
    asyncio.run(_serve(command, _served_streams(command, protected, planned), access))


@dataclass
class _Scenes:
    """Streams that a server offers, with their names and updates.

    Attributes:
        served: Streams prepared for sending, by name.
        folder: Updates of these streams; None without `--updates`.
    """

    served: dict[str, ServedStream]
    folder: "UpdateFolder | None"

    @property
    def updates(self) -> dict[str, ServedStream | None]:
        """Prepared streams of scene updates, by the name under which receivers request an update.

        The value is None for an update that does not exist yet.
        """
        return {} if self.folder is None else self.folder.updates


def _served_streams(command: Serve, protection: Protection, planned: int | None = None) -> _Scenes:
    """Reads the streams to serve, and prepares each stream for sending.

    Args:
        command: Options of `splatwire serve`.
        protection: Redundancy against packet loss to add to each stream, such as parity.
        planned: Id of the stream for which the redundancy was planned; None without a plan.

    Raises:
        InvalidValueError: If two streams have one name, the plan is for another stream, or `--updates` is set and no
            stream can be updated.
    """
    named: dict[str, str] = {}
    for path in command.streams or (str(_bundled.ASSETS / _bundled.SPLATS),):
        other = named.setdefault(stream_name(path), path)
        if other != path:
            raise InvalidValueError(
                f"{other} and {path} are both called '{stream_name(path)}', by which clients ask: rename one"
            )
    for name, path in named.items():
        if not name.isprintable() or len(name.encode()) > MAX_NAME:
            print(
                f"splatwire: warning: {one_line(path)}: clients cannot ask for '{one_line(name)}' over UDP and QUIC, "
                f"where a name has at most {MAX_NAME} bytes, all printable: rename it",
                file=sys.stderr,
            )
    sources = {name: (path, read_stream(Path(path))[0].require_scene(path)) for name, path in named.items()}
    streams = {name: (path, in_datagrams(source, path)) for name, (path, source) in sources.items()}
    for path, stream in streams.values():
        if planned is not None and stream.manifest.stream_id != planned:
            raise InvalidValueError(
                f"{command.plan} is for the stream {planned:08x}, and {path} is "
                f"{stream.manifest.stream_id:08x}: plan for it"
            )
    served = {name: prepare_served_stream(stream, protection) for name, (_, stream) in streams.items()}
    if command.updates is None:
        return _Scenes(served, None)
    updates = import_module("splatwire.cli._served_updates")  # decodes, with libraries that a relay lacks
    chains = updates.chains_of({name: (source, streams[name][1]) for name, (_, source) in sources.items()})
    folder = updates.UpdateFolder(command.updates, chains, lambda stream: prepare_served_stream(stream, protection))
    return _Scenes(served | folder.poll(), folder)  # also after SIGHUP, so that no client gets an earlier version


def protection(command: Serve) -> tuple[Protection, int | None]:
    """Returns the redundancy against packet loss that the options of `splatwire serve` set.

    The options give a plan file or explicit numbers.

    Args:
        command: Options of `splatwire serve`.

    Returns:
        The redundancy, and the id of the stream for which the plan file was computed (None without a plan file).

    Raises:
        InvalidValueError: If a number is out of range, the plan file is invalid, or both a plan and explicit
            redundancy are given.
    """
    if command.plan is None:
        init_repair = Protection().init_repair if command.init_repair is None else command.init_repair
        return protection_of(init_repair, command.protect), None
    if command.init_repair is not None or command.protect:
        raise InvalidValueError("--plan sets the protection: give either --plan, or --init-repair and --protect")
    return plan_of_file(command.plan)


def limits(command: Serve) -> ServerLimits:
    """Returns the limits of bandwidth and resources for clients.

    Raises:
        InvalidValueError: If the rate is not above 0, or another number is out of range.
    """
    if not 0.1 <= command.idle <= 3600:
        raise InvalidValueError(f"--idle is from 0.1 to 3600 seconds, {command.idle} is not")
    if not 0 <= command.drain <= 86_400:
        raise InvalidValueError(f"--drain is from 0 to 86400 seconds, {command.drain} is not")
    return ServerLimits(
        command.clients,
        command.clients_per_address,
        silence_s=command.idle,
        fixed_rate=command.fixed_rate,
        total_rate=command.total_bytes_s,
    )


def allowed_origins(command: Serve) -> tuple[str, ...]:
    """Returns the web origins of the option `origins` in the form that browsers send.

    Raises:
        InvalidValueError: If a value is not a web origin.
    """
    return tuple(map(parse_origin, command.origins))


def _access(command: Serve) -> Access | None:
    """Returns the rules for access to private and unlisted scenes, with the token check; None if all are public.

    Raises:
        InvalidValueError: If an option is missing, a name is not that of a served scene, or the key is invalid.
    """
    if not command.private and not command.unlisted:
        if command.token_key is not None:
            raise InvalidValueError("--token-key is for --private")
        return None
    if command.unlisted and command.page is None:
        raise InvalidValueError("--unlisted is for --page")
    if not command.over_quic:
        raise InvalidValueError("--private is for --quic and --page: over plain UDP everybody on the path reads tokens")
    names = {stream_name(path) for path in command.streams or (str(_bundled.ASSETS / _bundled.SPLATS),)}
    if unknown := sorted({*command.private, *command.unlisted} - names):
        raise InvalidValueError(f"no stream is called {', '.join(unknown)}; names are {', '.join(sorted(names))}")
    if bool(command.private) != (command.token_key is not None):
        raise InvalidValueError("--private and --token-key belong together")
    problem = None
    if command.token_key is not None:
        tokens = import_module("splatwire.transport.http.tokens")  # needs PyJWT, which other servers do without
        problem = partial(tokens.token_problem, tokens.read_key(command.token_key))
    return Access(frozenset(command.private), frozenset(command.unlisted), problem)


async def _serve(command: Serve, scenes: _Scenes, access: Access | None) -> None:
    streams = scenes.served
    async with contextlib.AsyncExitStack() as stack:
        stop, reload = stack.enter_context(stop_on_signals()), stack.enter_context(reload_on_hangup())
        running = await open_server(
            streams, command, limits(command), stack, origins=allowed_origins(command), access=access
        )
        await _offer_downloads(command, running, stack)
        sizes = {name: stream.sizes() for name, stream in streams.items()}
        for name, parts in () if command.json else sizes.items():
            print(f"{name}: {sum(parts.values()):,} bytes, of which protection "
                  f"{parts['init_protection'] + parts['packet_protection']:,}")  # fmt: skip
        if command.updates is not None:
            running.publish(streams, scenes.updates)
            if running.page is not None and isinstance(content := running.page.content, PageContent):
                running.page.content = replace(content, attributes={**content.attributes, "updates": ""})
            watching = asyncio.ensure_future(_watch_updates(scenes, running))
            stack.callback(watching.cancel)
        print_ready(command, running.server.port, running.facts, "serving", streams=sizes)
        while await first_event(stop, reload) is reload:
            reload.clear()
            await _reload(command, running, scenes)
        await running.drain(command.drain)
        log_event(
            LOG, logging.INFO, "stopped", transfers=running.server.core.num_served, bytes=running.server.bytes_sent
        )
    if command.log_format == "text":
        print(running.served(), file=sys.stderr)


async def _offer_downloads(command: Serve, running: RunningServer, stack: contextlib.AsyncExitStack) -> None:
    """Lets the page server offer streams for download in the formats of `--downloads`."""
    # Converted files are stored in a temporary folder until the server stops.
    if not command.downloads or running.page is None or not isinstance(running.page.content, PageContent):
        return
    folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="splatwire-"))
    downloads = MadeDownloads(Path(folder), command.downloads)
    stack.push_async_callback(downloads.close)
    running.page.content = replace(running.page.content, downloads=downloads)


async def _watch_updates(scenes: _Scenes, running: RunningServer) -> None:
    """Publishes changed scenes to clients whenever updates appear in the folder of `--updates`."""
    # An unexpected error is logged, once if it repeats itself, and the next updates are still served.
    last = ""
    while True:
        await asyncio.sleep(UPDATE_POLL_S)
        folder = scenes.folder
        assert folder is not None
        try:
            changed = await start_thread(folder.poll, "updates")
        except Exception as error:
            if repr(error) != last:
                last = repr(error)
                LOG.exception("updates failed")
            continue
        if changed and folder is scenes.folder:  # the streams were not read again meanwhile
            scenes.served = scenes.served | changed
            running.publish(scenes.served, scenes.updates)


async def _reload(command: Serve, running: RunningServer, scenes: _Scenes) -> None:
    """Replaces the streams and the certificate of a running server by the current content of their files."""
    # The previous ones remain, and an error is logged, if a file is invalid.

    def read() -> _Scenes:
        return _served_streams(command, *protection(command))

    try:
        reloaded = await start_thread(read, "reading")
        running.replace(reloaded.served, reloaded.updates)
        scenes.served, scenes.folder = reloaded.served, reloaded.folder
    except (SplatwireError, OSError) as error:
        log_event(LOG, logging.ERROR, "reload failed", error=str(error))
    else:
        log_event(LOG, logging.INFO, "reloaded", streams=len(scenes.served))


def prepare_served_stream(stream: SceneStream, protection: Protection) -> ServedStream:
    """Prepares a stream for sending by a server.

    Adds redundancy against losses. A preview in the side information will be sent first.

    Args:
        stream: Complete stream.
        protection: Redundancy against packet loss, such as parity.

    Raises:
        InvalidValueError: If the stream is incomplete, or its packets do not fit into datagrams.
    """
    importance = None
    if any(share < 1 for share, _ in protection.motion):  # the importance of motion is needed only then
        from splatwire.sequence.importance import stream_importance  # decodes, with libraries that a relay lacks

        importance = stream_importance(stream)
    preview = stream_preview(stream.side_info, stream.manifest.schema_name)
    return make_served_stream(stream, protection, preview=preview, importance=importance)
