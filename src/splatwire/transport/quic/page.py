"""QUIC server with a web page that receives and draws its streams."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from splatwire.transport.access import Access
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.origins import listens_on_loopback
from splatwire.transport.http.proxies import IpNetwork
from splatwire.transport.http.server import PageLimits, PageServer
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.protocol.server_limits import ServerLimits
from splatwire.transport.quic.certificate import Identity
from splatwire.transport.quic.common import WEBTRANSPORT_PATH, QuicLimits
from splatwire.transport.quic.server import QuicServer
from splatwire.transport.running_server import RunningServer


@dataclass(frozen=True)
class Page:
    """Settings of the web page that a QUIC server offers in addition to its streams.

    Attributes:
        port: TCP port; 0 lets the system choose.
        public_origin: Web origin by which visitors reach the page through a proxy; None without a proxy.
        pinned: True if the page accepts the server's certificate by its fingerprint, as needed for a self-signed one.
        live: Name of the live stream that the page shows; None to show the streams of the server.
        proxies: Networks of trusted proxies, whose header `X-Forwarded-For` gives the address of the client.
    """

    port: int
    public_origin: str | None = None
    pinned: bool = True
    live: str | None = None
    proxies: tuple[IpNetwork, ...] = ()


async def open_quic_server(
    streams: Mapping[str, ServedStream], host: str, port: int, identity: Callable[[], Identity], limits: ServerLimits,
    stack: contextlib.AsyncExitStack, *, origins: tuple[str, ...] = (), page: Page | None = None,
    access: Access | None = None,
) -> RunningServer:  # fmt: skip
    """Starts a QUIC server, and the web server of its page if requested.

    Args:
        streams: Streams by name.
        host: Address to listen on.
        port: UDP port; 0 lets the system choose.
        identity: Function that returns the current certificate and key.
        limits: Limits on clients.
        stack: Exit stack that closes the servers.
        origins: Web origins whose pages may open sessions; if empty, all, or only those of this machine if the server
            listens on a loopback address and no proxy has another.
        page: Settings of the page; None for no page.
        access: Access rules for private scenes; None if all scenes are public.
    """
    # As for the streams over HTTP, pages of other sites may not read what only this machine can reach.
    only_local = (page is None or page.public_origin is None) and listens_on_loopback(host)
    quic_limits = QuicLimits(2 * limits.sessions, 2 * limits.per_network, origins or None, only_local)
    server = QuicServer(streams, host, port, identity=identity, limits=limits, quic_limits=quic_limits)
    stack.callback(server.close)
    server.core.access = access
    await server.start()
    facts = {"fingerprint": identity().fingerprint}
    if page is None:
        return RunningServer(server, facts)
    pinned, public = page.pinned, page.public_origin

    def endpoint() -> WebTransportEndpoint:
        return WebTransportEndpoint(server.port, WEBTRANSPORT_PATH, identity().fingerprint if pinned else None)

    shown = streams if page.live is None else {page.live: None}
    content = PageContent(shown, endpoint, host, origins or None, public, access=access)
    page_limits = PageLimits(limits.sessions, 2 * limits.per_network)
    opened = await stack.enter_async_context(
        PageServer(content, page.port, page_limits, proxies=page.proxies, pacer=server.core.total_pacer)
    )
    facts["page"] = opened.url if public is None else f"{public}/"
    if origins:  # the viewer page opens sessions, too
        own_urls = (public or f"http://localhost:{opened.port}", opened.url.rstrip("/"))
        server.limits = replace(server.limits, origins=(*origins, *own_urls))
    return RunningServer(server, facts, opened)
