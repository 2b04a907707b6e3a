"""Server of many transfers as a state machine without socket and clock.

The caller passes received datagrams and the time, and gets datagrams to send.
"""

import heapq
import itertools
import logging
import traceback
from collections import Counter
from collections.abc import Callable, Hashable, Mapping
from pathlib import Path
from typing import TypeAlias

from splatwire.arguments import checked
from splatwire.errors import BitstreamError
from splatwire.transport.access import Access
from splatwire.transport.congestion.pacing import Pacer
from splatwire.transport.event_log import log_event
from splatwire.transport.protocol.admission import (
    Network,
    StartRateLimiter,
    choose_eviction,
    network_of,
    network_text,
)
from splatwire.transport.protocol.messages import (
    NEEDS_TOKEN,
    NOT_YET,
    REFUSALS,
    Bye,
    Challenge,
    Feedback,
    Have,
    Hello,
    Refuse,
    Request,
    ViewUpdate,
)
from splatwire.transport.protocol.send_queue import ViewUpdateBudget
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.protocol.server_limits import ServerLimits
from splatwire.transport.protocol.token import TokenMint
from splatwire.transport.protocol.transfer import PROBLEMS, ServerTransfer
from splatwire.transport.protocol.wire import (
    TO_SERVER,
    decode,
    encode,
    message_kind,
    refuse_other_transport,
    refuse_other_version,
)

LOG = logging.getLogger(__name__)
UNKNOWN_STREAM, SERVER_FULL, STOPPED, TOO_MANY = 1, 2, 3, 4

MAX_STARTS_FACTOR = 2
"""Number of transfers that a network (IPv4 address or IPv6 /64) may start within `admission.WINDOW_S`, as a multiple
of the allowed concurrent transfers; also the number of its refusals that are logged and answered with their own reason.
"""

MAX_UPDATE_STARTS_FACTOR = 150
"""Like `MAX_STARTS_FACTOR`, for transfers of updates: each client may request an update per second, and some of them
twice."""

Client: TypeAlias = Hashable
"""Identifies a client: its address or, with QUIC, the object of its session."""

TransferKey: TypeAlias = tuple[Client, int]
"""Key of a transfer: its client, and the random number (nonce) of the client's connection attempt."""


class Server:
    """Server of prepared streams to many clients, as a state machine without socket and clock.

    A client must first return a token to prove that it receives datagrams at its address.

    Args:
        streams: Prepared streams by name; a client that requests no name gets the first.
        secret: Secret key of the tokens, at least 16 random bytes.
        random: Function that returns a given number of random bytes, for the ids of transfers.
        limits: Limits on the transfers of clients.
        on_failure: Called with a client after an internal error has ended its transfer.

    Attributes:
        total_pacer: Pacer of all sent bytes together; None without a total limit.
        access: Access rules for private scenes; None if all scenes are public.
        draining: True to refuse new transfers, while running transfers continue.

    Raises:
        InvalidValueError: If the secret is too short.
    """

    @checked
    def __init__(
        self,
        streams: Mapping[str, ServedStream],
        *,
        secret: bytes,
        random: Callable[[int], bytes],
        limits: ServerLimits | None = None,
        on_failure: Callable[[Client], None] | None = None,
    ) -> None:
        self._streams = dict(streams)
        self._updates: dict[str, ServedStream | None] = {}
        self._mint = TokenMint(secret)
        self._random = random
        self._limits = limits or ServerLimits()
        total = self._limits.total_rate
        self.total_pacer = None if total is None else Pacer(total)
        self._on_failure = on_failure
        self._starts = StartRateLimiter(MAX_STARTS_FACTOR * self._limits.per_network)
        self._refusals = StartRateLimiter(MAX_STARTS_FACTOR * self._limits.per_network)
        self._update_starts = StartRateLimiter(MAX_UPDATE_STARTS_FACTOR * self._limits.per_network)
        self._transfers: dict[TransferKey, ServerTransfer] = {}
        self._networks: dict[TransferKey, Network] = {}
        self._sessions: dict[tuple[Client, int], TransferKey] = {}
        self._due: list[tuple[float, int, TransferKey]] = []
        self._planned: dict[TransferKey, float] = {}
        self._view_budget = ViewUpdateBudget()
        self._num_scheduled = 0
        self._swept_at = self._now = 0.0
        self.access: Access | None = None
        self.draining = False
        self.num_rejected = 0
        self.num_refused = 0
        self.num_served = 0
        self.num_failed = 0

    @property
    def num_transfers(self) -> int:
        """Number of active transfers."""
        return len(self._transfers)

    @property
    def num_streams(self) -> int:
        """Number of streams that clients can request."""
        return len(self._streams)

    def receive(
        self, client: Client, data: bytes, now: float, *, reliable: bool = False, network: Network | None = None
    ) -> bytes | None:
        """Processes a received datagram, which may be invalid, and returns the response.

        Args:
            client: The client: its address, or the session object for QUIC.
            data: Bytes of the datagram.
            now: Time, seconds.
            reliable: True for a QUIC connection, which needs no token.
            network: Network of the client, for limits per network; None derives the network from the address.

        Returns:
            Datagram to send to the client, or None.
        """
        self._now = now
        if message_kind(data) not in TO_SERVER:
            self.num_rejected += 1
            return refuse_other_version(data) or (None if reliable else refuse_other_transport(data))
        try:
            message = decode(data)
        except BitstreamError:
            self.num_rejected += 1
            return None
        try:
            return self._take(client, message, now, reliable, network)
        except Exception as error:  # a defect of the server must not end other clients' transfers
            self.fail(client, error)
            return None

    def _take(
        self, client: Client, message: object, now: float, reliable: bool, network: Network | None
    ) -> bytes | None:
        match message:
            # The response is smaller than the datagram, so that traffic to a forged address is not amplified.
            case Hello() if not reliable:
                return encode(Challenge(message.nonce, self._mint.token(client, message.nonce, message.name, now)))
            case Request():
                return self._on_request(
                    client, message, now, reliable, network_of(client) if network is None else network
                )
            case Have() if (client, message.nonce) in self._transfers:
                self._transfers[(client, message.nonce)].exclude_known(message)
                self._schedule((client, message.nonce))
            case Feedback() | ViewUpdate() | Bye():
                key = self._sessions.get((client, message.session))
                if key is not None:
                    self._on_client_message(key, message, now)
        return None

    def poll(self, now: float, max_datagrams: int = 64) -> list[tuple[Client, bytes]]:
        """Returns datagrams that are due, each with its client.

        Args:
            now: Time, seconds.
            max_datagrams: Maximum number of datagrams.
        """
        self._now = now
        self._end_silent(now)
        out: list[tuple[Client, bytes]] = []
        total = self.total_pacer
        while (
            self._due
            and len(out) < max_datagrams
            and self._due[0][0] <= now
            and (total is None or total.next_at() <= now)
        ):
            at, _, key = heapq.heappop(self._due)
            if self._planned.get(key) != at:
                continue
            del self._planned[key]
            try:
                data = self._transfers[key].poll(now)
                self._schedule(key)
            except Exception as error:  # a defect of the server must not end other clients' transfers
                self.fail(key[0], error)
                continue
            if data is not None:
                out.append((key[0], data))
                if total is not None:
                    total.sent(len(data), now)
        if total is not None:
            total.datagrams_wait = bool(self._due) and self._due[0][0] <= now
        return out

    def next_at(self) -> float | None:
        """Time of the next call of `poll`, seconds; None if nothing is scheduled."""
        if not self._due:
            return None
        return self._due[0][0] if self.total_pacer is None else max(self._due[0][0], self.total_pacer.next_at())

    def replace(
        self, streams: Mapping[str, ServedStream], updates: Mapping[str, ServedStream | None] | None = None
    ) -> None:
        """Replaces all streams for new transfers; running transfers continue with the old streams.

        Args:
            streams: Prepared streams by name; a client that requests no name gets the first.
            updates: Prepared streams of updates by name. An update contains later changes of a scene, and clients
                request it separately. None for an update that does not exist yet. Without this argument, there are no
                updates.
        """
        self._streams, self._updates = dict(streams), dict(updates or {})

    def set_stream(self, name: str, stream: ServedStream) -> None:
        """Adds a stream, or updates a live stream and notifies the clients that receive it.

        Args:
            name: Name of the stream.
            stream: Prepared stream, or the new state of a live stream.
        """
        old = self._streams.get(name)
        self._streams[name] = stream
        for key in [key for key, transfer in self._transfers.items() if transfer.stream is old]:
            if key not in self._transfers:  # it failed together with another transfer of the same client
                continue
            try:
                self._transfers[key].set_stream(stream)
                self._schedule(key)
            except Exception as error:  # a defect of the server must not end other clients' transfers
                self.fail(key[0], error)

    def fail(self, client: Client, error: Exception) -> None:
        """Ends a client's transfers after an internal error, and logs the error in one line.

        Args:
            client: The client.
            error: Exception that was raised.
        """
        self.num_failed += 1
        frames = traceback.extract_tb(error.__traceback__)
        source_line = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
        LOG.error("a transfer was ended by an error of the server: %s%s", " ".join(repr(error).split()), source_line)
        self.forget(client, "failed")
        if self._on_failure is not None:
            self._on_failure(client)

    def forget(self, client: Client, reason: str = "closed") -> None:
        """Ends all transfers to a client.

        Args:
            client: The client.
            reason: Reason for the log.
        """
        for key in [key for key in self._transfers if key[0] == client]:
            self._end_transfer(key, reason)

    def _on_request(
        self, client: Client, message: Request, now: float, reliable: bool, network: Network
    ) -> bytes | None:
        age = None if reliable else self._mint.age(message.token, client, message.nonce, message.name, now)
        if age is None and not reliable:
            self.num_rejected += 1
            return None
        key = (client, message.nonce)
        if key not in self._transfers:
            refusal = self._begin(key, message, now, reliable, network)
            if refusal is None:
                self._transfers[key].on_handshake_rtt(age)
                self._schedule(key)
            else:
                refusal = self._refused(network, message, refusal, now)
                return encode(Refuse(message.nonce, refusal)) if refusal else None
        transfer = self._transfers[key]
        if not transfer.may_welcome(now):
            return None
        return transfer.welcome()

    def _refused(self, network: Network, request: Request, refusal: int, now: float) -> int:
        """Counts and logs a refused request, and returns the reason to send to the client.

        Args:
            network: Network of the client.
            request: The refused request.
            refusal: Reason, as an index into `messages.REFUSALS`; 0 for a repeated request.
            now: Time, seconds.

        Returns:
            Index into `messages.REFUSALS`, or 0 for no response. After many refusals of a network, the result may be
            `TOO_MANY`.
        """
        if not refusal or (refusal == NOT_YET and request.name in self._updates):
            return refusal  # followers request the next update several times a second
        self.num_refused += 1
        # A network with too many refused requests is not logged any more.
        if not self._refusals.may_start(network, now):
            return TOO_MANY if refusal in (UNKNOWN_STREAM, NEEDS_TOKEN) else refusal
        self._refusals.record(network, request.nonce, now)
        text, reason = network_text(network), REFUSALS[refusal]
        log_event(LOG, logging.INFO, "transfer refused", client=text, stream=request.name, reason=reason)
        return refusal

    def _begin(self, key: TransferKey, message: Request, now: float, reliable: bool, network: Network) -> int | None:
        """Starts a transfer if the server's limits permit it.

        Returns:
            None for an accepted request. For a refused request, the reason: an index into `REFUSALS`, at least 1. 0 for
            a repeated request, to which no response is sent.
        """
        starts = self._update_starts if message.name in self._updates else self._starts
        if self._starts.has_started(network, key[1]) or self._update_starts.has_started(network, key[1]):
            self.num_rejected += 1
            return 0
        if self.draining:
            return STOPPED
        if not self._streams:  # a live stream before its first group
            return NOT_YET
        name = message.name or self._default_stream()
        if self.access is not None and self.access.refusal(name, message.scene_token, exists=name in self._streams):
            return NEEDS_TOKEN
        stream = self._streams.get(name) or self._updates.get(name)
        if stream is None:
            return NOT_YET if name in self._updates else UNKNOWN_STREAM
        num_transfers = Counter(self._networks.values())
        if num_transfers[network] >= self._limits.per_network or not starts.may_start(network, now):
            return TOO_MANY
        if len(self._transfers) >= self._limits.sessions:
            evicted = choose_eviction(+num_transfers, network)
            if evicted is None:
                return SERVER_FULL
            # The newest transfer of that network has received least.
            self._end_transfer(
                next(key for key, other in reversed(self._networks.items()) if other == evicted), "displaced"
            )
        session = self._new_session(key[0])
        self._transfers[key] = ServerTransfer(
            stream, session, self._limits, now, reliable_init_segment=reliable, nonce=key[1]
        )
        self._sessions[(key[0], session)], self._networks[key] = key, network
        starts.record(network, key[1], now)
        self.num_served += 1
        log_event(LOG, logging.INFO, "transfer started", client=network_text(network), stream=name, session=session)
        self._schedule(key)
        return None

    def _default_stream(self) -> str:
        """Returns the name of the stream for clients that request no name; empty if there is none."""
        if self.access is None:
            return next(iter(self._streams))
        listed = (name for name in self._streams if self.access.is_listed(name))
        private = (name for name in self._streams if name in self.access.private)
        return next(itertools.chain(listed, private), "")

    def _new_session(self, client: Client) -> int:
        while True:
            session = int.from_bytes(self._random(4), "little")
            if (client, session) not in self._sessions:
                return session

    def _on_client_message(self, key: TransferKey, message: Feedback | ViewUpdate | Bye, now: float) -> None:
        match message:
            case Bye():
                self._end_transfer(key, "left")
                return
            case ViewUpdate():
                self._transfers[key].on_view_update(message, self._view_budget, now)
            case Feedback():
                self._transfers[key].on_feedback(message, now)
                for problem in self._transfers[key].new_problems():
                    self._log_problem(key, problem)
        self._schedule(key)

    def _log_problem(self, key: TransferKey, problem: str) -> None:
        """Logs a problem of the path to a client, with advice; once for each transfer."""
        transfer = self._transfers[key]
        log_event(
            LOG, logging.WARNING, problem, client=network_text(self._networks[key]), session=transfer.session,
            lost=round(transfer.lost_share, 3), advice=PROBLEMS[problem],
        )  # fmt: skip

    def _schedule(self, key: TransferKey) -> None:
        """Schedules the next datagram of a transfer, or ends the transfer if its limits are reached."""
        transfer = self._transfers[key]
        at = transfer.next_at()
        if transfer.is_exhausted:
            self._end_transfer(key, "exhausted")
        elif at is None:
            self._planned.pop(key, None)
        elif self._planned.get(key) != at:
            # an earlier time stays in the heap, but has no effect when it is reached
            self._planned[key] = at
            self._num_scheduled += 1
            heapq.heappush(self._due, (at, self._num_scheduled, key))

    def _end_transfer(self, key: TransferKey, reason: str) -> None:
        """Removes a transfer and logs its end."""
        transfer, network = self._transfers.pop(key), self._networks.pop(key)
        del self._sessions[(key[0], transfer.session)]
        self._planned.pop(key, None)
        log_event(
            LOG, logging.INFO, "transfer ended", client=network_text(network), session=transfer.session, reason=reason,
            bytes=transfer.bytes_sent, seconds=round(self._now - transfer.began_at, 3),
        )  # fmt: skip

    def _end_silent(self, now: float) -> None:
        """Ends transfers whose clients have sent no datagram for longer than `ServerLimits.silence_s`."""
        if now - self._swept_at < 0.25:
            return
        self._swept_at = now
        for key in [k for k, t in self._transfers.items() if now - t.heard_at > self._limits.silence_s]:
            self._end_transfer(key, "silent")
        if len(self._due) > 4 * len(self._planned) + 64:
            self._due = [entry for entry in self._due if self._planned.get(entry[2]) == entry[0]]
            heapq.heapify(self._due)
