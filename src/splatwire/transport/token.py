"""Tokens: proof that a client reads what is sent to its address. The server remembers none of them."""

import hashlib
import hmac
import struct
from collections.abc import Hashable

from splatwire.errors import InvalidValueError
from splatwire.transport.frames import TOKEN_BYTES

LIFETIME_S = 15.0
MIN_SECRET_BYTES = 16
_STAMP, _MASK, _TICKS = struct.Struct("<I"), (1 << 32) - 1, 1e4


class TokenMint:
    """Makes and checks tokens.

    Args:
        secret: Key that only the server knows.

    Raises:
        InvalidValueError: If it is too short.
    """

    def __init__(self, secret: bytes) -> None:
        if len(secret) < MIN_SECRET_BYTES:
            raise InvalidValueError(f"a server's secret needs at least {MIN_SECRET_BYTES} bytes, not {len(secret)}")
        self._secret = secret

    def token(self, address: Hashable, nonce: int, name: str, now: float) -> bytes:
        """A token for an address: when it was made, and a code of that."""
        return self._made(int(now * _TICKS) & _MASK, address, nonce, name)

    def age(self, token: bytes, address: Hashable, nonce: int, name: str, now: float) -> float | None:
        """Seconds since a token was made for this address and attempt; None if it was not, or too long ago."""
        stamp = _STAMP.unpack_from(token)[0]
        age: float = ((int(now * _TICKS) - stamp) & _MASK) / _TICKS
        good = hmac.compare_digest(token, self._made(stamp, address, nonce, name))
        return age if good and age <= LIFETIME_S else None

    def _made(self, stamp: int, address: Hashable, nonce: int, name: str) -> bytes:
        text = repr((stamp, address, nonce, name)).encode()
        code = hmac.new(self._secret, text, hashlib.sha256).digest()
        return _STAMP.pack(stamp) + code[: TOKEN_BYTES - _STAMP.size]
