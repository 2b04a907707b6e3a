"""Publishing to a relay of Media over QUIC, and receiving from one: every tile is a track, which relays pass on.

A relay asks the publisher for a track once, as long as anybody wants it. What a scene that stands still consists of
are objects, not datagrams: of those a relay keeps none, and who comes later would never hear of them.
"""

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, NamedTuple

from splatwire.errors import BackendUnavailableError, InvalidValueError
from splatwire.packets import Manifest, SceneStream, send_sequence
from splatwire.packets.container import file_record
from splatwire.packets.tiles import Tiles, read_tiles
from splatwire.transport.address import Address
from splatwire.transport.layout import head_object

INSTALL = "pip install 'splatwire[moq]'"
HEAD = "head"
"""The track of manifest and side information; `part/N` is that of a tile, or of `RUN` packets, as in a file."""
RUN = 64
FRAME_BYTES = 1 << 16
"""Of the head, in a frame."""
KEPT_US = 3600 * 1_000_000
"""How old a track may be that is still passed on."""
FOREMOST = 255
"""Priority of the head; parts have less, the later they are wanted."""
CONNECT_S = 10.0
NO_SUCH_TRACK = 404


class Published(NamedTuple):
    """What a relay asked for.

    Attributes:
        tracks: Tracks.
        num_bytes: Bytes that were sent to it, those of QUIC included.
    """

    tracks: int
    num_bytes: int


class RelayTrust(NamedTuple):
    """Which relays are believed; by default those with a certificate that the system knows."""

    authority: Path | None = None
    fingerprint: str | None = None
    insecure: bool = False


def need_moq() -> Any:
    """The package `moq`.

    Raises:
        BackendUnavailableError: If it is not installed.
    """
    try:
        import moq
    except ImportError as error:
        raise BackendUnavailableError("moq", INSTALL) from error
    return moq


@contextlib.asynccontextmanager
async def session(address: Address, trust: RelayTrust, **origins: Any) -> AsyncIterator[Any]:
    """A session with a relay, and the name of the scene there.

    Raises:
        InvalidValueError: If no session comes about.
    """
    moq = need_moq()
    place, _, name = address.name.rpartition("/")
    host = f"[{address.host}]" if ":" in address.host else address.host
    client = moq.Client(
        f"https://{host}:{address.port}/{place}", tls_verify=not trust.insecure, websocket_enabled=False,
        tls_fingerprints=[trust.fingerprint] if trust.fingerprint else None, reconnect=bool(origins),
        tls_roots=[str(trust.authority)] if trust.authority else None, **origins,
    )  # fmt: skip
    try:
        async with asyncio.timeout(CONNECT_S):
            await client.__aenter__()
    except (moq.Error, TimeoutError) as error:
        raise InvalidValueError(f"no session with the relay {host}:{address.port}: {error or 'no answer'}") from error
    try:
        yield client, name
    finally:
        await client.__aexit__(None, None, None)


def parts_of(manifest: Manifest, tiles: Tiles | None) -> list[range]:
    """Places in the sending order of the packets of each part: of a tile, or `RUN` of them."""
    total = manifest.num_packets
    edges = [*range(0, total, RUN), total] if tiles is None else tiles.first_packets.tolist()
    return [range(first, end) for first, end in itertools.pairwise(edges)]


def tiles_of(manifest: Manifest, side_info: bytes) -> Tiles | None:
    """The tiles of a stream with levels; None of any other."""
    return read_tiles(manifest, side_info) if manifest.schema.tiled else None


async def publish(
    address: Address, stream: SceneStream, trust: RelayTrust, stop: asyncio.Event, ready: Callable[[], Any]
) -> Published:
    """Publishes a stream until it is told to stop.

    Args:
        address: The relay, and the name of the scene there.
        stream: The complete stream.
        trust: Which certificates are believed.
        stop: Ends it.
        ready: Called when the relay has been told.

    Raises:
        InvalidValueError: If no session comes about.
    """
    moq = need_moq()
    packets = [packet.data for packet in send_sequence(stream, "tiers")]
    parts = parts_of(stream.manifest, tiles_of(stream.manifest, stream.side_info))
    head = head_object(stream.manifest, stream.side_info)
    published: dict[str, Any] = {}
    origin = moq.OriginProducer()
    async with session(address, trust, publish=origin) as (client, scene):
        broadcast = origin.create_broadcast(scene)
        asked = broadcast.dynamic()

        async def answer() -> None:
            async for request in _requests(asked):
                name = request.name
                frames = _frames_of(name, head, parts, packets)
                if frames is None:
                    request.abort(NO_SUCH_TRACK)
                    continue
                track = request.accept(moq.TrackInfo(max_age_us=KEPT_US))
                group = track.append_group()
                for frame in frames:
                    group.write_frame(frame)
                group.finish()
                published[name] = track  # it ends when nobody holds it

        broadcast.announce()
        ready()
        work, stopped = asyncio.ensure_future(answer()), asyncio.ensure_future(stop.wait())
        await asyncio.wait((work, stopped), return_when=asyncio.FIRST_COMPLETED)
        for task in (work, stopped):
            task.cancel()
        if work.done() and not work.cancelled():
            work.result()
        return Published(len(published), client.session.stats().bytes_sent or 0)


async def _requests(asked: Any) -> AsyncIterator[Any]:
    while True:
        yield await asked.requested_track()


def _frames_of(name: str, head: bytes, parts: list[range], packets: list[bytes]) -> list[bytes] | None:
    """What a track holds; None if there is no such track."""
    if name == HEAD:
        return [head[at : at + FRAME_BYTES] for at in range(0, len(head), FRAME_BYTES)]
    kind, _, number = name.partition("/")
    if kind != "part" or not (number.isascii() and number.isdecimal()) or len(number) > 9 or int(number) >= len(parts):
        return None
    return [b"".join(file_record(packets[place]) for place in parts[int(number)])]
