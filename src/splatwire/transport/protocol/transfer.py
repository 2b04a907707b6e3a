"""Transfer of a stream to one client as a state machine without socket and clock.

The caller passes feedback and the time, and gets datagrams to send.
"""

import math
from collections import deque
from collections.abc import Iterator

from splatwire.arguments import checked
from splatwire.lazy_names import renamed_attributes
from splatwire.transport.congestion.cubic import INITIAL_WINDOW
from splatwire.transport.congestion.pacing import Pacer, RateControl
from splatwire.transport.protocol.feedback import FeedbackTracker, ReportedCounts
from splatwire.transport.protocol.known_packets import KnownPackets
from splatwire.transport.protocol.messages import End, Feedback, Have, ViewUpdate, Welcome
from splatwire.transport.protocol.send_queue import WELCOME_ITEM, SendQueue, SentLog, ViewUpdateBudget, viewpoint_of
from splatwire.transport.protocol.send_schedule import ScheduledDatagram
from splatwire.transport.protocol.served_stream import ServedStream
from splatwire.transport.protocol.server_limits import ServerLimits
from splatwire.transport.protocol.wire import (
    DATA,
    DATA_OVERHEAD,
    INIT_SYMBOL,
    INIT_SYMBOL_OVERHEAD,
    SMALL_MTU,
    WELCOME,
    encode,
    encode_data,
    encode_symbol,
)

END_INTERVAL_S = 0.1
"""Interval between closing datagrams, seconds. A closing datagram is an `End` (everything was sent). In a live stream,
every second one is the welcome: a client that lost the last welcome would not know the new sizes.
"""
NUM_FREQUENT_ENDS = 10
"""Number of closing datagrams at this interval, for clients that may still change their viewpoint."""
SLOW_END_INTERVAL_S = 1.0
"""Interval between later closing datagrams for these clients, seconds."""
WELCOME_INTERVAL_S = 0.15
"""Minimum interval between responses that accept a request (welcome), seconds. Clients repeat
requests after 0.2 s over UDP, pages after 20 ms."""
MAX_WELCOMES = 50
"""Maximum number of responses that accept a request (welcome): as many as the requests of a UDP client before it gives
up."""
RETRANSMIT_INTERVAL_S = 0.05
"""Minimum interval between retransmissions of a packet, seconds; at least one round-trip time."""
INIT_RESERVE_FACTOR = 1.3
"""Factor on the bytes reserved to retransmit missing init segment symbols: some retransmissions are lost too."""
SPARE_BYTES = 100_000
"""Number of bytes that may be sent to a client beyond `ServerLimits.max_sent_ratio`."""
MAX_SEQUENCE = (1 << 32) - 1
"""Maximum sequence number of a datagram (32 bits): enough for 23 days of a live sequence at 20 Mbit/s."""
MAX_TOKEN_AGE_S = 1.0
"""Maximum age of a client's token at which packets are sent before the first feedback, seconds."""
PROBE_AFTER_S, PROBE_INTERVAL_S = 1.0, 0.1
"""Time without a received datagram despite reports, seconds, after which the server sends probes, and their interval.
A probe is a small datagram (a welcome without preview). If only probes arrive, the path drops large datagrams.
"""
MIN_UNREPORTED = 8
"""Probes are sent if at least this many datagrams were sent after the last reported one. The log says that only small
datagrams arrive if at least this many large ones were lost.
"""
MIN_PROBES = 20
"""Number of probes after which the log says that nothing arrives."""
MIN_SMALL_ARRIVED = 10
"""Number of small datagrams that arrive one after another while all large ones are lost, from which on the path is
taken to drop large datagrams.
"""
MIN_LOSS, MIN_LOSS_DATAGRAMS = 0.5, 500
"""Minimum share of lost datagrams, and minimum number of reported ones, for the log line about a high rate."""
PROBLEMS = {
    "only small datagrams arrive": SMALL_MTU,
    "nothing arrives": f"the client's reports do; perhaps {SMALL_MTU}",
    "rate too high": "without --rate, the server adapts to the path",
}
"""Advice for the log about each problem of a path."""
MAX_REPORTS_S, MAX_REPORTS_AT_ONCE = 100.0, 100.0
"""Number of reports per second, and at once, whose requests for retransmission are processed. Receivers report 50 times
per second; the requests of a flood of reports would take ten times as long as the rest.
"""
FEEDBACK_TIMEOUT_S = 1.0
"""Time without feedback after which sending is suspended, seconds. Receivers report 50 times per second."""


class ServerTransfer:
    """Transfer of a stream to one client, with rate control and retransmission.

    Args:
        stream: Prepared stream to send.
        session: Id of the transfer.
        limits: Limits on the transfer, such as the maximum rate.
        now: Time, seconds.
        reliable_init_segment: True if the init segment is sent on a reliable (QUIC) stream.
        nonce: Random number of the client's connection attempt.
    """

    @checked
    def __init__(
        self, stream: ServedStream, session: int, limits: ServerLimits, now: float, *,
        reliable_init_segment: bool = False, nonce: int = 0,
    ) -> None:  # fmt: skip
        self.stream = stream
        self.session, self.nonce = session, nonce
        self.began_at = self.heard_at = now
        self.bytes_sent = 0
        self.control = RateControl(limits.start_rate, limits.rate, bounded=reliable_init_segment)
        self._limits = limits
        self._reliable_init_segment = reliable_init_segment
        self._queue = SendQueue(stream, reliable_init_segment)
        self._pacer = Pacer(limits.fixed_rate or self.control.rate)
        self._feedback_tracker = FeedbackTracker()
        self._sent_log = SentLog(stream.tiles is not None)
        self._view_update: ViewUpdate | None = None
        self._view_due_at: float | None = None
        self._may_send, self._has_reported, self._may_send_initial_window = reliable_init_segment, False, False
        self._retransmissions: deque[ScheduledDatagram] = deque()
        self._retransmitted_at: dict[ScheduledDatagram, float] = {}
        self._queued_retransmissions: set[ScheduledDatagram] = set()
        self._known_packets = KnownPackets()
        self._num_init_retransmissions = self._retransmitted_bytes = 0
        self._init_symbol_cursor = stream.num_proactive_symbols
        self._init_segment_sent_at: float | None = None
        self._end_at, self._num_closing_datagrams = 0.0, 0
        self._welcomed_at, self._num_welcomes = -WELCOME_INTERVAL_S, 0
        self._arrived_at, self._probed_at = now, -math.inf
        self._counts_before = ReportedCounts(0, 0, 0)
        self._num_small_arrived = self._num_large_lost = self._num_probes = 0
        self._problems, self._returned_problems = set[str](), set[str]()
        self._reports_left, self._reported_at = MAX_REPORTS_AT_ONCE, now
        self._max_bytes = SPARE_BYTES
        self._raise_byte_limit(0)

    __getattr__ = renamed_attributes("ServerTransfer", {"feedback": "on_feedback"})

    def welcome(self, *, preview: bool = True) -> bytes:
        """Returns the datagram that accepts the client's request and declares the sizes of the stream.

        Args:
            preview: False to leave the preview out, for a small datagram.
        """
        stream = self.stream
        leading = (
            self.nonce,
            self.session,
            stream.stream_id,
            stream.init_segment_bytes,
            stream.init_segment_digest,
            stream.symbol_bytes,
        )
        return encode(
            Welcome(
                *leading,
                len(stream.packets),
                stream.max_packet_bytes,
                stream.num_bundled,
                stream.parity_ranges,
                stream.preview if preview else b"",
                stream.is_live,
                stream.view_dependent,
            )
        )

    def set_stream(self, stream: ServedStream) -> None:
        """Continues with the new state of a live stream, or with a different stream.

        Args:
            stream: New state of the prepared live stream, or another prepared stream.
        """
        old, self.stream = self.stream, stream
        num_packets_before, retransmissions = len(old.packets), self._retransmissions
        if stream.stream_id != old.stream_id:
            self._queue = SendQueue(stream, self._reliable_init_segment)
            num_packets_before, retransmissions = 0, deque()
            self._known_packets, self._retransmitted_at = KnownPackets(), {}
            self._max_bytes = self.bytes_sent + SPARE_BYTES
        self._queue.set_stream(stream, self._reliable_init_segment, num_packets_before)
        self._retransmissions = deque(
            (kind, group, index)
            for kind, group, index in retransmissions
            if kind == DATA and stream.may_retransmit(index)
        )
        self._queued_retransmissions = set(self._retransmissions)
        self._num_init_retransmissions, self._init_segment_sent_at, self._init_symbol_cursor = (
            0,
            None,
            stream.num_proactive_symbols,
        )
        self._raise_byte_limit(num_packets_before)

    def _raise_byte_limit(self, num_packets_before: int) -> None:
        """Raises the maximum number of bytes for this client, because a live stream has grown.

        Args:
            num_packets_before: Number of packets of the stream before the growth.
        """
        self._max_bytes += int(self._limits.max_sent_ratio * self.stream.num_added_bytes(num_packets_before))

    def exclude_known(self, message: Have) -> None:
        """Records which packets the client already has. These are not sent, and the client's byte limit is lowered."""
        self._max_bytes -= int(self._limits.max_sent_ratio * self._known_packets.add(message, self.stream))

    def _take_next(self, now: float) -> ScheduledDatagram | None:
        """Removes datagrams from the queue up to the first one that the client needs, and returns this datagram.

        The result is None if the client needs no datagram of the queue.
        """
        while self._queue:
            item = self._queue.pop()
            if self._queue.popped_last_init_symbol:
                self._init_segment_sent_at = now
            if not self._known_packets.has(item, self.stream):
                return item
        return None

    def on_handshake_rtt(self, round_trip: float | None) -> None:
        """Sets the initial sending rate from the round-trip time of the handshake.

        Has no effect on a stream with levels of detail, or if the time is unknown or longer than `MAX_TOKEN_AGE_S`.

        Args:
            round_trip: Round-trip time, seconds; None if unknown.
        """
        if round_trip is not None and round_trip <= MAX_TOKEN_AGE_S and self.stream.tiles is None:  # wait for a view
            self.control.on_handshake_rtt(round_trip)
            self._pacer.rate, self._may_send_initial_window = self._limits.fixed_rate or self.control.rate, True

    @property
    def is_exhausted(self) -> bool:
        """True if this client's maximum number of bytes or datagrams has been sent."""
        return self.bytes_sent > self._max_bytes or self._feedback_tracker.sequence >= MAX_SEQUENCE

    def may_welcome(self, now: float) -> bool:
        """Returns True if the server may send its response to the request (welcome) now.

        A response that may be sent is counted as sent. The response is repeated until the client's first feedback
        report. There is a minimum interval between repetitions, and a maximum number of them.

        Args:
            now: Time, seconds.
        """
        if self._has_reported or now - self._welcomed_at < WELCOME_INTERVAL_S or self._num_welcomes == MAX_WELCOMES:
            return False
        self._welcomed_at, self._num_welcomes = now, self._num_welcomes + 1
        return True

    def next_at(self) -> float | None:
        """Returns the time of the next datagram, seconds; None if nothing may be sent now."""
        in_initial_window = (
            self._may_send_initial_window and not self._has_reported and self.bytes_sent < INITIAL_WINDOW
        )
        if self.is_exhausted or not (self._may_send or in_initial_window):
            return None
        is_pending = self._retransmissions or self._queue
        send_at = self._pacer.next_at() if is_pending else max(self._pacer.next_at(), self._end_at)
        return send_at if self._view_due_at is None else min(send_at, self._view_due_at)

    def poll(self, now: float) -> bytes | None:
        """Returns the next datagram to send if it is due at time `now` (seconds), else None."""
        if self._view_update is not None and self._view_due_at is not None and self._view_due_at <= now:
            self._queue.set_viewpoint(viewpoint_of(self._view_update), self._view_update.budget, now)
            self._view_due_at, self._num_closing_datagrams = None, 0
        due_at = self.next_at()
        if due_at is None or due_at > now:
            return None
        if now > self.heard_at + FEEDBACK_TIMEOUT_S:
            self._may_send = self._may_send_initial_window = False
            return None
        self._slow_down(now)
        if self._is_probe_due(now):
            self._probed_at, self._num_probes = now, self._num_probes + 1
            if self._num_probes >= MIN_PROBES:
                self._problems.add("nothing arrives")
            return self._record_sent(self.welcome(preview=False), now, sequenced=False)
        if self._retransmissions:
            item = self._retransmissions.popleft()
            self._on_retransmitted(item, now)
        elif (next_item := self._take_next(now)) is not None:
            item = next_item
        else:
            is_slow = self._queue.has_viewpoint and self._num_closing_datagrams > NUM_FREQUENT_ENDS
            interval = SLOW_END_INTERVAL_S if is_slow else END_INTERVAL_S
            self._end_at, self._num_closing_datagrams = now + interval, self._num_closing_datagrams + 1
            self._sent_log.record(self._feedback_tracker.sequence, -1)
            if self._num_closing_datagrams % 2 or not self.stream.is_live:
                return self._record_sent(encode(End(self.session, self._feedback_tracker.sequence)), now)
            item = WELCOME_ITEM
        kind, group, index = item
        if kind == WELCOME:
            return self._record_sent(self.welcome(), now, sequenced=False)
        is_on_stream = self._reliable_init_segment and kind == INIT_SYMBOL
        return self._record_sent(self._datagram(kind, group, index), now, sequenced=not is_on_stream)

    def on_view_update(self, message: ViewUpdate, budget: ViewUpdateBudget, now: float) -> None:
        """Schedules the processing of a client's viewpoint; an older viewpoint that is still waiting is dropped.

        Args:
            message: Received viewpoint.
            budget: Budget that limits the processing time for the viewpoints of all clients.
            now: Time, seconds.
        """
        tiles = self.stream.tiles
        if tiles is None or (self._view_update is not None and message.number <= self._view_update.number):
            return
        self._view_update = message
        if self._view_due_at is None:
            self._view_due_at = budget.take(now, self._queue.viewed_at, tiles.num_tiles)

    def on_feedback(self, message: Feedback, now: float) -> None:
        """Processes a feedback report of the client: sets the sending rate and queues retransmissions."""
        if not self._has_reported and self._num_welcomes:
            self.control.on_handshake_rtt(now - self._welcomed_at)
        self.heard_at, self._may_send, self._has_reported = now, True, True
        if self._feedback_tracker.is_plausible(message):
            sample = self._feedback_tracker.on_feedback(message, now)
            self._check_arrivals(now)
            if sample is not None:
                self.control.on_feedback(now, *sample)
                self._pacer.rate = self._limits.fixed_rate or self.control.rate
        gained = (now - self._reported_at) * MAX_REPORTS_S
        self._reports_left, self._reported_at = min(self._reports_left + gained, MAX_REPORTS_AT_ONCE), now
        if self._reports_left >= 1:
            self._reports_left -= 1
            self._queue_retransmissions(message, now)

    def new_problems(self) -> list[str]:
        """Returns the problems of the path that were found since the previous call, as keys of `PROBLEMS`.

        A problem is returned only once for each transfer.
        """
        new = sorted(self._problems - self._returned_problems)
        self._returned_problems |= self._problems
        return new

    @property
    def lost_share(self) -> float:
        """Share of the reported datagrams that were lost, 0 to 1."""
        num_sent, num_received, _ = self._feedback_tracker.reported_counts
        return 1 - min(num_received, num_sent) / num_sent if num_sent else 0.0

    def _check_arrivals(self, now: float) -> None:
        """Looks for problems of the path in a new report, and stores the problems that are found.

        One problem is a path that drops all large datagrams. The other is a fixed sending rate at which too many
        datagrams are lost.
        """
        counts, before = self._feedback_tracker.reported_counts, self._counts_before
        num_sent, num_received, num_large = (total - earlier for total, earlier in zip(counts, before, strict=True))
        self._counts_before = counts
        if num_received > 0:
            self._arrived_at, self._num_probes = now, 0
        # An `End` is small and arrives, while the retransmissions between two of them are lost.
        if num_received != num_sent - num_large:
            self._num_small_arrived = self._num_large_lost = 0
        elif num_large:
            self._num_large_lost += num_large if self._num_small_arrived else 0
            self._num_small_arrived += num_received
        if self._num_small_arrived >= MIN_SMALL_ARRIVED and self._num_large_lost >= MIN_UNREPORTED:
            self._problems.add("only small datagrams arrive")
        large_arrives = num_received > num_sent - num_large  # else the path may drop large datagrams at any rate
        is_significant = counts.num_sent >= MIN_LOSS_DATAGRAMS and self.lost_share > MIN_LOSS
        if self._limits.fixed_rate and large_arrives and is_significant:
            self._problems.add("rate too high")

    def _is_probe_due(self, now: float) -> bool:
        """True if a probe (the welcome without preview, a small datagram) should be sent now instead of a packet.

        This is the case if the client reports no arrivals, perhaps because the path drops large datagrams. A probe may
        still arrive. A client that gets only probes can report this cause.
        """
        num_unreported = self._feedback_tracker.sequence - self._feedback_tracker.reported_counts.num_sent
        if self._reliable_init_segment:  # a reliable stream repeats these, and delivers them after an outage
            return False
        if self.stream.is_live or not self._has_reported or num_unreported < MIN_UNREPORTED:
            return False
        stalled = min(now - self._arrived_at, now - self.began_at) > PROBE_AFTER_S
        return stalled and now - self._probed_at >= PROBE_INTERVAL_S

    def _slow_down(self, now: float) -> None:
        """Reduces the sending rate if the client's feedback is overdue."""
        if self._limits.fixed_rate is None and self._feedback_tracker.has_unreported:
            self.control.on_feedback_timeout(now)
            self._pacer.rate = self.control.rate

    def _on_retransmitted(self, item: ScheduledDatagram, now: float) -> None:
        """Records that a datagram was retransmitted.

        Args:
            item: The datagram.
            now: Time, seconds.
        """
        kind, _, _ = item
        if kind == INIT_SYMBOL:
            self._num_init_retransmissions -= 1
            self._init_segment_sent_at = now if self._num_init_retransmissions == 0 else None
        else:
            self._queued_retransmissions.discard(item)
            self._retransmitted_at[item] = now

    def _datagram(self, kind: int, group: int, index: int) -> bytes:
        """Returns the bytes of a datagram, and logs it as sent. The arguments are those of `ScheduledDatagram`."""
        sequence = self._feedback_tracker.sequence
        self._sent_log.record(sequence, index if kind == DATA else -1)
        if kind == DATA:
            return encode_data(self.session, sequence, index, self.stream.packets[index])
        symbols = self.stream.init_symbols if kind == INIT_SYMBOL else self.stream.parity
        return encode_symbol(kind, self.session, sequence, group, index, symbols[group][index])

    def _record_sent(self, data: bytes, now: float, *, sequenced: bool = True) -> bytes:
        """Records a datagram that is sent, and returns it.

        Args:
            data: The datagram.
            now: Time, seconds.
            sequenced: True if the datagram has a sequence number, on which the client gives feedback.
        """
        if sequenced:
            if not self._feedback_tracker.has_unreported:
                self.control.on_send(now)
            self._feedback_tracker.on_sent(len(data), now)
        self.bytes_sent += len(data)
        self._pacer.sent(len(data), now)
        return data

    def _queue_retransmissions(self, message: Feedback, now: float) -> None:
        """Queues the retransmissions that the client requests.

        Packets are queued until the stream's limit on retransmitted bytes is reached.
        """
        interval = max(RETRANSMIT_INTERVAL_S, 1.25 * (self.control.round_trip or 0.0))
        symbol_bytes = self.stream.symbol_bytes + INIT_SYMBOL_OVERHEAD
        missing = (
            0 if self._reliable_init_segment else min(message.symbols_missing, sum(map(len, self.stream.init_symbols)))
        )
        if missing and self._init_segment_sent_at is not None and now - self._init_segment_sent_at >= interval:
            items = self._further_init_symbols(missing)
            self._init_segment_sent_at, self._num_init_retransmissions = None, len(items)
            self._retransmitted_bytes += len(items) * symbol_bytes
            self._retransmissions.extendleft(items)
        bytes_left = (
            self.stream.max_retransmitted_bytes
            - self._retransmitted_bytes
            - INIT_RESERVE_FACTOR * missing * symbol_bytes
        )
        for index, sequence in self._nacked_packets(message):
            item = (DATA, 0, index)
            if index < 0 or not self.stream.may_retransmit(index):
                continue
            if item in self._queued_retransmissions:
                self._sent_log.discard(sequence)
                continue
            if now - self._retransmitted_at.get(item, -1e9) < interval:
                continue
            size = len(self.stream.packets[index]) + DATA_OVERHEAD
            if size > bytes_left:
                break
            bytes_left -= size
            self._retransmitted_bytes += size
            self._queued_retransmissions.add(item)
            self._retransmissions.append(item)
            self._sent_log.discard(sequence)

    def _nacked_packets(self, message: Feedback) -> Iterator[tuple[int, int | None]]:
        """Yields the packets that the client requests again in a feedback report (NACKs).

        Args:
            message: The feedback report.

        Yields:
            * For a request by packet index: this index, and None.
            * For a request by sequence number: the index of the packet in the lost datagram (-1 if unknown), and the
              sequence number.
        """
        yield from ((index, None) for index in message.nacks)
        for sequence in message.lost_sequences:
            yield self._sent_log.packet_index(sequence, self._feedback_tracker.sequence), sequence

    def _further_init_symbols(self, missing: int) -> list[ScheduledDatagram]:
        """Chooses further symbols of the init segment for a client that cannot decode it yet.

        Args:
            missing: Number of symbols that the client still needs.

        Returns:
            The symbols. There are more than `missing`, because some will be lost.
        """
        init_symbols = self.stream.init_symbols
        longest = max(map(len, init_symbols))
        # About 50 % more than are missing, because some will be lost; one more if retransmission is limited.
        count = min(missing + 1 if self.stream.limits_retransmission else missing + missing // 2 + 2, 512)
        items: list[ScheduledDatagram] = []
        while len(items) < count:
            symbol = self._init_symbol_cursor % longest
            items += [
                (INIT_SYMBOL, source_block, symbol)
                for source_block in range(len(init_symbols))
                if symbol < len(init_symbols[source_block])
            ]
            self._init_symbol_cursor += 1
        return items
