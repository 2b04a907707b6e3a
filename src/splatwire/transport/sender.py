"""The sending side: one transfer, and a server of many. Bytes and time in, bytes out; no socket, no clock."""

import heapq
from collections import deque
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass

from splatwire.errors import BitstreamError
from splatwire.transport.pacing import MAX_RATE, START_RATE, Pacer, RateControl
from splatwire.transport.program import Program
from splatwire.transport.token import TokenMint
from splatwire.transport.wire import (
    DATA,
    SIDE,
    TO_SERVER,
    Bye,
    Challenge,
    End,
    Feedback,
    Hello,
    Refuse,
    Request,
    Welcome,
    decode,
    encode,
    encode_data,
    encode_symbol,
    kind_of,
)

UNKNOWN_STREAM, SERVER_FULL = 1, 2
END_INTERVAL_S = 0.1
RESEND_S = 0.05
"""A packet is not sent again within this time, or within a round trip if that is longer."""
RECENT = 8192
"""Datagrams whose sending time is remembered."""


@dataclass(frozen=True)
class ServerLimits:
    """What a server spends on clients.

    Attributes:
        sessions: Transfers at once.
        silence_s: A client that says nothing for so long is forgotten, seconds.
        rate: Most bytes per second to one client.
        start_rate: Bytes per second before the first feedback.
        fixed_rate: Bytes per second to every client, whatever it reports; None adapts.
        passes: A client gets at most this many times the bytes of one complete pass.
    """

    sessions: int = 256
    silence_s: float = 5.0
    rate: float = MAX_RATE
    start_rate: float = START_RATE
    fixed_rate: float | None = None
    passes: float = 4.0


Key = tuple[Hashable, int]
"""A transfer: address and nonce of the attempt."""


class Transfer:
    """One client's transfer of a program.

    Args:
        program: What is sent.
        session: Id of the transfer.
        limits: What it may spend.
        now: Time, seconds.
    """

    def __init__(self, program: Program, session: int, limits: ServerLimits, now: float) -> None:
        self.program = program
        self.session = session
        self.heard_at = now
        self.bytes_sent = 0
        self.control = RateControl(limits.start_rate, limits.rate)
        self._limits = limits
        self._pacer = Pacer(limits.fixed_rate or self.control.rate)
        self._next = 0
        self._sequence = 0
        self._heard = False
        self._again: deque[tuple[int, int, int]] = deque()
        self._sent_again: dict[tuple[int, int, int], float] = {}
        self._sent_times: deque[tuple[int, float]] = deque(maxlen=RECENT)
        self._last: Feedback | None = None
        self._head_cursor = 0
        self._end_at = 0.0
        self._most_bytes = int(limits.passes * sum(program.sizes().values())) + 100_000

    def next_at(self) -> float | None:
        """When `poll` has something to send next; None before the first feedback, and once the client had its share."""
        if self.bytes_sent > self._most_bytes or not self._heard:
            return None
        if self._again or self._next < len(self.program.schedule):
            return self._pacer.next_at()
        return max(self._pacer.next_at(), self._end_at)

    def poll(self, now: float) -> bytes | None:
        """The next datagram, if its time has come."""
        at = self.next_at()
        if at is None or at > now:
            return None
        if self._again:
            item = self._again.popleft()
        elif self._next < len(self.program.schedule):
            item = self.program.schedule[self._next]
            self._next += 1
        else:
            self._end_at = now + END_INTERVAL_S
            return self._leave(encode(End(self.session, self._sequence)), now)
        return self._leave(self._datagram(*item), now)

    def feedback(self, frame: Feedback, now: float) -> None:
        """Takes what the client says arrived; counts that cannot be true do not move the rate."""
        last = self._last
        believable = frame.received <= frame.largest + 1 and frame.largest < max(self._sequence, 1)
        if last is not None:
            believable = believable and frame.largest >= last.largest and frame.received >= last.received
        self.heard_at, self._heard = now, True
        if believable:
            self._measure(frame, now)
        self._ask_again(frame, now)

    def _datagram(self, kind: int, group: int, symbol: int) -> bytes:
        if kind == DATA:
            return encode_data(self.session, self._sequence, symbol, self.program.packets[symbol])
        source = self.program.head if kind == SIDE else self.program.parity
        return encode_symbol(kind, self.session, self._sequence, group, symbol, source[group][symbol])

    def _leave(self, data: bytes, now: float) -> bytes:
        self._sent_times.append((self._sequence, now))
        self._sequence += 1
        self.bytes_sent += len(data)
        self._pacer.sent(len(data), now)
        return data

    def _measure(self, frame: Feedback, now: float) -> None:
        """Feeds the rate control with what happened since the last feedback."""
        times, last = self._sent_times, self._last
        if last is not None and frame.largest == last.largest:
            return
        while times and times[0][0] < frame.largest:
            times.popleft()
        if not times or times[0][0] != frame.largest:
            self._last = frame
            return
        round_trip = now - times[0][1]
        if last is not None:
            sent, arrived = frame.largest - last.largest, frame.received - last.received
            seconds = ((frame.time_us - last.time_us) & 0xFFFFFFFF) / 1e6
            mean = self.bytes_sent / max(self._sequence, 1)
            self.control.on_feedback(now, round_trip, sent, min(arrived, sent), arrived * mean, seconds)
        self._last = frame
        if self._limits.fixed_rate is None:
            self._pacer.rate = self.control.rate

    def _ask_again(self, frame: Feedback, now: float) -> None:
        """Queues what the client misses, unless it was sent again a moment ago."""
        wait = max(RESEND_S, 1.25 * (self.control.round_trip or 0.0))
        for index in frame.nacks:
            item = (DATA, 0, index)
            if index < len(self.program.packets) and now - self._sent_again.get(item, -1e9) >= wait:
                self._sent_again[item] = now
                self._again.append(item)
        everything_sent = self._next >= len(self.program.schedule)
        if not frame.side_missing or not everything_sent or now - self._sent_again.get((SIDE, 0, 0), -1e9) < wait:
            return
        self._sent_again[(SIDE, 0, 0)] = now
        self._again.extendleft(self._more_head(frame.side_missing))

    def _more_head(self, missing: int) -> list[tuple[int, int, int]]:
        """Symbols of all segments in turn, going round, somewhat more of them than are missing."""
        head = self.program.head
        longest = max(map(len, head))
        count = min(missing + missing // 2 + 2, 512)
        items: list[tuple[int, int, int]] = []
        while len(items) < count:
            symbol = self._head_cursor % longest
            items += [(SIDE, segment, symbol) for segment in range(len(head)) if symbol < len(head[segment])]
            self._head_cursor += 1
        return items


class Server:
    """Serves immutable programs to many clients.

    A client's address gets one small answer for each full-size greeting until it shows a token that was sent to it: it
    cannot be used to flood somebody else. Until then the server remembers nothing of it.

    Args:
        programs: Streams by name; a client that gives no name gets the first.
        secret: At least 16 random bytes, for the tokens.
        random: Gives random bytes, for ids of sessions.
        limits: What the server spends on clients.

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
    ) -> None:
        self._programs = dict(programs)
        self._mint = TokenMint(secret)
        self._random = random
        self._limits = limits or ServerLimits()
        self._transfers: dict[Key, Transfer] = {}
        self._sessions: dict[tuple[Hashable, int], Key] = {}
        self._due: list[tuple[float, int, Key]] = []
        self._planned: dict[Key, float] = {}
        self._tick = 0
        self._swept_at = 0.0
        self.num_rejected = 0
        self.num_served = 0

    @property
    def num_transfers(self) -> int:
        """Transfers that are going on."""
        return len(self._transfers)

    def receive(self, address: Hashable, data: bytes, now: float) -> bytes | None:
        """Takes a datagram; anything at all may come.

        Args:
            address: Where it is from; equal addresses are the same client.
            data: Its bytes.
            now: Time, seconds.

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
        match frame:
            case Hello():
                return encode(Challenge(frame.nonce, self._mint.token(address, frame.nonce, frame.name, now)))
            case Request():
                return self._requested(address, frame, now)
            case Feedback() | Bye():
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
            data = self._transfers[key].poll(now)
            if data is not None:
                out.append((key[0], data))
            self._plan(key)
        return out

    def next_at(self) -> float | None:
        """When to call `poll` next; None if nothing is planned."""
        return self._due[0][0] if self._due else None

    def _requested(self, address: Hashable, frame: Request, now: float) -> bytes | None:
        if not self._mint.valid(frame.token, address, frame.nonce, frame.name, now):
            self.num_rejected += 1
            return None
        key = (address, frame.nonce)
        transfer = self._transfers.get(key)
        if transfer is None:
            name = frame.name or next(iter(self._programs), "")
            if name not in self._programs:
                return encode(Refuse(frame.nonce, UNKNOWN_STREAM))
            if len(self._transfers) >= self._limits.sessions:
                return encode(Refuse(frame.nonce, SERVER_FULL))
            session = self._new_session(address)
            transfer = Transfer(self._programs[name], session, self._limits, now)
            self._transfers[key], self._sessions[(address, session)] = transfer, key
            self.num_served += 1
            self._plan(key)
        program = transfer.program
        return encode(
            Welcome(
                frame.nonce, transfer.session, program.stream_id, program.head_bytes, program.head_digest,
                program.symbol_bytes, len(program.packets), program.packet_bytes, program.tiers,
            )
        )  # fmt: skip

    def _new_session(self, address: Hashable) -> int:
        while True:
            session = int.from_bytes(self._random(4), "little")
            if (address, session) not in self._sessions:
                return session

    def _heard(self, key: Key, frame: Feedback | Bye, now: float) -> None:
        if isinstance(frame, Bye):
            self._forget(key)
            return
        self._transfers[key].feedback(frame, now)
        self._plan(key)

    def _plan(self, key: Key) -> None:
        """Notes when a transfer has something to send next; entries of older plans are skipped when they come up."""
        at = self._transfers[key].next_at()
        if at is None:
            self._planned.pop(key, None)
        elif self._planned.get(key) != at:
            self._planned[key] = at
            self._tick += 1
            heapq.heappush(self._due, (at, self._tick, key))

    def _forget(self, key: Key) -> None:
        transfer = self._transfers.pop(key)
        del self._sessions[(key[0], transfer.session)]
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
