"""Handshake of a client: one connection attempt, until the server accepts the request."""

import hashlib

from splatwire.transport.protocol.messages import TOKEN_BYTES, Hello, Request
from splatwire.transport.protocol.wire import encode

RETRY_S = 0.2
"""Retransmission interval of the handshake, seconds."""
RELIABLE_RETRY_S = 10.2
"""Retransmission interval of the handshake over a reliable path (QUIC), seconds."""
TOKEN_S = 2.0
"""Time after which a token is dropped if the server has not accepted the request, seconds: the server or the client's
address may have changed.
"""
WAIT_S = 0.5
"""Interval of requests for a stream that the server has announced but does not have yet, seconds. The first requests
follow each other faster (`RETRY_S`).
"""
REFUSAL_RETRY_S = 1.0
"""Time from a temporary refusal to the next request, seconds."""


class HandshakeAttempt:
    """One attempt of a client to start a transfer.

    Args:
        nonce: Random 64-bit number that identifies the attempt.
        now: Time, seconds.
        name: Name of the requested stream.
        reliable: True on QUIC connections, which need no token to prove the client's address.
        scene_token: Signed token that opens private scenes; empty without one.
    """

    def __init__(self, nonce: int, now: float, name: str, *, reliable: bool, scene_token: str = "") -> None:
        self.nonce, self._name, self._reliable, self._scene_token = nonce, name, reliable, scene_token
        self.began_at = self.next_at = now
        self._token: bytes | None = bytes(TOKEN_BYTES) if reliable else None
        self._token_at = now

    @property
    def is_validated(self) -> bool:
        """True if the server may accept the request: the client has a token, or needs no token."""
        return self._token is not None

    def poll(self, now: float) -> list[bytes]:
        """Returns a list with the next handshake datagram, empty if none is due.

        Args:
            now: Time, seconds.
        """
        if now < self.next_at:
            return []
        if not self._reliable and now - self._token_at > TOKEN_S:
            self._token = None
        self.next_at = now + (RELIABLE_RETRY_S if self._reliable else RETRY_S)
        return [self._frame()]

    def on_challenge(self, token: bytes, now: float) -> bytes:
        """Stores the server's token and returns the request datagram with the token."""
        self._token, self._token_at, self.next_at = token, now, now + RETRY_S
        return self._frame()

    def on_refusal(self, now: float, delay_s: float = REFUSAL_RETRY_S) -> None:
        """Schedules a retry after a temporary refusal.

        Args:
            now: Time, seconds.
            delay_s: Time until the retry, seconds.
        """
        self.next_at = now + delay_s
        self._token = self._token if self._reliable else None

    def renew(self, now: float) -> "HandshakeAttempt":
        """Returns a new attempt for the same stream. Its nonce is a hash of the present nonce."""
        digest = hashlib.sha256(b"again" + self.nonce.to_bytes(8, "little")).digest()
        return HandshakeAttempt(
            int.from_bytes(digest[:8], "little"), now, self._name, reliable=self._reliable,
            scene_token=self._scene_token,
        )  # fmt: skip

    def _frame(self) -> bytes:
        if self._token is None:
            return encode(Hello(self.nonce, self._name))
        return encode(Request(self.nonce, self._token, self._name, self._scene_token))
