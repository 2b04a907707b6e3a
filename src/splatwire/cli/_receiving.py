"""What the verbs that receive a stream share: whom a client believes, and which transport an address means."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from splatwire.errors import InvalidValueError

if TYPE_CHECKING:
    from splatwire.transport import Receiver
    from splatwire.transport.address import Address

    Transfer = Callable[..., Awaitable[Receiver]]


@dataclass(frozen=True)
class TrustOptions:
    """With quic://, which server is believed; without any of these one with a certificate that the system knows."""

    fingerprint: str | None = None
    """With quic://: SHA-256 of the server's certificate, as the server tells it; nothing else about it matters then."""
    authority: Path | None = None
    """With quic://: PEM file of certificates that vouch for the server's, or its own; else those the system knows."""
    insecure: bool = False
    """With quic://: take any certificate; somebody on the path can pose as the server."""

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
                raise InvalidValueError("--fingerprint, --authority and --insecure are for quic://")
            from splatwire.transport.udp import receive_udp

            return lambda options, note, **more: receive_udp(address, options, note, **more)
        from splatwire.transport.quic import need_aioquic

        need_aioquic()
        from splatwire.transport.quic_client import Trust, receive_quic

        authority = None if self.authority is None else self.authority.read_bytes()
        trust = Trust(authority, self.fingerprint, self.insecure)
        return lambda options, note, **more: receive_quic(address, options, trust, note, **more)
