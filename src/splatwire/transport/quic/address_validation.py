"""Validation of client addresses before any handshake, with stateless QUIC Retry packets (RFC 9000, 8.1.2).

Each check costs microseconds, so that a flood of forged Initial packets takes little time from other clients.
"""

import hashlib
import hmac
import os
from dataclasses import dataclass
from typing import Any

from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from splatwire.transport.socket_group import QUIC_2, TOKEN_PREFIX

MIN_INITIAL_BYTES = 1200
"""Minimum UDP payload of a client's Initial packet, bytes (RFC 9000, 14.1)."""
MAX_CONNECTION_ID_BYTES = 20
MAX_TOKEN_OFFSET = 64
"""Upper bound on the end of `TOKEN_PREFIX` in an Initial packet, after the longest connection ids, bytes."""
TOKEN_LIFETIME_S = 30.0
"""Maximum age of a Retry token, seconds. Clients return it at once."""
_STAMP_BYTES, _MAC_BYTES, _TICKS = 4, 16, 100.0
_LONG_INITIAL = {1: (0xC0, 0xF0), QUIC_2: (0xD0, 0xC0)}
"""First byte of Initial and Retry packets by QUIC version (1 and 2), without the low 4 bits."""
_INTEGRITY = {  # RFC 9001, 5.8, and RFC 9369, 3.3.3
    1: (AESGCM(bytes.fromhex("be0c690b9f66575a1d766b54e368c84e")), bytes.fromhex("461599d35d632bf2239825bb")),
    QUIC_2: (AESGCM(bytes.fromhex("8fb4b01b56ac48e260fbcbcead7ccc92")), bytes.fromhex("d86969bc2d7c6d9990efb04a")),
}
"""Key and nonce of the integrity tag of Retry packets by QUIC version."""


@dataclass(frozen=True, slots=True)
class Initial:
    """Header fields of a client's Initial packet.

    Attributes:
        version: QUIC version.
        destination: Destination connection id, 0 to 20 bytes.
        source: Source connection id, 0 to 20 bytes.
        token: Token of an earlier Retry packet, or of another server; empty without one.
    """

    version: int
    destination: bytes
    source: bytes
    token: bytes

    @property
    def has_retry_token(self) -> bool:
        """True if the token has the form of the tokens of `RetryTokens`; it may be invalid."""
        return self.token.startswith(TOKEN_PREFIX)


def parse_initial(data: bytes) -> Initial | None:
    """Returns the header of a client's Initial packet; None if a datagram cannot start a connection.

    Args:
        data: Payload of a UDP datagram.
    """
    if len(data) < MIN_INITIAL_BYTES:
        return None
    version = int.from_bytes(data[1:5], "big")
    if version not in _LONG_INITIAL or data[0] & 0xF0 != _LONG_INITIAL[version][0]:
        return None
    end = 6 + data[5]
    destination, source = data[6:end], data[end + 1 : end + 1 + data[end]]
    if max(len(destination), data[end]) > MAX_CONNECTION_ID_BYTES:
        return None
    at = end + 1 + len(source)
    size = 1 << (data[at] >> 6)
    num_bytes = int.from_bytes(data[at : at + size], "big") & ((1 << (8 * size - 2)) - 1)
    if at + size + num_bytes > len(data):
        return None
    return Initial(version, destination, source, data[at + size : at + size + num_bytes])


def is_unknown_version(data: bytes) -> bool:
    """True if a datagram starts a connection of a QUIC version that this server does not support.

    Args:
        data: Payload of a UDP datagram with a long header.
    """
    version = int.from_bytes(data[1:5], "big")
    return len(data) >= MIN_INITIAL_BYTES and version != 0 and version not in _LONG_INITIAL


class RetryTokens:
    """Creates and verifies the tokens of QUIC Retry packets.

    A token contains `TOKEN_PREFIX`, a time stamp, a keyed hash, and the destination connection id of the client's first
    packet. The class has the same methods as aioquic's `QuicRetryTokenHandler`, which it replaces. They take a tenth of
    the time.
    """

    def __init__(self) -> None:
        self._key = os.urandom(32)

    def create_token(
        self, *, address: Any, original_destination_connection_id: bytes, retry_source_connection_id: bytes, now: float
    ) -> bytes:
        """Returns a token for a client.

        Args:
            address: Socket address of the client.
            original_destination_connection_id: Destination connection id of the client's first packet.
            retry_source_connection_id: Connection id that the Retry packet gives to the client.
            now: Time, seconds.
        """
        stamp = (int(now * _TICKS) & 0xFFFFFFFF).to_bytes(_STAMP_BYTES, "big")
        mac = self._mac(stamp, address, original_destination_connection_id, retry_source_connection_id)
        return TOKEN_PREFIX + stamp + mac + original_destination_connection_id

    def validate_token(self, *, address: Any, destination_cid: bytes, token: bytes, now: float) -> bytes:
        """Verifies a token, and returns the destination connection id of the client's first packet.

        Args:
            address: Socket address of the client.
            destination_cid: Destination connection id of the packet with the token.
            token: Token returned by the client.
            now: Time, seconds.

        Raises:
            ValueError: If the token is invalid or has expired.
        """
        prefix, content = token[: len(TOKEN_PREFIX)], token[len(TOKEN_PREFIX) :]
        stamp, original = content[:_STAMP_BYTES], content[_STAMP_BYTES + _MAC_BYTES :]
        mac = self._mac(stamp, address, original, destination_cid)
        is_own = hmac.compare_digest(mac, content[_STAMP_BYTES : _STAMP_BYTES + _MAC_BYTES])
        if prefix != TOKEN_PREFIX or not is_own:
            raise ValueError("the token is invalid")
        if ((int(now * _TICKS) - int.from_bytes(stamp, "big")) & 0xFFFFFFFF) > TOKEN_LIFETIME_S * _TICKS:
            raise ValueError("the token has expired")
        return original

    def is_valid(self, initial: Initial, address: Any, now: float) -> bool:
        """True if the token of an Initial packet is valid.

        Args:
            initial: Header of the packet.
            address: Socket address of the client.
            now: Time, seconds.
        """
        try:
            self.validate_token(address=address, destination_cid=initial.destination, token=initial.token, now=now)
        except ValueError:
            return False
        return True

    def retry_packet(self, initial: Initial, address: Any, now: float) -> bytes:
        """Returns a Retry packet, which asks a client to repeat its Initial packet with a token.

        Args:
            initial: Header of the client's Initial packet.
            address: Socket address of the client.
            now: Time, seconds.
        """
        source = os.urandom(8)
        token = self.create_token(
            address=address, original_destination_connection_id=initial.destination,
            retry_source_connection_id=source, now=now,
        )  # fmt: skip
        first = _LONG_INITIAL[initial.version][1].to_bytes(1, "big") + initial.version.to_bytes(4, "big")
        packet = first + _with_size(initial.source) + _with_size(source) + token
        aead, nonce = _INTEGRITY[initial.version]
        return packet + aead.encrypt(nonce, b"", _with_size(initial.destination) + packet)

    def _mac(self, stamp: bytes, address: Any, original: bytes, retry_source: bytes) -> bytes:
        text = b"%b%b%b%d:%b" % (stamp, _with_size(original), _with_size(retry_source), address[1], address[0].encode())
        return hashlib.blake2b(text, key=self._key, digest_size=_MAC_BYTES).digest()


def _with_size(data: bytes) -> bytes:
    """Returns `data` with its length in front, as one byte."""
    return bytes([len(data) & 0xFF]) + data
