"""Implementation of `splatwire view`: local web page that shows a stream, its losses and their concealment."""

import asyncio
import contextlib
import sys
import webbrowser
from collections.abc import Callable, Mapping
from dataclasses import replace

from splatwire.api.following import updates_after
from splatwire.bitstream import SceneStream, is_stream, read_stream, stream_to_bytes
from splatwire.bitstream.sections import sections_of
from splatwire.cli._bundled import ASSETS, CAMERAS, SCENE
from splatwire.cli._files import input_path, stream_name
from splatwire.cli._listening import stop_on_signals
from splatwire.cli._output import print_json, print_summary
from splatwire.cli._receiving import print_waiting, transfer_of
from splatwire.cli.view import View
from splatwire.codec.update.chain import MAX_UPDATES
from splatwire.codec.update.section import SECTION, manifest_digest, read_update, update_name
from splatwire.data import load_cameras
from splatwire.errors import BitstreamError, InvalidValueError, SplatwireError
from splatwire.files.kinds import format_error
from splatwire.transport import Event, Receiver, ReceiverOptions, ServedStream
from splatwire.transport.address import check_port, parse_url, without_token
from splatwire.transport.daemon_thread import start_thread
from splatwire.transport.http.content import PageContent
from splatwire.transport.http.server import PageServer
from splatwire.types import Cameras
from splatwire.view import Relay, page_of_relay, page_of_stream

MAX_BYTES = 2**28
"""Maximum size of the updates that the page may still request, bytes."""


def run(command: View) -> None:
    """Runs `splatwire view`: shows a stream in a browser until Ctrl-C."""
    check_port(command.port)
    if command.trust.given and "://" not in command.stream:
        raise InvalidValueError("--fingerprint, --authority and --insecure are for quic://")
    cameras = None if command.cameras is None else load_cameras(command.cameras)
    if not command.stream and cameras is None:
        cameras = load_cameras(ASSETS / CAMERAS)
    if "://" in command.stream:
        asyncio.run(_forward(command, cameras))
    else:
        name = stream_name(command.stream or SCENE)
        asyncio.run(_serve(command, page_of_stream(name, _read(command), cameras, command.host)))


def _read(command: View) -> SceneStream:
    with input_path(command.stream or str(ASSETS / SCENE)) as path:
        if not is_stream(path):
            raise BitstreamError(f"{format_error(path, 'a splatwire stream')}; `splatwire encode` makes one of a scene")
        return read_stream(path)[0].require_scene(path)


async def _forward(command: View, cameras: Cameras | None) -> None:
    """Receives a stream from a remote server and shows the scene on the viewer page during the transfer."""
    name, url = parse_url(command.stream).name or "scene", without_token(command.stream)
    relay = _create_relay(command)
    receiving = asyncio.create_task(relay.run())
    try:
        await (relay.begun() if cameras is None else relay.headed())
        if receiving.done():
            await receiving  # raises its exception
        if relay.was_live:
            print(f"splatwire: {url} is live: the page shows what there is when it is loaded", file=sys.stderr)
        receiving.add_done_callback(lambda task: _warn_of_missing(url, relay) if _went_well(task) else None)
        await _serve(command, page_of_relay(name, relay, cameras, command.host), receiving, relay)
    finally:
        receiving.cancel()
        await asyncio.gather(receiving, return_exceptions=True)


async def _serve(
    command: View, content: PageContent, receiving: asyncio.Task[None] | None = None, relay: Relay | None = None
) -> None:
    """Serves the viewer page until the process is signalled to stop, or until receiving fails.

    Args:
        command: Options of `splatwire view`.
        content: Content of the page.
        receiving: Task that receives the stream from a server; None for a stream of this machine.
        relay: Object that receives the stream; None for a stream of this machine.
    """
    async with contextlib.AsyncExitStack() as stack:
        stop = stack.enter_context(stop_on_signals())
        if receiving is not None:
            receiving.add_done_callback(lambda task: None if _went_well(task) else stop.set())
        page = await stack.enter_async_context(PageServer(content, command.port))
        if command.json:
            print_json({"url": page.url})
        else:
            print_summary(f"{page.url} (Ctrl-C ends it)")
            if command.open:
                start_thread(
                    lambda: webbrowser.open(page.url), "browser"
                )  # a terminal browser blocks until it is closed
        following = asyncio.ensure_future(_follow(command, relay, receiving, page)) if relay and receiving else None
        await stop.wait()
        if following is not None:
            following.cancel()
    if receiving is not None and receiving.done():
        receiving.result()


async def _follow(command: View, relay: Relay, receiving: asyncio.Task[None], page: PageServer) -> None:
    """Receives updates of a scene and offers them to the viewer page.

    Waits first until the scene itself has been received; does nothing if that transfer fails.

    Args:
        command: Options of `splatwire view`.
        relay: Object that receives the scene.
        receiving: Task that receives the scene.
        page: Server of the page.
    """
    await asyncio.wait({receiving})
    if relay.manifest is None or relay.failure() or not _went_well(receiving):
        return
    address, url = parse_url(command.stream), without_token(command.stream)
    transfer = transfer_of(command.trust, address)

    async def fetch(name: str) -> Receiver:
        return await transfer(ReceiverOptions(name=name, scene_token=address.token), None)

    def warn(text: str) -> None:
        print(f"splatwire: warning: {url}: {text}", file=sys.stderr, flush=True)

    served = False
    try:
        async for update in updates_after(fetch, manifest_digest(relay.manifest), warn):
            assert isinstance(page.content, PageContent)
            base = read_update(sections_of(update)[SECTION]).base_digest
            updates = newest_updates(page.content.updates, update_name(base), stream_to_bytes(update))
            page.content, served = replace(page.content, updates=updates), True
        if served:
            warn("an update was missed, and the server no longer has it; start `view` again")
    except (SplatwireError, OSError) as error:
        warn(f"updates have ended: {error}")


def newest_updates(updates: Mapping[str, ServedStream | bytes], name: str, update: bytes) -> dict[str, bytes]:
    """Returns the updates that the viewer page may request, including a new one.

    The oldest updates are dropped beyond `MAX_UPDATES` updates or `MAX_BYTES` bytes.

    Args:
        updates: Files of earlier updates by name, the oldest first.
        name: Name of the new update.
        update: File of the new update.
    """
    kept, size = {name: update}, len(update)
    for key, data in reversed(list(updates.items())):
        assert isinstance(data, bytes)
        size += len(data) if key != name else 0
        if len(kept) == MAX_UPDATES or size > MAX_BYTES:
            break
        kept.setdefault(key, data)
    return dict(reversed(kept.items()))


def _create_relay(command: View) -> Relay:
    """Creates the relay that receives the stream from the command's URL and forwards the stream to the page."""
    address = parse_url(command.stream)
    transfer = transfer_of(command.trust, address)
    options = ReceiverOptions(name=address.name, scene_token=address.token)

    async def receive(on_event: Callable[[Event], None]) -> Receiver:
        def report(event: Event) -> None:
            print_waiting(event)
            on_event(event)

        return await transfer(options, report)

    return Relay(without_token(command.stream), receive)


def _warn_of_missing(url: str, relay: Relay) -> None:
    """Prints a warning if the transfer ended before the full stream was received.

    Args:
        url: Address of the stream, for the message.
        relay: Object that received the stream and forwarded it to the page.
    """
    if reason := relay.failure():
        print(
            f"splatwire: warning: {url}: the stream is incomplete ({reason}); the page shows what arrived",
            file=sys.stderr,
        )


def _went_well(task: asyncio.Task[None]) -> bool:
    return not task.cancelled() and task.exception() is None
