"""A local relay of Media over QUIC: the server of moq-rs with an origin."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

from splatwire.transport.address import Address


@contextlib.asynccontextmanager
async def moq_relay() -> AsyncIterator[Address]:
    """Runs a relay and yields an address with a placeholder name."""
    import moq

    origin, sessions = moq.OriginProducer(), []
    async with moq.Server("127.0.0.1:0", tls_generate=["localhost"], publish=origin, subscribe=origin) as server:

        async def accept() -> None:
            async for request in server:
                sessions.append(await request.accept())

        task = asyncio.ensure_future(accept())
        try:
            yield Address("127.0.0.1", int(server.local_addr.rpartition(":")[2]), "", "moq")
        finally:
            task.cancel()
