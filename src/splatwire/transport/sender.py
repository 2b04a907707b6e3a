"""The sending side: a server of many transfers. Bytes and time in, bytes out; no socket, no clock."""

import heapq
import logging
import traceback
from collections import Counter
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path

from splatwire.errors import BitstreamError
from splatwire.transport.admission import Network, Starts, makes_room, network_of
from splatwire.transport.frames import NOT_YET, Bye, Challenge, Feedback, Have, Hello, Refuse, Request, View
from splatwire.transport.order import Turns
from splatwire.transport.program import Program
from splatwire.transport.server_limits import ServerLimits
from splatwire.transport.token import TokenMint
from splatwire.transport.transfer import ServerTransfer
from splatwire.transport.wire import TO_SERVER, decode, encode, kind_of

LOG = logging.getLogger(__name__)
UNKNOWN_STREAM, SERVER_FULL, TOO_MANY = 1, 2, 4

STARTS = 2
"""Transfers that a network may begin within `WINDOW_S`, for each that it may have at once."""

Key = tuple[Hashable, int]
"""A transfer: address and nonce of the attempt."""


class Server:
    """Serves immutable programs to many clients.

    A client's address gets one small answer for each full-size greeting until it shows a token that was sent to it: it
    cannot be used to flood somebody else. Until then the server remembers nothing of it. A token begins one transfer.

    Args:
        programs: Streams by name; a client that gives no name gets the first.
        secret: At least 16 random bytes, for the tokens.
        random: Gives random bytes, for ids of sessions.
        limits: What the server spends on clients.
        on_failure: Called with the address of a client whose transfer was ended by an error of the server itself.

    An error while one client is served ends this client's transfer and is logged in one line; all others go on.

    Raises:
        InvalidValueError: If the secret is too short.
    """

    def __init__(
        self,
        programs: Mapping[str, Program],
        *,
        secret: bytes,
        random: Callable[[int], bytes],
        limits: ServerLimits | None = None,
        on_failure: Callable[[Hashable], None] | None = None,
    ) -> None:
        self._programs = dict(programs)
        self._mint = TokenMint(secret)
        self._random = random
        self._limits = limits or ServerLimits()
        self._on_failure = on_failure
        self._starts = Starts(STARTS * self._limits.per_network)
        self._transfers: dict[Key, ServerTransfer] = {}
        self._networks: dict[Key, Network] = {}
        self._sessions: dict[tuple[Hashable, int], Key] = {}
        self._due: list[tuple[float, int, Key]] = []
        self._planned: dict[Key, float] = {}
        self._turns = Turns()
        self._tick = 0
        self._swept_at = 0.0
        self.num_rejected = 0
        self.num_served = 0
        self.num_failed = 0

    @property
    def num_transfers(self) -> int:
        """Transfers that are going on."""
        return len(self._transfers)

    def receive(
        self, address: Hashable, data: bytes, now: float, *, reliable: bool = False, network: Network | None = None
    ) -> bytes | None:
        """Takes a datagram; anything at all may come.

        Args:
            address: Where it is from; equal addresses are the same client.
            data: Its bytes.
            now: Time, seconds.
            reliable: Whether it is from a session that carries greetings and side information reliably and has shown
                that the client reads what is sent to it (QUIC): no token is needed.
            network: What the client's transfers are counted by; None takes it from the address.

        Returns:
            An answer to the same address; to one that has shown no token, never larger than what came.
        """
        if kind_of(data) not in TO_SERVER:
            self.num_rejected += 1
            return None
        try:
            frame = decode(data)
        except BitstreamError:
            self.num_rejected += 1
            return None
        try:
            return self._take(address, frame, now, reliable, network)
        except Exception as error:  # a defect of the server, which must not end other clients' transfers
            self.fail(address, error)
            return None

    def _take(
        self, address: Hashable, frame: object, now: float, reliable: bool, network: Network | None
    ) -> bytes | None:
        match frame:
            case Hello() if not reliable:
                return encode(Challenge(frame.nonce, self._mint.token(address, frame.nonce, frame.name, now)))
            case Request():
                return self._requested(
                    address, frame, now, reliable, network_of(address) if network is None else network
                )
            case Have() if (address, frame.nonce) in self._transfers:
                self._transfers[(address, frame.nonce)].leave_out(frame)
                self._plan((address, frame.nonce))
            case Feedback() | View() | Bye():
                key = self._sessions.get((address, frame.session))
                if key is not None:
                    self._heard(key, frame, now)
        return None

    def poll(self, now: float, most: int = 64) -> list[tuple[Hashable, bytes]]:
        """Datagrams whose time has come, at most some; transfers take turns."""
        self._sweep(now)
        out: list[tuple[Hashable, bytes]] = []
        while self._due and len(out) < most and self._due[0][0] <= now:
            at, _, key = heapq.heappop(self._due)
            if self._planned.get(key) != at:
                continue
            del self._planned[key]
            try:
                data = self._transfers[key].poll(now)
                self._plan(key)
            except Exception as error:  # a defect of the server, which must not end other clients' transfers
                self.fail(key[0], error)
                continue
            if data is not None:
                out.append((key[0], data))
        return out

    def next_at(self) -> float | None:
        """When to call `poll` next; None if nothing is planned."""
        return self._due[0][0] if self._due else None

    def renew(self, name: str, program: Program) -> None:
        """Serves a program, or goes on with one that has grown: clients that have it are told."""
        old = self._programs.get(name)
        self._programs[name] = program
        for key in [key for key, transfer in self._transfers.items() if transfer.program is old]:
            if key not in self._transfers:  # it failed together with another one of the same address
                continue
            try:
                self._transfers[key].renew(program)
                self._plan(key)
            except Exception as error:  # a defect of the server, which must not end other clients' transfers
                self.fail(key[0], error)

    def fail(self, address: Hashable, error: Exception) -> None:
        """Ends the transfers of one client after an error of the server itself, and logs the error in one line.

        Args:
            address: Address of the client.
            error: The error.
        """
        self.num_failed += 1
        frames = traceback.extract_tb(error.__traceback__)
        place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
        LOG.error("a transfer was ended by an error of the server: %s%s", " ".join(repr(error).split()), place)
        self.forget(address)
        if self._on_failure is not None:
            self._on_failure(address)

    def forget(self, address: Hashable) -> None:
        """Ends what is sent to an address, e.g. because its session was closed."""
        for key in [key for key in self._transfers if key[0] == address]:
            self._forget(key)

    def _requested(
        self, address: Hashable, frame: Request, now: float, reliable: bool, network: Network
    ) -> bytes | None:
        age = None if reliable else self._mint.age(frame.token, address, frame.nonce, frame.name, now)
        if age is None and not reliable:
            self.num_rejected += 1
            return None
        key = (address, frame.nonce)
        if key not in self._transfers:
            refusal = self._begin(key, frame.name, now, reliable, network)
            if refusal is None:
                self._transfers[key].greeted(age)
                self._plan(key)
            else:
                return encode(Refuse(frame.nonce, refusal)) if refusal else None
        transfer = self._transfers[key]
        if not transfer.may_welcome(now):
            return None
        return transfer.welcome()

    def _begin(self, key: Key, name: str, now: float, reliable: bool, network: Network) -> int | None:
        """Begins a transfer; gives the reason of a refusal if there is one, 0 for none worth an answer."""
        if self._starts.seen(network, key[1]):
            self.num_rejected += 1
            return 0
        if not self._programs:  # what a stream that grows begins with
            return NOT_YET
        name = name or next(iter(self._programs))
        if name not in self._programs:
            return UNKNOWN_STREAM
        held = Counter(self._networks.values())
        if held[network] >= self._limits.per_network or not self._starts.allowed(network, now):
            return TOO_MANY
        if len(self._transfers) >= self._limits.sessions:
            full = makes_room(+held, network)
            if full is None:
                return SERVER_FULL
            # Its newest: least is lost by it.
            self._forget(next(key for key, other in reversed(self._networks.items()) if other == full))
        session = self._new_session(key[0])
        self._transfers[key] = ServerTransfer(
            self._programs[name], session, self._limits, now, reliable_head=reliable, nonce=key[1]
        )
        self._sessions[(key[0], session)], self._networks[key] = key, network
        self._starts.note(network, key[1], now)
        self.num_served += 1
        self._plan(key)
        return None

    def _new_session(self, address: Hashable) -> int:
        while True:
            session = int.from_bytes(self._random(4), "little")
            if (address, session) not in self._sessions:
                return session

    def _heard(self, key: Key, frame: Feedback | View | Bye, now: float) -> None:
        match frame:
            case Bye():
                self._forget(key)
                return
            case View():
                self._transfers[key].see(frame, self._turns, now)
            case Feedback():
                self._transfers[key].feedback(frame, now)
        self._plan(key)

    def _plan(self, key: Key) -> None:
        """Notes when a transfer has something to send next; entries of older plans are skipped when they come up."""
        transfer = self._transfers[key]
        at = transfer.next_at()
        if transfer.spent:
            self._forget(key)
        elif at is None:
            self._planned.pop(key, None)
        elif self._planned.get(key) != at:
            self._planned[key] = at
            self._tick += 1
            heapq.heappush(self._due, (at, self._tick, key))

    def _forget(self, key: Key) -> None:
        transfer = self._transfers.pop(key)
        del self._sessions[(key[0], transfer.session)], self._networks[key]
        self._planned.pop(key, None)

    def _sweep(self, now: float) -> None:
        """Forgets clients that said nothing for long."""
        if now - self._swept_at < 0.25:
            return
        self._swept_at = now
        for key in [k for k, t in self._transfers.items() if now - t.heard_at > self._limits.silence_s]:
            self._forget(key)
        if len(self._due) > 4 * len(self._planned) + 64:
            self._due = [entry for entry in self._due if self._planned.get(entry[2]) == entry[0]]
            heapq.heapify(self._due)
