"""A running server over UDP or QUIC, with its optional web page."""

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from splatwire.transport.http.content import PageContent
from splatwire.transport.http.server import PageServer
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.udp import UdpServer

if TYPE_CHECKING:
    from splatwire.transport.quic.server import QuicServer


DRAIN_INTERVAL_S = 0.05
"""Interval at which a stopping server checks for running transfers, seconds."""


@dataclass(frozen=True, eq=False)
class RunningServer:
    """A running server.

    Attributes:
        server: The server over UDP or QUIC.
        facts: Information that clients need to connect, such as the address and certificate fingerprint, by name.
        page: Web server of the viewer page; None without a page.
    """

    server: "UdpServer | QuicServer"
    facts: dict[str, str]
    page: PageServer | None = None

    @property
    def draining(self) -> bool:
        """True if the server refuses new transfers because it is stopping."""
        return self.server.core.draining

    @property
    def is_busy(self) -> bool:
        """True while the server runs a transfer or answers an HTTP request."""
        return bool(self.server.core.num_transfers or (self.page is not None and self.page.num_active))

    def replace(
        self, streams: Mapping[str, ServedStream], updates: Mapping[str, ServedStream | None] | None = None
    ) -> None:
        """Replaces all served streams and reads the certificate files again, without interrupting transfers.

        If the certificate is invalid, nothing is replaced.

        Args:
            streams: Prepared streams by name.
            updates: Prepared streams of updates by name. An update contains later changes of a scene, and clients
                request it separately. None for an update that does not exist yet. Without this argument, there are no
                updates.

        Raises:
            InvalidValueError: If the files of the certificate are invalid.
            OSError: If a file of the certificate cannot be read.
        """
        if not isinstance(self.server, UdpServer):
            self.server.reload_identity()
        self.publish(streams, updates)

    def publish(
        self, streams: Mapping[str, ServedStream], updates: Mapping[str, ServedStream | None] | None = None
    ) -> None:
        """Replaces all streams and updates of the server. Running transfers continue with the old ones.

        Args:
            streams: Prepared streams by name.
            updates: Prepared streams of updates by name. An update contains later changes of a scene, and clients
                request it separately. None for an update that does not exist yet. Without this argument, there are no
                updates.
        """
        self.server.core.replace(streams, updates)
        if self.page is not None and isinstance(self.page.content, PageContent):
            existing = {name: stream for name, stream in (updates or {}).items() if stream is not None}
            self.page.content = replace(self.page.content, streams=streams, updates=existing)

    async def drain(self, most_s: float) -> None:
        """Refuses new transfers, and waits until all transfers and HTTP responses have ended.

        Args:
            most_s: Maximum duration, seconds.
        """
        loop = asyncio.get_running_loop()
        # New HTTP requests are still answered, so that pages that have started to load can finish.
        self.server.core.draining, end = True, loop.time() + most_s
        while loop.time() < end and self.is_busy:
            await asyncio.sleep(DRAIN_INTERVAL_S)

    def not_ready(self) -> str | None:
        """Returns the reason for refusing new clients, or None if the server accepts new clients."""
        if self.draining:
            return "the server is stopping"
        return None if self.server.core.num_streams else "no stream is available yet"

    def served(self) -> str:
        """Returns a text for the log: the numbers of served clients, HTTP responses and sent bytes."""
        text = f"served {self.server.core.num_served} clients, {self.server.bytes_sent:,} bytes"
        if self.page is None:
            return text
        return f"{text}, and {self.page.num_responses:,} requests over HTTP, {self.page.bytes_sent:,} bytes"
