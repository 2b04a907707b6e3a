"""Common code of `receive` and `view`: receives over UDP, QUIC or Media over QUIC, and checks certificates."""

import asyncio
import sys
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

from splatwire.cli._loop_signals import LoopSignals
from splatwire.cli._options import TrustOptions
from splatwire.errors import InvalidValueError
from splatwire.transport import Receiver
from splatwire.transport.address import Address
from splatwire.transport.moq.publisher import RelayTrust, need_moq
from splatwire.transport.moq.receiver import receive_relayed
from splatwire.transport.protocol.events import Event, Interrupted, NotBegun, Resumed
from splatwire.transport.quic.installed import need_aioquic
from splatwire.transport.udp import receive_udp

Transfer = Callable[..., Awaitable[Receiver]]


def transfer_of(trusted: TrustOptions, address: Address) -> Transfer:
    """Returns a function that receives a stream with the protocol of an address (UDP, QUIC or Media over QUIC).

    Args:
        trusted: Options that determine which certificates are accepted.
        address: Address of the server or relay.

    Returns:
        The function. It has two positional arguments and two optional keyword arguments:

        * Options of the receiver.
        * Function that is called with each event, or None.
        * `tap`: function that is called with each datagram.
        * `stop`: future that ends the transfer.

    Raises:
        InvalidValueError: If options for certificates are invalid, or are set for UDP, which has no certificates.
        OSError: If the authority's file cannot be read.
    """
    if address.scheme == "udp":
        if trusted.given:
            raise InvalidValueError("--fingerprint, --authority and --insecure are for quic:// and moq://")
        return lambda options, on_event, **more: receive_udp(address, options, on_event, **more)
    if address.scheme == "moq":
        return _relayed(trusted, address)
    quic = _quic_functions()
    trust = quic.trust_of(trusted)
    return lambda options, on_event, **more: quic.receive_quic(address, options, trust, on_event, **more)


def print_waiting(event: Event) -> None:
    """Prints a warning on standard error if a stream has not begun, or if the server falls silent or answers again.

    Args:
        event: Event of a receiver.
    """
    if isinstance(event, NotBegun):
        print_warning("the stream has not begun; waiting for its data")
    print_interruption(event)


def print_interruption(event: Event) -> None:
    """Prints a warning on standard error if the server falls silent or answers again.

    Args:
        event: Event of a receiver.
    """
    match event:
        case Interrupted():
            print_warning("the server sends nothing; reconnecting")
        case Resumed():
            how = "going on" if event.kept else "it sends another stream, which begins anew"
            print_warning(f"the server answers again: {how}")


def print_warning(text: str) -> None:
    """Prints a warning on standard error."""
    print(f"splatwire: warning: {text}", file=sys.stderr, flush=True)


def _quic_functions() -> ModuleType:
    """Returns the module with the functions for QUIC, which imports aioquic.

    Raises:
        BackendUnavailableError: If aioquic is not installed.
    """
    need_aioquic()
    from splatwire.cli import _quic

    return _quic


def _relayed(trusted: TrustOptions, address: Address) -> Transfer:
    need_moq()
    trust = relay_trust(trusted)

    def transfer(options: Any, on_event: Any, tap: Any = None, stop: Any = None) -> Any:
        if tap is not None:
            raise InvalidValueError("--pcap is for udp:// and quic://")
        return receive_relayed(address, options, trust, on_event, stop)

    return transfer


def relay_trust(trusted: TrustOptions) -> RelayTrust:
    """Converts command-line options to the rule that decides which certificates of a relay are accepted.

    Raises:
        InvalidValueError: If the fingerprint is invalid, or more than one of these options is set.
        OSError: If the file of the certificate authority cannot be read.
    """
    trust = _quic_functions().trust_of(trusted)
    return RelayTrust(trusted.authority, trust.fingerprint, trust.insecure)


@contextmanager
def canceling_on_signals(stop: asyncio.Future[None]) -> Iterator[list[int]]:
    """Context in which SIGINT and SIGTERM cancel a future of the running event loop.

    Args:
        stop: The future.

    Yields:
        List of the numbers of the received signals. Each signal adds its number to the list.
    """
    received = list[int]()

    def on_signal(number: int) -> None:
        received.append(number)
        stop.cancel()

    signals = LoopSignals(on_signal)
    try:
        yield received
    finally:
        signals.restore()
