"""What the verbs that receive a stream share: whom a client believes, and which transport an address means."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.transport import Receiver
    from splatwire.transport.address import Address
    from splatwire.transport.moq import RelayTrust

    Transfer = Callable[..., Awaitable[Receiver]]


@dataclass(frozen=True)
class TrustOptions:
    """Which server or relay is believed; without any of these one with a certificate that the system knows."""

    fingerprint: str | None = None
    """Not with udp://: SHA-256 of the server's certificate, as it tells; nothing else about it matters then."""
    authority: Path | None = None
    """Not with udp://: PEM file of certificates that vouch for the server's, or its own; else the system's."""
    insecure: bool = False
    """Not with udp://: take any certificate; somebody on the path can pose as the server."""

    @property
    def given(self) -> bool:
        """Whether any of them was given."""
        return bool(self.fingerprint is not None or self.authority is not None or self.insecure)

    def transfer(self, address: "Address") -> "Transfer":
        """What receives from an address: called with options and a listener, and by keyword with `tap` and `stop`.

        Raises:
            InvalidValueError: If trust was given for an address that needs none, or is none.
            OSError: If the authority's file cannot be read.
        """
        if address.scheme == "udp":
            if self.given:
                raise InvalidValueError("--fingerprint, --authority and --insecure are for quic:// and moq://")
            from splatwire.transport.udp import receive_udp

            return lambda options, note, **more: receive_udp(address, options, note, **more)
        if address.scheme == "moq":
            return self._relayed(address)
        from splatwire.transport.quic import need_aioquic

        need_aioquic()
        from splatwire.transport.quic_client import Trust, receive_quic

        authority = None if self.authority is None else self.authority.read_bytes()
        trust = Trust(authority, self.fingerprint, self.insecure)
        return lambda options, note, **more: receive_quic(address, options, trust, note, **more)

    def _relayed(self, address: "Address") -> "Transfer":
        from splatwire.transport.moq import need_moq
        from splatwire.transport.moq_receiver import receive_relayed

        need_moq()
        trust = self.relay_trust()

        def transfer(options: Any, note: Any, tap: Any = None, stop: Any = None) -> Any:
            if tap is not None:
                raise InvalidValueError("--pcap is for udp:// and quic://")
            return receive_relayed(address, options, trust, note, stop)

        return transfer

    def relay_trust(self) -> "RelayTrust":
        """Which relay is believed.

        Raises:
            InvalidValueError: If a fingerprint is none, or more than one of them is given.
            OSError: If the authority's file cannot be read.
        """
        from splatwire.transport.moq import RelayTrust
        from splatwire.transport.quic_client import Trust

        authority = None if self.authority is None else self.authority.read_bytes()
        trust = Trust(authority, self.fingerprint, self.insecure)
        return RelayTrust(self.authority, trust.fingerprint, trust.insecure)


@dataclass(frozen=True)
class RelayTrustOptions(TrustOptions):
    """With --moq only: which relay is trusted; without any of these one with a certificate that the system knows."""

    fingerprint: str | None = None
    """With --moq: SHA-256 of the relay's certificate; nothing else about the certificate matters then."""
    authority: Path | None = None
    """With --moq: PEM file of certificates that vouch for the relay's, or its own; else the system's."""
    insecure: bool = False
    """With --moq: take any certificate; an attacker on the path can pose as the relay."""
