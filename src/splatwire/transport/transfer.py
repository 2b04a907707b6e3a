"""One client's transfer of a program: what leaves when. Bytes and time in, bytes out; no socket, no clock."""

from collections import deque

from splatwire.transport.cubic import INITIAL
from splatwire.transport.frames import End, Feedback, Have, View, Welcome
from splatwire.transport.held import Held
from splatwire.transport.order import Left, Order, Turns, look_of
from splatwire.transport.pacing import Pacer, RateControl
from splatwire.transport.program import Program
from splatwire.transport.reports import Reports
from splatwire.transport.server_limits import ServerLimits
from splatwire.transport.wire import (
    DATA,
    DATA_OVERHEAD,
    SIDE,
    SIDE_OVERHEAD,
    WELCOME,
    encode,
    encode_data,
    encode_symbol,
)

END_INTERVAL_S = 0.1
OFTEN, WAITING_S = 10, 1.0
"""So often it is said that all was sent; then, to one that may look elsewhere, now and then."""
WELCOME_S = 0.15
"""A welcome is not sent again within this time; a client asks again after 0.2 s."""
MOST_WELCOMES = 50
"""As often as a client asks before it gives up."""
RESEND_S = 0.05
"""A packet is not sent again within this time, or within a round trip if that is longer."""
HEAD_SAFETY = 1.3
"""Bytes kept free for symbols of the head object that a client lacks, over their own: some are lost again."""
SPARE_BYTES = 100_000
"""Beyond the passes of its program that a client may have."""
MOST_DATAGRAMS = (1 << 32) - 1
"""Their numbers have 32 bits: 23 days of a live clip at 20 Mbit/s."""
FRESH_S = 1.0
"""A client that shows its token after this time is sent nothing before it reports."""
QUIET_S = 1.0
"""Receivers report 50 times a second; one that was not heard for so long is sent nothing until it is heard again."""


class ServerTransfer:
    """One client's transfer of a program.

    Args:
        program: What is sent.
        session: Id of the transfer.
        limits: What it may spend.
        now: Time, seconds.
        reliable_head: Whether manifest and side information travel on a reliable stream (QUIC): each symbol leaves
            once, in its place of the same order, without redundancy, and does not count as a datagram.
        nonce: The client's name of its attempt.
    """

    def __init__(
        self, program: Program, session: int, limits: ServerLimits, now: float, *, reliable_head: bool = False,
        nonce: int = 0,
    ) -> None:  # fmt: skip
        self.program = program
        self.session, self.nonce = session, nonce
        self.heard_at = now
        self.bytes_sent = 0
        self.control = RateControl(limits.start_rate, limits.rate, bounded=reliable_head)
        self._limits = limits
        self._reliable_head = reliable_head
        self._order = Order(program, reliable_head)
        self._pacer = Pacer(limits.fixed_rate or self.control.rate)
        self._reports = Reports()
        self._left = Left(program.tiles is not None)
        self._view: View | None = None
        self._look_at: float | None = None
        self._heard, self._reported, self._opening = reliable_head, False, False
        self._again: deque[tuple[int, int, int]] = deque()
        self._sent_again: dict[tuple[int, int, int], float] = {}
        self._waiting: set[tuple[int, int, int]] = set()
        self._held = Held()
        self._head_waiting = self._again_bytes = 0
        self._head_cursor = program.head_reserve
        self._head_left_at: float | None = None
        self._end_at, self._ends = 0.0, 0
        self._welcomed_at, self._welcomes = -WELCOME_S, 0
        self._most_bytes = SPARE_BYTES
        self._allow(0)

    def welcome(self) -> bytes:
        """What the client is told of the program."""
        p = self.program
        head = (self.nonce, self.session, p.stream_id, p.head_bytes, p.head_digest, p.symbol_bytes)
        return encode(Welcome(*head, len(p.packets), p.packet_bytes, p.carried, p.tiers, p.preview))

    def renew(self, program: Program) -> None:
        """Goes on with a program that has grown: its head object at once, then what is left, then what is new.

        What is not worth sending any more (`Program.resends`) is left out, whether it waits to leave once or again. Of
        another stream all is new, and nothing is left of the one before.
        """
        old, self.program = self.program, program
        known, again = len(old.packets), self._again
        if program.stream_id != old.stream_id:
            self._order, known, again = Order(program, self._reliable_head), 0, deque()
            self._held, self._sent_again = Held(), {}
            self._most_bytes = self.bytes_sent + SPARE_BYTES
        self._order.renew(program, self._reliable_head, (WELCOME, 0, 0), known)
        self._again = deque(item for item in again if item[0] == DATA and program.resends(item[2]))
        self._waiting = set(self._again)
        self._head_waiting, self._head_left_at, self._head_cursor = 0, None, program.head_reserve
        self._allow(known)

    def _allow(self, known: int) -> None:
        """Lets the packets of the program that are new, and its head object, leave a few times."""
        told = sum(DATA_OVERHEAD + len(packet) for packet in self.program.packets[self.program.carried : known])
        self._most_bytes += int(self._limits.passes * (sum(self.program.sizes().values()) - told))

    def leave_out(self, frame: Have) -> None:
        """Takes what the client has: it does not leave by itself, nor is it a part of the client's share any more."""
        self._most_bytes -= int(self._limits.passes * self._held.take(frame, self.program))

    def _take_next(self, now: float) -> tuple[int, int, int] | None:
        """What comes next in the schedule and the client has not."""
        while self._order:
            item = self._order.pop()
            if self._order.head_left:
                self._head_left_at = now
            if not self._held.has(item[0], item[2]):
                return item
        return None

    def greeted(self, round_trip: float | None) -> None:
        """Takes how long the client took to show what was sent to it; None where nobody knows.

        Where that was a moment ago somebody is there: an initial window need not wait for a report.
        """
        if round_trip is not None and round_trip <= FRESH_S and self.program.tiles is None:  # a view comes first
            self.control.greeted(round_trip)
            self._pacer.rate, self._opening = self._limits.fixed_rate or self.control.rate, True

    @property
    def spent(self) -> bool:
        """Whether the client had its share."""
        return self.bytes_sent > self._most_bytes or self._reports.sequence >= MOST_DATAGRAMS

    def may_welcome(self, now: float) -> bool:
        """Whether a request is answered: not while the last answer may be under way, nor after the client reported."""
        if self._reported or now - self._welcomed_at < WELCOME_S or self._welcomes == MOST_WELCOMES:
            return False
        self._welcomed_at, self._welcomes = now, self._welcomes + 1
        return True

    def next_at(self) -> float | None:
        """When `poll` has something to send next.

        None before the first feedback, but for an initial window (over a session it need not wait), while the client
        is quiet, and once it had its share.
        """
        opening = self._opening and not self._reported and self.bytes_sent < INITIAL
        if self.spent or not (self._heard or opening):
            return None
        left = self._again or self._order
        sending = self._pacer.next_at() if left else max(self._pacer.next_at(), self._end_at)
        return sending if self._look_at is None else min(sending, self._look_at)

    def poll(self, now: float) -> bytes | None:
        """The next datagram, if its time has come."""
        if self._view is not None and self._look_at is not None and self._look_at <= now:
            self._order.look(look_of(self._view), self._view.budget, now)
            self._look_at, self._ends = None, 0
        at = self.next_at()
        if at is None or at > now:
            return None
        if now > self.heard_at + QUIET_S:
            self._heard = self._opening = False
            return None
        self._slow_down(now)
        if self._again:
            item = self._again.popleft()
            self._left_again(item, now)
        elif (found := self._take_next(now)) is not None:
            item = found
        else:
            waits = self._order.viewed and self._ends > OFTEN
            self._end_at, self._ends = now + (WAITING_S if waits else END_INTERVAL_S), self._ends + 1
            self._left.note(self._reports.sequence, -1)
            if self._ends % 2 or not self.program.open:
                return self._leave(encode(End(self.session, self._reports.sequence)), now)
            item = (WELCOME, 0, 0)
        if item[0] == WELCOME:
            return self._leave(self.welcome(), now, counted=False)
        return self._leave(self._datagram(*item), now, counted=not (self._reliable_head and item[0] == SIDE))

    def see(self, view: View, turns: Turns, now: float) -> None:
        """Takes where the client looks from, which has its turn to count; a newer one takes its place."""
        tiles = self.program.tiles
        if tiles is None or (self._view is not None and view.number <= self._view.number):
            return
        self._view = view
        if self._look_at is None:
            self._look_at = turns.take(now, self._order.looked_at, tiles.num_tiles)

    def feedback(self, frame: Feedback, now: float) -> None:
        """Takes what the client says arrived; counts that cannot be true do not move the rate."""
        if not self._reported and self._welcomes:
            self.control.greeted(now - self._welcomed_at)
        self.heard_at, self._heard, self._reported = now, True, True
        if self._reports.believable(frame):
            measured = self._reports.take(frame, now)
            if measured is not None:
                self.control.on_feedback(now, *measured)
                self._pacer.rate = self._limits.fixed_rate or self.control.rate
        self._ask_again(frame, now)

    def _slow_down(self, now: float) -> None:
        """Sends less and less while nothing is heard of what is under way, or nothing of it arrives."""
        if self._limits.fixed_rate is None and self._reports.awaited:
            self.control.silent(now)
            self._pacer.rate = self.control.rate

    def _left_again(self, item: tuple[int, int, int], now: float) -> None:
        """Notes when something leaves again: what waits to leave is not asked for once more."""
        if item[0] == SIDE:
            self._head_waiting -= 1
            self._head_left_at = now if self._head_waiting == 0 else None
        else:
            self._waiting.discard(item)
            self._sent_again[item] = now

    def _datagram(self, kind: int, group: int, symbol: int) -> bytes:
        self._left.note(self._reports.sequence, symbol if kind == DATA else -1)
        if kind == DATA:
            return encode_data(self.session, self._reports.sequence, symbol, self.program.packets[symbol])
        source = self.program.head if kind == SIDE else self.program.parity
        return encode_symbol(kind, self.session, self._reports.sequence, group, symbol, source[group][symbol])

    def _leave(self, data: bytes, now: float, *, counted: bool = True) -> bytes:
        if counted:
            if not self._reports.awaited:
                self.control.expect(now)
            self._reports.left(len(data), now)
        self.bytes_sent += len(data)
        self._pacer.sent(len(data), now)
        return data

    def _ask_again(self, frame: Feedback, now: float) -> None:
        """Queues what the client misses, unless it was sent again a moment ago, as far as the program's limit goes.

        The head object comes first: as long as the client lacks symbols of it, what they need is kept free.
        """
        wait = max(RESEND_S, 1.25 * (self.control.round_trip or 0.0))
        symbol_bytes = self.program.symbol_bytes + SIDE_OVERHEAD
        missing = 0 if self._reliable_head else min(frame.side_missing, sum(map(len, self.program.head)))
        if missing and self._head_left_at is not None and now - self._head_left_at >= wait:
            items = self._more_head(missing)
            self._head_left_at, self._head_waiting = None, len(items)
            self._again_bytes += len(items) * symbol_bytes
            self._again.extendleft(items)
        left = self.program.resend_bytes - self._again_bytes - HEAD_SAFETY * missing * symbol_bytes
        for number in frame.nacks:
            index = self._left.place(number, self._reports.sequence)
            item = (DATA, 0, index)
            if index < 0 or not self.program.resends(index):
                continue
            if item in self._waiting:
                self._left.answered(number)
                continue
            if now - self._sent_again.get(item, -1e9) < wait:
                continue
            size = len(self.program.packets[index]) + DATA_OVERHEAD
            if size > left:
                break
            left -= size
            self._again_bytes += size
            self._waiting.add(item)
            self._again.append(item)
            self._left.answered(number)

    def _more_head(self, missing: int) -> list[tuple[int, int, int]]:
        """Symbols of all segments in turn, somewhat more of them than are missing unless bytes are counted.

        The reserve first, every symbol of which is news to the client; of those that were sent it has most.
        """
        head = self.program.head
        longest = max(map(len, head))
        count = min(missing + 1 if self.program.counts_bytes else missing + missing // 2 + 2, 512)
        items: list[tuple[int, int, int]] = []
        while len(items) < count:
            symbol = self._head_cursor % longest
            items += [(SIDE, segment, symbol) for segment in range(len(head)) if symbol < len(head[segment])]
            self._head_cursor += 1
        return items
