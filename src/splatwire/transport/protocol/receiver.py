"""Receiver of one stream as a state machine without socket and clock.

The caller passes received datagrams and the time, and gets datagrams to send and events.
"""

import itertools
import math

from splatwire.arguments import checked
from splatwire.bitstream.origin import AT_ZERO, ORIGIN_SECTION
from splatwire.bitstream.tile_selection import BUDGET, Viewpoint
from splatwire.errors import BitstreamError
from splatwire.transport.protocol.collect import check_welcome, read_init_segment
from splatwire.transport.protocol.events import (
    Event,
    Finished,
    Interrupted,
    NotBegun,
    PacketArrived,
    Resumed,
    SideInfoArrived,
    StreamReplaced,
    Welcomed,
)
from splatwire.transport.protocol.gap_tracker import GapTracker
from splatwire.transport.protocol.handshake import RETRY_S, WAIT_S, HandshakeAttempt
from splatwire.transport.protocol.messages import (
    NEEDS_TOKEN,
    NOT_YET,
    OTHER_TRANSPORT,
    OTHER_VERSION,
    REFUSALS,
    Bye,
    Challenge,
    Data,
    End,
    Feedback,
    Have,
    InitSymbol,
    Message,
    Parity,
    Refuse,
    ViewUpdate,
    Welcome,
)
from splatwire.transport.protocol.nack import MAX_NACK_ATTEMPTS, NackTracker
from splatwire.transport.protocol.receive_state import ReceiveState
from splatwire.transport.protocol.receiver_options import ReceiverOptions
from splatwire.transport.protocol.wire import MAX_DATAGRAM, SMALL_MTU, decode, encode

CONNECT_TIMEOUT_S = 10.0
"""Time after which an unanswered handshake fails, seconds."""
RECONNECT_AFTER_S = 3.0
"""Silence after which the client repeats the handshake, seconds: the client's or the server's address may have
changed.
"""
MAX_FRUITLESS_TRANSFERS = 5
"""Maximum number of consecutive transfers without new packets before the client gives up."""
NUM_HAVE_REPEATS, HAVE_INTERVAL_S = 3, 0.3
"""Number of repetitions, and interval in seconds, of the list of received packets that a client sends when it resumes a
transfer. Repetition covers losses.
"""
MISSING_STREAM = 1
"""Index in `messages.REFUSALS` of the refusal that the requested stream does not exist."""
ATTEMPT_TIMEOUT_S = 4.0
"""Time after which a connection attempt gets a new nonce, seconds: a server starts only one transfer per nonce."""
NO_UDP = "nothing seems to serve UDP there (`serve` with --page or --quic has a quic:// address)"
NO_QUIC = "nothing seems to serve QUIC there (`serve` without --page and --quic has a udp:// address)"
FEEDBACK_INTERVAL_S = 0.02
"""Interval between feedback datagrams, which contain the NACKs, seconds."""
REORDER_THRESHOLD = 48
"""Reordering threshold: packets this far behind the furthest received one count as lost."""
MAX_SEQUENCE_JUMP = 1 << 17
"""Maximum increase of the sequence number from one datagram to the next; with a larger increase, the datagram is forged
and rejected.
"""
GRACE_S = 0.15
"""Time that the receiver waits for late packets after the server has sent everything, seconds."""
FAST_RETRY_PERIOD_S = 2.0
"""Time from the first request for an announced stream in which requests follow each other fast, seconds."""
NUM_BYES = 3
VIEW_INTERVAL_S, VIEW_REPEAT_S, NUM_IMMEDIATE_VIEWS = 0.1, 1.0, 2
"""Interval at which a new viewpoint is sent to the server, later interval for an unchanged viewpoint (both in seconds),
and number of datagrams at the short interval. Repetition covers losses.
"""
VIEW_CORRECTION_S = 2.0
"""Time after the viewpoint was corrected by the stream's origin, seconds, in which an `End` datagram may still refer to
the uncorrected viewpoint.
"""
IDLE_S = 1.0
"""Time after everything visible was received from which on the receiver sends reports less often, seconds."""
MAX_FRUITLESS_S = 60.0
"""Time after which the receiver gives up if the server sends datagrams, but nothing new, seconds."""
MAX_FRUITLESS_ENDS = 25
"""Number of consecutive `End` datagrams without data, despite NACKs, from which the receiver concludes that the server
will not retransmit (`Protection.retransmit_share`). The server sends ten per second, so round-trip times up to 2.5 s
are covered.
Also the number of small datagrams without data after which the path is taken to drop large ones.
"""
MIN_END_SPACING_S, MAX_END_SPACING_S = 0.05, 0.5
"""Minimum time between two `End` datagrams that are both counted, seconds: after an outage, QUIC delivers many at once.
After a longer time than the maximum, losses are counted anew, because an outage loses datagrams of every size.
"""
SUSPECT_ENDS, MAX_SMALL_NACKS = 5, 100
"""Number of consecutive `End` datagrams without data from which on reports are small, and their maximum number of
NACKs. The path may drop large datagrams in both directions.
"""
MAX_LOST_RATIO = 2
"""Maximum number of lost datagrams for each small one that arrives; beyond it, the path is taken to drop large ones."""
SILENT = "the server fell silent"
MIN_QUIC_PACKETS = 100
"""Minimum number of small packets of QUIC since the last message of a silent server. The packets acknowledge the
client's reports, so that the path works for small packets.
"""
MIN_LOSS, MIN_LOSS_DATAGRAMS = 0.4, 100
"""Minimum share of lost datagrams, and minimum number of sent datagrams, for a message about high loss."""


class Receiver(ReceiveState):
    """Receiver of one stream as a state machine without socket and clock.

    Call `receive` for every datagram and `poll` at the times of `next_at`; both return datagrams to send and events.

    Args:
        nonce: Random 64-bit number that identifies this connection attempt.
        now: Time, seconds.
        options: Options of the receiver, such as the name of the stream.
        reliable: True for a QUIC connection.
    """

    @checked
    def __init__(
        self, nonce: int, now: float, options: ReceiverOptions | None = None, *, reliable: bool = False
    ) -> None:
        super().__init__()
        self.options = options or ReceiverOptions()
        self._nonce = nonce
        self._began_at = self._connecting_since = self._heard_at = self._feedback_at = now
        self._reliable = reliable
        self._last_attempt = HandshakeAttempt(
            nonce, now, self.options.name, reliable=reliable, scene_token=self.options.scene_token
        )
        self._attempt: HandshakeAttempt | None = self._last_attempt
        self._refusal = ""
        self._connected = self._has_begun_waiting = self._is_wait_interrupted = False
        self._num_sent_before = self._num_received_before = 0
        self._largest_sequence, self._num_received = -1, 0
        self._at_last_data = 0, 0
        self._num_quic_packets = 0
        self._view_update: ViewUpdate | None = None
        self._viewpoint: tuple[Viewpoint, int] | None = None
        self._moved_at = -math.inf
        self._view_number, self._view_at = 0, -math.inf
        self._have_frames: list[bytes] = []
        self._have_repeats_left, self._have_at = 0, now
        self._fruitless_transfers, self._num_packets_before = 0, 0
        self._largest_datagram = 0
        self._begin_session(now)
        self._stream_before: int | None = None
        if self.options.viewpoint is not None:
            self.set_viewpoint(self.options.viewpoint)

    def next_at(self) -> float | None:
        """Time at which `poll` must be called next, seconds; None after the end of the transfer."""
        if self.finished:
            return None
        end = math.inf if self.options.deadline_s is None else self._began_at + self.options.deadline_s
        attempt = math.inf if self._attempt is None else self._attempt.next_at
        if self._is_waiting and not self._is_wait_interrupted:
            attempt = min(attempt, self._connecting_since + RECONNECT_AFTER_S)
        return min(attempt, math.inf if self._welcome is None else self._feedback_at, end)

    def poll(self, now: float) -> tuple[list[bytes], list[Event]]:
        """Performs the actions that are due at time `now` (seconds): handshake, feedback, timeouts.

        Returns:
            Datagrams to send, and events.
        """
        if self.finished:
            return [], []
        if reason := self._end_reason(now):
            return self._finish(reason)
        events: list[Event] = []
        if self._is_silent(now):
            events = self.reconnect(now)
        elif self._is_waiting and now >= self._connecting_since + RECONNECT_AFTER_S:
            events = self._interrupt_wait()
        handshake = self._attempt.poll(now) if self._attempt is not None else []
        if self._welcome is None or now < self._feedback_at:
            return handshake, events
        return [*handshake, *self._received_lists(now), self._feedback(now), *self._viewpoint_datagrams(now)], events

    def receive(self, data: bytes, now: float) -> tuple[list[bytes], list[Event]]:
        """Processes a received datagram, which may be invalid.

        Args:
            data: Bytes of the datagram.
            now: Time, seconds.

        Returns:
            Datagrams to send, and events.
        """
        if self.finished:
            return [], []
        try:
            message = decode(data)
        except BitstreamError:
            self.num_rejected += 1
            return [], []
        self.num_bytes += len(data)
        self._num_quic_packets = 0
        self._largest_datagram = (
            len(data) if self._welcome is not None and len(data) > self._largest_datagram else self._largest_datagram
        )
        if isinstance(message, (InitSymbol, Data, Parity, End)):
            return self._transferred(message, now)
        return self._on_handshake(message, now)

    def set_viewpoint(self, viewpoint: Viewpoint, budget: int = BUDGET) -> None:
        """Sets the viewpoint, so that the server sends visible packets first.

        Has no effect on streams without levels of detail.

        Args:
            viewpoint: Viewpoint, in coordinates relative to its own origin, which may differ from the stream's origin.
            budget: Maximum number of Gaussians that are rendered.

        Raises:
            BitstreamError: If the received side information is damaged.
        """
        self._viewpoint = viewpoint, budget
        viewpoint = self._relative_to_origin(viewpoint)
        rows = tuple(viewpoint.viewmat[:3].ravel().tolist())
        self._view_number, self._view_repeats = self._view_number + 1, 0
        self._view_update = ViewUpdate(
            0, self._view_number, budget, viewpoint.width, viewpoint.height, viewpoint.focal, rows
        )
        self._feedback_at = min(self._feedback_at, self._heard_at)

    def reconnect(self, now: float) -> list[Event]:
        """Starts a new connection attempt that keeps all received data.

        Args:
            now: Time, seconds.

        Returns:
            Event `Interrupted` if the transfer, or the wait for a stream that has not begun, was not interrupted yet.
        """
        events: list[Event] = self._interrupt_wait() if self._is_waiting else []
        if self._attempt is None:
            events = [Interrupted()]
        self._attempt = self._last_attempt = self._last_attempt.renew(now)
        return events

    def may_resume(self, now: float) -> bool:
        """True if an interrupted transfer, or an interrupted wait for a stream that has not begun, may still go on.

        Args:
            now: Time, seconds.
        """
        if self._welcome is None and not self._has_begun_waiting:
            return False
        heard_at = self._connecting_since if self._welcome is None else self._heard_at
        return self.finished is None and now - heard_at <= self.options.reconnect_s

    @property
    def _is_waiting(self) -> bool:
        """True if the server has announced the stream, and the receiver waits for its first data."""
        return self._welcome is None and self._has_begun_waiting

    def _interrupt_wait(self) -> list[Event]:
        """Records that the server does not answer a waiting receiver; returns the event, none if this was known."""
        events: list[Event] = [] if self._is_wait_interrupted else [Interrupted()]
        self._is_wait_interrupted = True
        return events

    def _resume_wait(self) -> list[Event]:
        """Records that the server answers a waiting receiver; returns `Resumed` if it had been reported as gone."""
        events: list[Event] = [Resumed(True)] if self._is_wait_interrupted else []
        self._is_wait_interrupted = False
        return events

    def may_connect(self, now: float) -> bool:
        """True if a new connection may be tried before the first response of the server.

        Args:
            now: Time, seconds.
        """
        within = now - self._connecting_since <= CONNECT_TIMEOUT_S
        return self.finished is None and self._welcome is None and within

    def on_connected(self, now: float) -> None:
        """Records that a QUIC connection to the server was established.

        Args:
            now: Time, seconds.
        """
        if not self._connected:
            self._connected, self._connecting_since = True, now

    def on_quic_packet(self, num_bytes: int) -> None:
        """Records the arrival of a QUIC packet, even one without a message of the server.

        Args:
            num_bytes: Size of the packet, bytes.
        """
        self._num_quic_packets += num_bytes < MAX_DATAGRAM // 2

    def describe_missing(self) -> str:
        """Returns a message about missing data, with a likely cause if many datagrams were lost.

        Before the server accepts the request, nothing is known about missing data. The message is then empty, unless
        the server has refused the request because the stream has not begun.
        """
        if self._welcome is None:
            return "the stream has not begun" if self._has_begun_waiting else ""
        # Small datagrams that arrive after the last data say nothing about the rate.
        sent, received = (
            self._num_sent_before + self._at_last_data[0],
            self._num_received_before + self._at_last_data[1],
        )
        text = super().describe_missing()
        reason = "" if self.finished is None else self.finished.reason
        has_other_cause = SMALL_MTU in reason or reason.startswith(SILENT)
        if has_other_cause or sent < MIN_LOSS_DATAGRAMS or received > (1 - MIN_LOSS) * sent:
            return text
        return (
            f"{text}; {1 - received / sent:.0%} of the datagrams were lost: a server with --rate may send faster than "
            "the path carries, without --rate it adapts"
        )

    def stop(self, reason: str = "stopped") -> tuple[list[bytes], list[Event]]:
        """Ends the transfer and keeps all received data.

        Args:
            reason: Reason to report in `Finished.reason`.

        Returns:
            Datagrams to send, and events.
        """
        return ([], []) if self.finished else self._finish(reason)

    def _on_handshake(self, message: Message, now: float) -> tuple[list[bytes], list[Event]]:
        """Processes a handshake datagram of the server; returns datagrams to send, and events."""
        nonce, attempt = getattr(message, "nonce", None), self._attempt
        if self._welcome is not None and nonce == self._nonce and isinstance(message, Welcome):
            return self._on_further_welcome(self._welcome, message, now)
        if attempt is None or nonce != attempt.nonce:
            self.num_rejected += 1
            return [], []
        match message:
            case Challenge():
                return [attempt.on_challenge(message.token, now)], []
            case Refuse():
                return self._on_refusal(attempt, message.reason, now)
            case Welcome() if attempt.is_validated:
                if problem := check_welcome(message, self.options.limits):
                    return self._finish(problem)
                return self._on_welcome(message, now)
        self.num_rejected += 1
        return [], []

    def on_wrong_transport(self) -> tuple[list[bytes], list[Event]]:
        """Ends the transfer because the server's port serves plain UDP, not QUIC.

        Returns:
            Datagrams to send, and events.
        """
        return self._on_refusal(self._last_attempt, OTHER_TRANSPORT, self._began_at)

    def _on_refusal(self, attempt: HandshakeAttempt, reason: int, now: float) -> tuple[list[bytes], list[Event]]:
        """Handles the server's refusal of a request: schedules a retry, or ends the transfer.

        Args:
            attempt: Connection attempt that was refused.
            reason: Reason of the server, as an index into `REFUSALS`.
            now: Time, seconds.

        Returns:
            Datagrams to send, and events.
        """
        if reason == NOT_YET:
            self._connecting_since = now
            attempt.on_refusal(now, RETRY_S if now - self._began_at < FAST_RETRY_PERIOD_S else WAIT_S)
            events: list[Event] = self._resume_wait() if self._has_begun_waiting else [NotBegun()]
            self._has_begun_waiting = True
            return [], events
        self._refusal = REFUSALS[reason] if 0 < reason < len(REFUSALS) else "the server refused"
        if reason == OTHER_TRANSPORT:
            wrong, right = ("quic", "udp") if self._reliable else ("udp", "quic")
            self._refusal = f"this port serves {right}://, not {wrong}://: use a {right}:// address"
        if self._welcome is None or reason in (MISSING_STREAM, OTHER_VERSION, NEEDS_TOKEN, OTHER_TRANSPORT):
            return self._finish(self._refusal)
        attempt.on_refusal(now)
        return [], []

    def _on_welcome(self, message: Welcome, now: float) -> tuple[list[bytes], list[Event]]:
        """Processes the server's acceptance of a request: starts or resumes a transfer."""
        before, events = self._welcome, list[Event]()
        num_held = 0 if self._collector is None else self._collector.num_packets
        if before is None:
            events += self._resume_wait()
            self._begin(message, discard=True)
        else:
            self._fruitless_transfers = self._fruitless_transfers + 1 if num_held == self._num_packets_before else 0
            if self._fruitless_transfers > MAX_FRUITLESS_TRANSFERS:
                return self._finish("the server fell silent again and again")
            is_resumed = self._resume(before, message)
            if not is_resumed and before.is_live and (stream := self.stream()) is not None:
                events.append(StreamReplaced(stream))
            if not is_resumed:
                self._begin(message, discard=True)
            events.append(Resumed(is_resumed))
        assert self._attempt is not None
        self._nonce, self._attempt, self._refusal = self._attempt.nonce, None, ""
        self._num_packets_before = 0 if self._collector is None else self._collector.num_packets
        self._begin_session(now)
        if before is not None:
            self._list_held(now)
        if message.is_live:
            self._nack_tracker.max_attempts = MAX_NACK_ATTEMPTS
        self._heard_at, self._feedback_at = now, now + FEEDBACK_INTERVAL_S
        out = [] if before is None else [encode(Bye(before.session))]
        out += [*self._received_lists(now), self._feedback(now), *self._viewpoint_datagrams(now)]
        return out, [*events, Welcomed.of(message)]

    def _begin_session(self, now: float) -> None:
        """Resets counters and timers for the datagrams of a new transfer."""
        if self._welcome is not None:
            self._num_sent_before += self._at_last_data[0]
            self._num_received_before += self._at_last_data[1]
        self._largest_sequence, self._num_received, self._largest_arrived_at = -1, 0, now
        self._nack_tracker, self._gaps = NackTracker(), GapTracker()
        self._view_repeats, self._fruitless_ends, self._steady_ends, self._num_probes = 0, 0, 0, 0
        self._end_counted_at = -math.inf
        self._largest_datagram = 0
        self._before_ends, self._at_last_data = (0, 0), (0, 0)
        self._progress, self._progress_at = (0, 0), now
        self._ended_at: float | None = None
        if self._collector is not None:
            self._collector.highest_index = -1

    def _received_lists(self, now: float) -> list[bytes]:
        """Returns datagrams that list the packets which this receiver has from an earlier transfer.

        The server then does not send these packets again. The result is empty within `HAVE_INTERVAL_S` after the last
        call that returned datagrams, and after `NUM_HAVE_REPEATS` such calls.
        """
        if not self._have_repeats_left or now < self._have_at:
            return []
        self._have_repeats_left, self._have_at = self._have_repeats_left - 1, now + HAVE_INTERVAL_S
        return self._have_frames

    def _list_held(self, now: float) -> None:
        """Prepares the datagrams that list the packets which this client has from an earlier transfer."""
        assert self._welcome is not None
        assert self._collector is not None
        nonce, stream_id, has_init_segment = self._nonce, self._welcome.stream_id, int(self._init_segment is None)
        held = [] if self._welcome.is_live else list(self._collector.received_masks())
        self._have_frames = [encode(Have(nonce, stream_id, has_init_segment, first, bits)) for first, bits in held]
        self._have_repeats_left, self._have_at = NUM_HAVE_REPEATS, now

    def _on_further_welcome(self, before: Welcome, message: Welcome, now: float) -> tuple[list[bytes], list[Event]]:
        """Processes new sizes of a live stream, or the start of the next stream, during a transfer."""
        if message == before._replace(preview=b"") and not before.is_live:  # the server's data do not arrive
            self._heard_at, self._num_probes = now, self._num_probes + 1
            return [], []
        follows = message.stream_id not in (before.stream_id, self._stream_before)
        grows = message.stream_id == before.stream_id and message.num_packets >= before.num_packets
        if not (message.session == before.session and before.is_live and (grows or follows)):
            self.num_rejected += 1
            return [], []
        self._heard_at = now
        if (message.is_live, message.digest) == (before.is_live, before.digest):
            return [], []
        if problem := check_welcome(message, self.options.limits):
            return self._finish(problem)
        events = [StreamReplaced(stream)] if follows and (stream := self.stream()) else []
        self._begin(message, discard=follows)
        if follows:
            self._stream_before, self._nack_tracker = before.stream_id, NackTracker()
        self._nack_tracker.max_attempts, self._ended_at = MAX_NACK_ATTEMPTS, None
        self._progress_at, self._fruitless_ends, self._steady_ends = (
            now,
            0,
            0,
        )  # the live stream may have paused before it ended
        return [self._feedback(now)], [*events, Welcomed.of(message)]

    def _transferred(self, message: InitSymbol | Data | Parity | End, now: float) -> tuple[list[bytes], list[Event]]:
        is_valid = self._welcome is not None and message.session == self._welcome.session
        if not is_valid or self._collector is None or message.sequence > self._largest_sequence + MAX_SEQUENCE_JUMP:
            self.num_rejected += 1
            return [], []
        assert self._welcome is not None
        self._heard_at = now
        if not (self._reliable and isinstance(message, InitSymbol)):
            self.num_datagrams += 1
            self._num_received += 1
            if self._welcome.view_dependent:
                self._gaps.on_received(message.sequence, self._largest_sequence)
            if message.sequence > self._largest_sequence:
                self._largest_sequence, self._largest_arrived_at = message.sequence, now
        events: list[Event] = [] if self._attempt is None else [Resumed(True)]
        self._attempt = None
        match message:
            case Data() if not self._is_for_next_state(message):
                repaired = self._collector.num_repaired
                new = self._collector.add(message)
                num_repaired_now = self._collector.num_repaired - repaired
                events += [PacketArrived(packet, n >= len(new) - num_repaired_now) for n, packet in enumerate(new)]
            case InitSymbol():
                events += self._on_init_symbol(message)
            case Parity():
                events += [PacketArrived(packet, True) for packet in self._collector.add_parity(message)]
            case End():
                self._ended_at = now if self._ended_at is None else self._ended_at
                self._count_end(now)
        self._num_probes = 0
        if not isinstance(message, End):
            self._fruitless_ends = self._steady_ends = 0
            self._at_last_data = self._largest_sequence + 1, self._num_received
            self._ended_at = None if self._uses_view_order else self._ended_at
        progress = self._collector.num_packets, self._init_segment.num_missing if self._init_segment else 0
        if progress != self._progress:
            self._progress, self._progress_at = progress, now
        if self.finished:
            return [encode(Bye(self._welcome.session))] * NUM_BYES, [*events, self.finished]
        is_complete = self._init_segment is None and self._collector.num_packets == self._welcome.num_packets
        if is_complete and not self._welcome.is_live:
            out, finish_events = self._finish("complete")
            return out, [*events, *finish_events]
        return [], events

    def _count_end(self, now: float) -> None:
        """Counts the `End` datagrams of the server that arrive in a row.

        `End` datagrams that arrive within `MIN_END_SPACING_S` count as one. The caller resets the count when any other
        datagram arrives.
        """
        spacing = now - self._end_counted_at
        if not self._steady_ends or spacing > MAX_END_SPACING_S:
            self._before_ends, self._steady_ends = (self._largest_sequence, self._num_received), 0
        if not self._fruitless_ends or spacing >= MIN_END_SPACING_S:
            self._fruitless_ends, self._steady_ends = self._fruitless_ends + 1, self._steady_ends + 1
            self._end_counted_at = now

    def _on_init_symbol(self, message: InitSymbol) -> list[Event]:
        assert self._welcome is not None
        if self._init_segment is None or self._collector is None:
            return []
        data = self._init_segment.add(message)
        if data is None:
            return []
        try:
            self._manifest, self._side_info, bundled = read_init_segment(data, self._welcome)
            self._resend_viewpoint()
        except BitstreamError as error:
            self.finished = Finished(str(error), False)
            return []
        self._init_segment = None
        intake, new = self._collector.open(self._manifest, bundled)
        arrived = SideInfoArrived(self._manifest, self._side_info, intake)
        return [arrived, *(PacketArrived(packet, False) for packet in new)]

    def _resend_viewpoint(self) -> None:
        """Schedules the viewpoint to be sent again, in coordinates relative to the origin of the current stream."""
        if self._viewpoint is not None and self._relative_to_origin(self._viewpoint[0]).origin != AT_ZERO:
            self.set_viewpoint(*self._viewpoint)
            self._moved_at = self._heard_at

    def _relative_to_origin(self, viewpoint: Viewpoint) -> Viewpoint:
        """Converts a viewpoint to coordinates relative to the stream's origin."""
        if self._manifest is None:
            return viewpoint.relative_to(AT_ZERO)
        return viewpoint.relative_to(ORIGIN_SECTION.of_side_info(self._side_info, self._manifest.schema_name))

    def _end_reason(self, now: float) -> str | None:
        """Returns the reason for the end of the transfer if the transfer is over, else None."""
        if self.options.deadline_s is not None and now >= self._began_at + self.options.deadline_s:
            return "deadline"
        if self._welcome is None:
            if now - self._connecting_since <= CONNECT_TIMEOUT_S or self.may_resume(now):
                return None
            if self._has_begun_waiting:
                return SILENT
            if self._reliable and not self._connected:
                return f"no answer: {NO_QUIC}, or {SMALL_MTU}"
            if self._reliable:
                return "no answer: the server accepts connections, but sends nothing"
            return f"no answer: {NO_UDP}, or {SMALL_MTU}"
        if now - self._heard_at > max(self.options.silence_s, self.options.reconnect_s):
            if self._num_quic_packets >= MIN_QUIC_PACKETS and not self._refusal:
                return f"{SILENT}, but small packets of QUIC arrive: perhaps {SMALL_MTU}"
            return f"{SILENT}{f', then: {self._refusal}' if self._refusal else ''}"
        unlimited = self._welcome.is_live or self.options.keep_open
        if not unlimited and self._heard_at - self._progress_at > MAX_FRUITLESS_S:
            return "the server sends nothing new"
        if self._is_cut_off:
            return f"only small datagrams arrive: {SMALL_MTU}"
        ended = self._ended_at is not None and now - self._ended_at > GRACE_S and not self._welcome.is_live
        if self._uses_view_order:
            ended = ended and now - self._moved_at > VIEW_CORRECTION_S  # it may be the `End` of the previous view
            seen = ended and self._manifest is not None and not (self._gaps and self.options.nack)
            return "seen" if seen and not self.options.keep_open else None
        if (
            ended
            and self._manifest is not None
            and (not self.options.nack or self._fruitless_ends >= MAX_FRUITLESS_ENDS)
        ):
            return "sent"
        return None

    def _finish(self, reason: str) -> tuple[list[bytes], list[Event]]:
        self.finished = Finished(reason, self._manifest is not None)
        out = [encode(Bye(self._welcome.session))] * NUM_BYES if self._welcome else []
        return out, [self.finished]

    def _is_silent(self, now: float) -> bool:
        """True if the server has been silent for long enough to start a new connection attempt."""
        suspect_s = min(RECONNECT_AFTER_S, self.options.silence_s)
        suspect_s += self.options.silence_s if self._reliable else 0.0  # QUIC closes the connection earlier
        if self._welcome is None or now - self._heard_at <= suspect_s:
            return False
        if self._attempt is None:
            return self.options.reconnect_s > 0
        return not self._reliable and now - self._attempt.began_at > ATTEMPT_TIMEOUT_S

    @property
    def _is_cut_off(self) -> bool:
        """True if only small datagrams have arrived, probably because the path drops large ones (MTU)."""
        assert self._welcome is not None
        assert self._collector is not None
        if self._num_probes >= MAX_FRUITLESS_ENDS and not self._reliable:  # only probes arrive
            return True
        if self._fruitless_ends < MAX_FRUITLESS_ENDS:
            return False
        sent, received = self._largest_sequence - self._before_ends[0], self._num_received - self._before_ends[1]
        is_steady = self._steady_ends >= MAX_FRUITLESS_ENDS and not self._uses_view_order
        if is_steady and sent - received > MAX_LOST_RATIO * received:  # retransmissions, but no `End`
            return True
        may_idle = self._uses_view_order or self._welcome.is_live
        num_lost = self._largest_sequence + 1 - self._num_received
        if may_idle and num_lost <= MAX_LOST_RATIO * self._num_received:  # no data were sent, as after a resumption
            return False
        return self._collector.highest_index < 0 and self._largest_datagram < min(
            MAX_DATAGRAM // 2, self._welcome.max_packet_bytes
        )

    def _feedback(self, now: float) -> bytes:
        assert self._welcome is not None
        idle = self._uses_view_order and self._ended_at is not None and not self._gaps and now - self._ended_at > IDLE_S
        self._feedback_at = now + (IDLE_S / 2 if idle else FEEDBACK_INTERVAL_S)
        missing = self._init_segment.num_missing if self._init_segment else 0
        nacks = self._nacks(now) if self.options.nack else ((), ())
        time_us = int(self._largest_arrived_at * 1e6) & 0xFFFFFFFF
        largest, received = max(self._largest_sequence, 0), min(self._num_received, self._largest_sequence + 1)
        return encode(Feedback(self._welcome.session, largest, received, time_us, missing, *nacks))

    @property
    def _uses_view_order(self) -> bool:
        """True if the server sends packets in an order that depends on the viewpoint."""
        return self._view_update is not None and self._welcome is not None and self._welcome.view_dependent

    def _viewpoint_datagrams(self, now: float) -> list[bytes]:
        """Returns a list with the viewpoint datagram, empty if it is not due."""
        if self._view_update is None or self._welcome is None or not self._welcome.view_dependent:
            return []
        if now - self._view_at < (VIEW_INTERVAL_S if self._view_repeats < NUM_IMMEDIATE_VIEWS else VIEW_REPEAT_S):
            return []
        self._view_at, self._view_repeats = now, self._view_repeats + 1
        return [encode(self._view_update._replace(session=self._welcome.session))]

    def _nacks(self, now: float) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Returns the packets (`Feedback.nacks`) and datagrams (`Feedback.lost_sequences`) to request next."""
        assert self._welcome is not None
        if self._collector is None:
            return (), ()
        if self._uses_view_order:
            return (), tuple(
                self._gaps.due(self._largest_sequence + 1 - (REORDER_THRESHOLD if self._ended_at is None else 0), now)
            )
        start = (
            self._welcome.num_bundled if self._manifest is None else 0
        )  # bundled packets arrive with the init segment
        stop = self._collector.highest_index + 1 - REORDER_THRESHOLD
        if self._ended_at is not None:
            stop = self._welcome.num_packets
        missing = self._collector.missing(max(start, self._nack_tracker.exhausted), max(stop, 0))
        if self._fruitless_ends >= SUSPECT_ENDS:
            missing = itertools.islice(missing, MAX_SMALL_NACKS)
        return tuple(self._nack_tracker.due(missing, now)), ()
