"""Tokens: proof that a client reads what is sent to its address. The server remembers none of them."""

import hashlib
import hmac
from collections.abc import Hashable

from splatwire.errors import InvalidValueError
from splatwire.transport.frames import TOKEN_BYTES

LIFETIME_S = 10.0
MIN_SECRET_BYTES = 16


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

    def token(self, address: Hashable, nonce: int, name: str, now: float, age: int = 0) -> bytes:
        """A token for an address, good for this and the next `LIFETIME_S`."""
        text = repr((int(now // LIFETIME_S) - age, address, nonce, name)).encode()
        return hmac.new(self._secret, text, hashlib.sha256).digest()[:TOKEN_BYTES]

    def valid(self, token: bytes, address: Hashable, nonce: int, name: str, now: float) -> bool:
        """Whether a token was made for this address and attempt a short while ago."""
        return any(hmac.compare_digest(token, self.token(address, nonce, name, now, age)) for age in (0, 1))
