"""Publisher of streams to a relay of Media over QUIC (MoQ), with one track per tile of a scene."""

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, NamedTuple

from splatwire.bitstream import Manifest, SceneStream, send_sequence
from splatwire.bitstream.container import file_record
from splatwire.bitstream.tiles import Tiles, read_tiles
from splatwire.errors import BackendUnavailableError, InvalidValueError
from splatwire.transport.address import Address
from splatwire.transport.protocol.layout import init_segment

INSTALL = "pip install 'splatwire[moq]'"
INIT_TRACK = "head"
"""Name of the track with manifest and side information. The tracks `part/N` have the packets: one tile each for streams
with levels of detail, else `PACKETS_PER_TRACK` packets each, in sending order.
"""
PACKETS_PER_TRACK = 64
FRAME_BYTES = 1 << 16
"""Maximum size in bytes of a frame of the track with manifest and side information."""
MAX_CACHE_AGE_US = 3600 * 1_000_000
"""Age up to which relays still forward the content of a track, microseconds."""
INIT_TRACK_PRIORITY = 255
"""Priority of the track with manifest and side information; the tracks of packets have lower priorities, descending."""
CONNECT_TIMEOUT_S = 10.0
MIN_PAUSE_S, MAX_PAUSE_S = 1.0, 15.0
"""Minimum and maximum pause before a publisher opens a new session after an interruption, seconds. The pause doubles
until a session has lasted `STABLE_S`.
"""
STABLE_S = 10.0
"""Duration of a session after which an interruption counts as ended, seconds. Each reason of an interruption gives one
warning.
"""
MAX_REASONS = 4
"""Maximum number of warnings for one interruption."""
NO_SUCH_TRACK = 404


class Published(NamedTuple):
    """Result of publishing a stream to a relay.

    Attributes:
        tracks: Number of MoQ tracks that the relay subscribed to. A MoQ track is a named sequence of data blocks.
        num_bytes: Size of the content of these tracks, bytes.
    """

    tracks: int
    num_bytes: int


class RelayTrust(NamedTuple):
    """Rules for accepting the TLS certificate of a relay.

    Attributes:
        authority: PEM file with certificates of the accepted CAs; None for the CAs that the operating system trusts.
        fingerprint: SHA-256 of the only accepted certificate, hexadecimal; None for no such restriction.
        insecure: True to accept any certificate, with no protection against an attacker on the path.
    """

    authority: Path | None = None
    fingerprint: str | None = None
    insecure: bool = False


def need_moq() -> Any:
    """Imports and returns the package `moq`.

    Raises:
        BackendUnavailableError: If the package `moq` is not installed.
    """
    try:
        import moq
    except ImportError as error:
        raise BackendUnavailableError("moq", INSTALL) from error
    return moq


@contextlib.asynccontextmanager
async def session(address: Address, trust: RelayTrust, *, origin: Any = None) -> AsyncIterator[Any]:
    """Context manager that opens a session with a relay; yields the MoQ client and the scene's name at the relay.

    Args:
        address: Address of the relay, and the scene's name.
        trust: Accepted certificates of the relay.
        origin: Broadcasts to publish (`moq.OriginProducer`); None to publish nothing.

    Raises:
        InvalidValueError: If no session can be opened.
    """
    moq = need_moq()
    client = moq.Client(
        f"https://{address.authority}/{address.namespace}", tls_verify=not trust.insecure, websocket_enabled=False,
        tls_fingerprints=[trust.fingerprint] if trust.fingerprint else None, reconnect=False,
        tls_roots=[str(trust.authority)] if trust.authority else None, publish=origin,
    )  # fmt: skip
    try:
        async with asyncio.timeout(CONNECT_TIMEOUT_S):
            await client.__aenter__()
    except (moq.Error, TimeoutError) as error:
        raise InvalidValueError(
            f"no session with the relay {address.authority}: {error_text(error) or 'no answer'}"
        ) from error
    try:
        yield client, address.name
    finally:
        await client.__aexit__(None, None, None)


def error_text(error: Exception) -> str:
    """Returns the reason in an error of moq-rs; empty if the error has none, such as after an orderly end."""
    protocol = need_moq().protocol_error(error)
    if protocol is not None:  # the peer ended the session or the track; the text of the error lacks its message
        return protocol.message if protocol.code else ""
    text = str(error)
    return text[1:-1] if text.startswith("'") and text.endswith("'") else text  # moq-rs puts quotes around it


def packets_of_tracks(manifest: Manifest, tiles: Tiles | None) -> list[range]:
    """Divides the packets of a stream among MoQ tracks.

    Args:
        manifest: Manifest of the stream.
        tiles: Tiles of the stream, one for each track. None for a stream without levels of detail: each track then gets
            up to `PACKETS_PER_TRACK` consecutive packets.

    Returns:
        For each track, the indices of its packets in sending order.
    """
    total = manifest.num_packets
    edges = [*range(0, total, PACKETS_PER_TRACK), total] if tiles is None else tiles.first_packets.tolist()
    return [range(first, end) for first, end in itertools.pairwise(edges)]


def tiles_of(manifest: Manifest, side_info: bytes) -> Tiles | None:
    """Returns the tiles (spatial blocks of Gaussians) of a stream; None for a stream without levels of detail."""
    return read_tiles(manifest, side_info) if manifest.schema.tiled else None


async def publish(
    address: Address, stream: SceneStream, trust: RelayTrust, stop: asyncio.Event, ready: Callable[[], Any],
    warn: Callable[[str], Any],
) -> Published:  # fmt: skip
    """Publishes a stream at a relay until the event `stop` is set.

    After an interruption of the session with the relay, a new session is opened.

    Args:
        address: Address of the relay, and the scene's name.
        stream: Complete stream to publish.
        trust: Accepted certificates of the relay.
        stop: Event that ends publishing.
        ready: Called when the scene has been announced at the relay.
        warn: Called with the text of a warning, once for each reason of an interruption.

    Raises:
        InvalidValueError: If the first session cannot be opened.
    """
    # Objects on reliable streams: relays do not cache datagrams for clients that connect later.
    moq = need_moq()
    packets = [packet.data for packet in send_sequence(stream, "tiers")]
    track_packets = packets_of_tracks(stream.manifest, tiles_of(stream.manifest, stream.side_info))
    init_bytes = init_segment(stream.manifest, stream.side_info)
    published: dict[str, Any] = {}
    num_bytes = 0
    origin = moq.OriginProducer()
    broadcast = origin.create_broadcast(address.name)
    requests = broadcast.dynamic()

    async def answer() -> None:
        nonlocal num_bytes
        async for request in _track_requests(requests):
            name = request.name
            frames = _frames_of(name, init_bytes, track_packets, packets)
            if frames is None:
                request.abort(NO_SUCH_TRACK)
                continue
            track = request.accept(moq.TrackInfo(max_age_us=MAX_CACHE_AGE_US))
            group = track.append_group()
            for frame in frames:
                group.write_frame(frame)
            group.finish()
            num_bytes += sum(map(len, frames))
            published[name] = track  # a track ends when its last reference is dropped

    broadcast.announce()
    connection = _keep_session(address, trust, origin, ready, warn)
    tasks = [asyncio.ensure_future(work) for work in (answer(), connection, stop.wait())]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        results = await asyncio.gather(*tasks, return_exceptions=True)
    for result in results:
        if isinstance(result, Exception):
            raise result
    return Published(len(published), num_bytes)


async def _keep_session(
    address: Address, trust: RelayTrust, origin: Any, ready: Callable[[], Any], warn: Callable[[str], Any]
) -> None:
    """Keeps a session with a relay open until it is cancelled: opens a new session whenever one has ended.

    Args:
        address: Address of the relay.
        trust: Accepted certificates of the relay.
        origin: Broadcasts to publish.
        ready: Called when the first session is open.
        warn: Called with the text of a warning, once for each reason of an interruption.

    Raises:
        InvalidValueError: If the first session cannot be opened.
    """
    # Not left to the client of moq-rs: it stops reconnecting after ten seconds, and hides the reason of a failure.
    moq, loop = need_moq(), asyncio.get_running_loop()
    ready_called, warned = False, set[str]()
    pause = MIN_PAUSE_S
    while True:
        opened_at, reason = None, "it was closed"
        try:
            async with session(address, trust, origin=origin) as (client, _):
                opened_at = loop.time()
                if not ready_called:
                    ready_called = True
                    ready()
                await client.session.closed()
        except moq.Error as error:
            reason = error_text(error) or reason
        except InvalidValueError as error:
            if not ready_called:
                raise
            reason = str(error)
        if opened_at is not None and loop.time() - opened_at >= STABLE_S:
            pause = MIN_PAUSE_S
            warned.clear()
        if reason not in warned and len(warned) < MAX_REASONS:
            warned.add(reason)
            what = reason if opened_at is None else f"the session with the relay ended ({reason})"
            warn(f"{what}; connecting again")
        await asyncio.sleep(pause)
        pause = min(2 * pause, MAX_PAUSE_S)


async def _track_requests(requests: Any) -> AsyncIterator[Any]:
    while True:
        yield await requests.requested_track()


def _frames_of(name: str, init_bytes: bytes, track_packets: list[range], packets: list[bytes]) -> list[bytes] | None:
    """Returns the data blocks (MoQ frames) of a MoQ track, or None for an unknown track name.

    Args:
        name: Name of the MoQ track.
        init_bytes: Bytes of manifest and side information (data that all packets need).
        track_packets: For each MoQ track that has packets, the indices of these packets in sending order.
        packets: All packets in sending order.
    """
    if name == INIT_TRACK:
        return [init_bytes[at : at + FRAME_BYTES] for at in range(0, len(init_bytes), FRAME_BYTES)]
    kind, _, number = name.partition("/")
    if (
        kind != "part"
        or not (number.isascii() and number.isdecimal())
        or len(number) > 9
        or int(number) >= len(track_packets)
    ):
        return None
    return [b"".join(file_record(packets[index]) for index in track_packets[int(number)])]
