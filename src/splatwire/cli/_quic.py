"""Starts QUIC servers and clients with the options of the command line.

The options select the server's certificate, the web page that the server offers, and the certificates that a client
trusts. Needs the package `aioquic`.
"""

import contextlib
import logging
import socket
from collections.abc import Callable, Mapping

from splatwire.cli._options import Listening, TrustOptions
from splatwire.errors import InvalidValueError
from splatwire.transport import ServedStream, ServerLimits
from splatwire.transport.access import Access
from splatwire.transport.event_log import log_event
from splatwire.transport.http.proxies import parse_networks
from splatwire.transport.quic.certificate import FileIdentity, Identity, RenewedIdentity
from splatwire.transport.quic.client import Trust, receive_quic
from splatwire.transport.quic.page import Page, open_quic_server
from splatwire.transport.running_server import RunningServer

_LOG = logging.getLogger("splatwire.transport.serve")
__all__ = ["open_server", "receive_quic", "trust_of"]


async def open_server(
    streams: Mapping[str, ServedStream], listening: Listening, limits: ServerLimits,
    stack: contextlib.AsyncExitStack, origins: tuple[str, ...], live: str | None, public: str | None,
    access: Access | None,
) -> RunningServer:  # fmt: skip
    """Starts a server over QUIC with the options of the command line.

    Args:
        streams: The streams to serve, by name.
        listening: Options for address, port, certificate and web page.
        limits: Limits of the server on its clients.
        stack: Exit stack that closes the server.
        origins: Web origins whose pages may connect; empty for the default of `open_quic_server`.
        live: Name of the live stream that the web page shows; None to show the streams of the server.
        public: Web origin by which visitors reach the page through a proxy; None without a proxy.
        access: Rules for access to private scenes; None if all are public.
    """
    page = None
    if listening.page is not None:
        page = Page(listening.page, public, listening.certificate is None, live, parse_networks(listening.proxy))
    return await open_quic_server(
        streams,
        listening.host,
        listening.port,
        identity(listening),
        limits,
        stack,
        origins=origins,
        page=page,
        access=access,
    )


def identity(listening: Listening) -> "Callable[[], Identity]":
    """Returns a function that provides the current certificate and key of a QUIC server.

    Without files in the options, the certificate is self-signed and renewed regularly.

    Args:
        listening: Command-line options of the server, with the files of certificate and key.

    Raises:
        InvalidValueError: If only one of certificate and key is given, or their files are invalid.
    """
    # Self-signed certificates are renewed.
    if (listening.certificate is None) != (listening.key is None):
        raise InvalidValueError("--certificate and --key belong together")
    if listening.certificate is None or listening.key is None:
        hosts = ("localhost", "127.0.0.1", "::1", socket.gethostname(), listening.host)
        return RenewedIdentity(hosts, on_renewed=_log_renewed)
    return FileIdentity(listening.certificate, listening.key)


def _log_renewed(identity: "Identity") -> None:
    """Logs the fingerprint of a renewed certificate."""
    log_event(_LOG, logging.WARNING, "certificate renewed", fingerprint=identity.fingerprint)


def trust_of(options: TrustOptions) -> Trust:
    """Converts the command-line options for certificate checks to the settings of a QUIC client.

    Raises:
        InvalidValueError: If the fingerprint is invalid, or more than one of these options is set.
        OSError: If the file of the certificate authority cannot be read.
    """
    authority = None if options.authority is None else options.authority.read_bytes()
    return Trust(authority, options.fingerprint, options.insecure)
