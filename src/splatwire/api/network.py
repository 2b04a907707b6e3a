"""Serving streams and receiving one, in asyncio."""

from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any

from splatwire.arguments import checked
from splatwire.bitstream import SceneStream
from splatwire.errors import InvalidValueError
from splatwire.transport import Event, Protection, ReceiverOptions, ServerLimits, make_served_stream
from splatwire.transport.address import parse_url, without_token
from splatwire.transport.udp import UdpServer, receive_udp


@checked
async def receive(
    url: str, *, deadline_s: float | None = None, fingerprint: str | None = None,
    on_event: Callable[[Event], Any] | None = None,
) -> SceneStream:  # fmt: skip
    """Receives a stream from a server.

    Args:
        url: Address of the server and the name of the stream: `udp://HOST[:PORT][/NAME]` or
            `quic://HOST[:PORT][/NAME][?token=TOKEN]`; the token opens private scenes.
        deadline_s: Time after which the transfer ends with the packets received so far, seconds; None for no limit.
        fingerprint: SHA-256 of the only accepted certificate of a `quic://` server, hexadecimal; None for the
            certificates that the system trusts.
        on_event: Called in the event loop with every event, such as an arrived packet.

    Returns:
        The stream with the received packets.

    Raises:
        InvalidValueError: If the URL is wrong, or the transfer ends before the side information has arrived.

    Example:
        >>> import asyncio, splatwire
        >>> async def transfer() -> bool:
        ...     stream, _ = splatwire.read_stream("scene.swz")
        ...     async with splatwire.serve({"scene": stream}) as server:
        ...         received = await splatwire.receive(f"udp://127.0.0.1:{server.port}/scene")
        ...     return received == stream
        >>> asyncio.run(transfer())
        True
    """
    address = parse_url(url)
    options = ReceiverOptions(name=address.name, scene_token=address.token, deadline_s=deadline_s)
    if fingerprint is not None and address.scheme != "quic":
        raise InvalidValueError(f"fingerprint: {address.scheme}:// has no certificate, quic:// has")
    if address.scheme == "udp":
        receiver = await receive_udp(address, options, on_event)
    elif address.scheme == "quic":
        from splatwire.transport.quic.client import Trust, receive_quic  # aioquic is optional

        receiver = await receive_quic(address, options, Trust(fingerprint=fingerprint), on_event)
    else:
        raise InvalidValueError(f"url: '{url}' is a relay, which `splatwire receive` reads; this takes udp and quic")
    if (stream := receiver.stream()) is None:
        reason = "no reason" if receiver.finished is None else receiver.finished.reason
        raise InvalidValueError(f"{without_token(url)}: no stream arrived: {reason}")
    return stream


@checked
@asynccontextmanager
async def serve(
    streams: Mapping[str, SceneStream],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    protection: Protection | None = None,
    limits: ServerLimits | None = None,
) -> AsyncIterator[UdpServer]:
    """Serves streams over UDP while the context is open.

    Args:
        streams: Streams by name; a client that requests no name gets the first.
        host: Address to listen on; the default accepts clients of this machine only.
        port: UDP port; 0 selects a free port.
        protection: Amount of redundancy; None for the default.
        limits: Limits on the transfers of clients; None for the defaults.

    Yields:
        The running server.

    Raises:
        InvalidValueError: If a stream cannot be served, or the port cannot be bound.
    """
    if not streams:
        raise InvalidValueError("streams: expected at least one stream by its name")
    served = {
        name: make_served_stream(stream.require_scene(f"stream '{name}'"), protection)
        for name, stream in streams.items()
    }
    server = UdpServer(served, host, port, limits=limits)
    try:
        yield server
    finally:
        server.close()
