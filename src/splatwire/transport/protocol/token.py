"""Stateless tokens that prove that a client receives datagrams at its address."""

import hashlib
import hmac
import struct
from collections.abc import Hashable

from splatwire.errors import InvalidValueError
from splatwire.transport.protocol.messages import TOKEN_BYTES

LIFETIME_S = 15.0
MIN_SECRET_BYTES = 16
_STAMP, _MASK, _TICKS = struct.Struct("<I"), (1 << 32) - 1, 1e4


class TokenMint:
    """Creates and verifies tokens that prove that a client receives datagrams at its address.

    Args:
        secret: Secret key of the server, at least 16 bytes.

    Raises:
        InvalidValueError: If the key has fewer than 16 bytes.
    """

    def __init__(self, secret: bytes) -> None:
        if len(secret) < MIN_SECRET_BYTES:
            raise InvalidValueError(f"a server's secret needs at least {MIN_SECRET_BYTES} bytes, not {len(secret)}")
        self._secret = secret

    def token(self, address: Hashable, nonce: int, name: str, now: float) -> bytes:
        """Returns a token for a client, authenticated with the secret key.

        Args:
            address: Address of the client.
            nonce: Random number of the client's connection attempt.
            name: Name of the requested stream.
            now: Time, seconds.
        """
        return self._made(int(now * _TICKS) & _MASK, address, nonce, name)

    def age(self, token: bytes, address: Hashable, nonce: int, name: str, now: float) -> float | None:
        """Verifies a token and returns the token's age in seconds, or None for an expired or invalid token.

        Args:
            token: Token returned by the client.
            address: Address of the client.
            nonce: Random number of the client's connection attempt.
            name: Name of the requested stream.
            now: Time, seconds.
        """
        stamp = _STAMP.unpack_from(token)[0]
        age: float = ((int(now * _TICKS) - stamp) & _MASK) / _TICKS
        good = hmac.compare_digest(token, self._made(stamp, address, nonce, name))
        return age if good and age <= LIFETIME_S else None

    def _made(self, stamp: int, address: Hashable, nonce: int, name: str) -> bytes:
        text = repr((stamp, address, nonce, name)).encode()
        code = hmac.new(self._secret, text, hashlib.sha256).digest()
        return _STAMP.pack(stamp) + code[: TOKEN_BYTES - _STAMP.size]
