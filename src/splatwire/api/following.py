"""Receives a scene that changes: first the whole scene, then its updates."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import aclosing

from splatwire.bitstream import SceneStream
from splatwire.bitstream.limits import UPDATE
from splatwire.bitstream.sections import sections_of
from splatwire.codec.update.apply import apply_update
from splatwire.codec.update.section import SECTION, manifest_digest, read_update, update_name
from splatwire.errors import InvalidValueError, SplatwireError, UnknownHostError
from splatwire.transport.protocol.messages import REFUSALS
from splatwire.transport.protocol.receiver import MISSING_STREAM, Receiver
from splatwire.transport.udp import NO_ROUTE_ERRORS

Fetch = Callable[[str], Awaitable[Receiver]]
"""Function that receives the stream of a given name, and returns the finished receiver."""
Warn = Callable[[str], None]

RETRY_S = 1.0
"""Time after which a failed transfer is started again, or a scene is requested again, seconds."""
LAST_RETRY_S = 4.0
"""Maximum pause between attempts while there is no network, seconds; it doubles from `RETRY_S` on."""


class FollowingStoppedError(Exception):
    """Raised by `updates_after` if the transfer of an update was stopped on the side of the receiver."""


async def follow(fetch: Fetch, name: str, warn: Warn) -> AsyncGenerator[SceneStream, None]:
    """Yields a scene as soon as it is received, and a new version of the scene after each update.

    Only complete scenes are yielded. The generator ends if a transfer was stopped on the side of the receiver (the
    receiver that `fetch` returns has finished for the reason `stopped`).

    Args:
        fetch: Function that receives the stream with a given name, and returns the finished receiver.
        name: Name of the scene; an empty name requests the server's first scene.
        warn: Called with the text of each warning.

    Raises:
        InvalidValueError: If the first transfer of the scene is incomplete, or the server offers no updates of the
            scene.
        OSError: If the first transfer fails, or a later transfer fails although there is a network. Later transfers
            that fail without a network are repeated.
    """
    # If an update does not arrive or cannot be applied, it or the whole scene is requested again.
    scene: SceneStream | None = None
    without_updates, warn_once = "", _once(warn)
    while True:
        receiver = await (fetch(name) if scene is None else _fetch_repeatedly(fetch, name, warn_once))
        stream, reason = receiver.stream(), _reason(receiver)
        if reason == "stopped":
            return
        if stream is None or reason != "complete":
            if scene is None:
                raise InvalidValueError(f"the scene did not arrive as a whole: {reason}")
            warn_once(f"the scene did not arrive as a whole ({reason}); the last one remains")
            await asyncio.sleep(RETRY_S)
            continue
        digest = manifest_digest(stream.manifest)
        if digest == without_updates:
            raise InvalidValueError("the server offers no updates of the scene: `serve --updates` does")
        scene = stream
        warn_once("")
        yield scene
        try:
            without_updates = digest
            async with aclosing(updates_after(fetch, digest, warn)) as updates:
                async for update in updates:
                    scene, without_updates = await asyncio.to_thread(apply_update, scene, update), ""
                    yield scene
            await asyncio.sleep(RETRY_S)  # a server that has started again may not offer updates yet
            warn("an update was missed, and the server no longer has it; the whole scene is requested")
        except FollowingStoppedError:
            return
        except SplatwireError as error:
            without_updates = ""
            warn(f"an update cannot be applied: {error}; the whole scene is requested")
            await asyncio.sleep(RETRY_S)


async def updates_after(fetch: Fetch, digest: str, warn: Warn) -> AsyncGenerator[SceneStream, None]:
    """Yields each update of a scene as soon as it is received, until the server has no further update.

    While there is no network, transfers are repeated.

    Args:
        fetch: Function that receives the stream with a given name, and returns the finished receiver.
        digest: Digest of the scene's stream (`manifest_digest`), hexadecimal.
        warn: Called with the text of each warning.

    Raises:
        FollowingStoppedError: If the receiver that `fetch` returns has finished for the reason `stopped`.
        InvalidValueError: If the received stream is not an update of this scene.
        BitstreamError: If the description of the update is damaged.
        OSError: If a transfer fails although there is a network.
    """
    warn_once = _once(warn)
    while True:
        receiver = await _fetch_repeatedly(fetch, update_name(digest), warn_once)
        stream, reason = receiver.stream(), _reason(receiver)
        if reason == "stopped":
            raise FollowingStoppedError
        if reason == REFUSALS[MISSING_STREAM]:
            return
        if stream is None or reason != "complete":
            warn_once(f"an update did not arrive as a whole ({reason}); the last scene remains")
            await asyncio.sleep(RETRY_S)
            continue
        check_follows(stream, digest)
        warn_once("")
        yield stream
        digest = read_update(sections_of(stream)[SECTION]).result_digest


def _once(warn: Warn) -> Warn:
    """Wraps a warning function so that repetitions of a warning are suppressed.

    Args:
        warn: Function that is called with the text of each warning.

    Returns:
        Function that is called in place of `warn`. After a call with an empty text, earlier warnings may be repeated.
    """
    warned = set[str]()

    def new(text: str) -> None:
        if not text:
            warned.clear()
        elif text not in warned:
            warned.add(text)
            warn(text)

    return new


async def _fetch_repeatedly(fetch: Fetch, name: str, warn: Warn) -> Receiver:
    """Receives a stream; tries again as long as the host name cannot be resolved, or there is no route to the server.

    Args:
        fetch: Function that receives the stream with a given name.
        name: Name of the stream.
        warn: Called with a warning at the first failure.

    Raises:
        OSError: If the transfer fails for another reason.
    """
    pause, warned = RETRY_S, False
    while True:
        try:
            return await fetch(name)
        except (OSError, UnknownHostError) as error:
            if isinstance(error, OSError) and error.errno not in NO_ROUTE_ERRORS:
                raise
            if not warned:
                warn(f"no connection: {error}; the last scene remains until there is one")
            await asyncio.sleep(pause)
            pause, warned = min(2 * pause, LAST_RETRY_S), True


def check_follows(stream: SceneStream, digest: str) -> None:
    """Checks that a stream is an update of a given version of a scene.

    Args:
        stream: The stream.
        digest: Digest of the scene's stream, hexadecimal.

    Raises:
        InvalidValueError: If the stream is not an update, belongs to another scene, or changes nothing.
        BitstreamError: If the description of the update is damaged.
    """
    if stream.manifest.schema_name != UPDATE:
        raise InvalidValueError(f"the server sends {stream.manifest.elements} as update")
    fields = read_update(sections_of(stream).get(SECTION, b""))
    if fields.base_digest != digest:
        raise InvalidValueError("the server sends the update of another scene")
    if fields.result_digest == digest:  # would be requested again without end
        raise InvalidValueError("the server sends an update that changes nothing")


def _reason(receiver: Receiver) -> str:
    return "no reason" if receiver.finished is None else receiver.finished.reason
