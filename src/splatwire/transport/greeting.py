"""A client's handshake with a server: one attempt, which goes on until the server welcomes it."""

import hashlib

from splatwire.transport.frames import TOKEN_BYTES, Hello, Request
from splatwire.transport.wire import encode

RETRY_S = 0.2
"""Interval between two greetings, seconds."""
RELIABLE_RETRY_S = 10.2
"""The same over a path that repeats what is lost, seconds."""
TOKEN_S = 2.0
"""A token that brought no welcome for so long is given up: the server or this end's address is another one, seconds."""
LATER_S = 1.0
"""Interval after which a refused client greets again, seconds."""


class Greeting:
    """One attempt to begin a transfer.

    Args:
        nonce: 64 random bits that name the attempt.
        now: Time, seconds.
        name: Stream that is wanted.
        reliable: Whether the path has shown the client's address to the server (QUIC): no token is needed.
    """

    def __init__(self, nonce: int, now: float, name: str, *, reliable: bool) -> None:
        self.nonce, self._name, self._reliable = nonce, name, reliable
        self.began_at = self.next_at = now
        self._token: bytes | None = bytes(TOKEN_BYTES) if reliable else None
        self._token_at = now

    @property
    def shown(self) -> bool:
        """Whether the server may welcome it: it has shown its token, or needs none."""
        return self._token is not None

    def poll(self, now: float) -> list[bytes]:
        """The greeting, if its time has come."""
        if now < self.next_at:
            return []
        if not self._reliable and now - self._token_at > TOKEN_S:
            self._token = None
        self.next_at = now + (RELIABLE_RETRY_S if self._reliable else RETRY_S)
        return [self._frame()]

    def challenged(self, token: bytes, now: float) -> bytes:
        """Takes a token; returns the answer."""
        self._token, self._token_at, self.next_at = token, now, now + RETRY_S
        return self._frame()

    def refused(self, now: float, after: float = LATER_S) -> None:
        """Takes a refusal that may not last: a token does not hold for long."""
        self.next_at = now + after
        self._token = self._token if self._reliable else None

    def again(self, now: float) -> "Greeting":
        """Another attempt, whose name only this client can derive."""
        digest = hashlib.sha256(b"again" + self.nonce.to_bytes(8, "little")).digest()
        return Greeting(int.from_bytes(digest[:8], "little"), now, self._name, reliable=self._reliable)

    def _frame(self) -> bytes:
        if self._token is None:
            return encode(Hello(self.nonce, self._name))
        return encode(Request(self.nonce, self._token, self._name))
