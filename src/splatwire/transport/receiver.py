"""The receiving side of one transfer. Bytes and time in, bytes and events out; no socket, no clock."""

import math

from splatwire.errors import BitstreamError
from splatwire.packets.view import BUDGET, Look
from splatwire.transport.arrived import Arrived
from splatwire.transport.asked import MOST_TRIES, Asked
from splatwire.transport.collect import check_welcome, read_head
from splatwire.transport.events import (
    Event,
    Finished,
    Interrupted,
    PacketArrived,
    Resumed,
    SideInfoArrived,
    StreamLeft,
    Welcomed,
)
from splatwire.transport.frames import (
    NOT_YET,
    REFUSALS,
    Bye,
    Challenge,
    Data,
    End,
    Feedback,
    Frame,
    Have,
    Parity,
    Refuse,
    Side,
    View,
    Welcome,
)
from splatwire.transport.gaps import Gaps
from splatwire.transport.greeting import RETRY_S, Greeting
from splatwire.transport.receiver_options import ReceiverOptions
from splatwire.transport.wire import MAX_DATAGRAM, decode, encode

CONNECT_S = 10.0
"""A server that has not answered for so long is not there."""
SUSPECT_S = 3.0
"""Silence after which a client greets again, seconds: its address may be another one, or the server."""
MAX_VAIN = 5
"""Transfers in a row that bring nothing new before the client gives up."""
HAVE_TIMES, HAVE_S = 3, 0.3
"""How often and at which interval the server is sent a list of what is there: a datagram may be lost."""
MISSING_STREAM = 1
"""The one refusal that will not change."""
ATTEMPT_S = 4.0
"""Time after which an attempt has another name, seconds: a server begins one transfer for each name."""
SMALL_PATH = f"the path carries no datagrams of {MAX_DATAGRAM:,} bytes (its MTU is below {MAX_DATAGRAM + 28:,})"
FEEDBACK_S = 0.02
REORDER = 48
"""Packets this far behind the furthest one that arrived are taken for lost."""
MOST_AHEAD = 1 << 17
"""A sequence number further than this beyond the largest one so far is not the server's."""
GRACE_S = 0.15
"""Time after the end of the sending that late packets get."""
BYES = 3
VIEW_S, VIEW_AGAIN_S, TWICE = 0.1, 1.0, 2
"""A view is not told sooner after another one, and so often at once: what is lost meanwhile is told again later."""
IDLE_S = 1.0
"""Where all that is looked at came so long ago, reports get rare."""
ENDS_IN_VAIN = 25
"""A server that says so often that everything was sent, and sends nothing in between although it is asked, does not
want to send again (`Protection.resend`). It says so ten times a second: no round trip beyond 2.5 s is waited for."""


class Receiver(Arrived):
    """Receives one stream.

    Call `receive` for every datagram and `poll` whenever `next_at` says so; both give what to send and what happened.

    Args:
        nonce: 64 random bits that name this attempt.
        now: Time, seconds.
        options: What is wanted.
        reliable: Whether the path carries greetings and side information reliably and has shown the client's address to
            the server (QUIC): one request is enough, and symbols of the head object do not count as datagrams.
    """

    def __init__(
        self, nonce: int, now: float, options: ReceiverOptions | None = None, *, reliable: bool = False
    ) -> None:
        super().__init__()
        self.options = options or ReceiverOptions()
        self._nonce = nonce
        self._began = self._asking_since = self._heard_at = self._feedback_at = now
        self._reliable = reliable
        self._last_greeting = Greeting(nonce, now, self.options.name, reliable=reliable)
        self._greeting: Greeting | None = self._last_greeting
        self._refusal = ""
        self._view: View | None = None
        self._view_number, self._view_at = 0, -math.inf
        self._have: list[bytes] = []
        self._have_left, self._have_at = 0, now
        self._vain, self._before = 0, 0
        self._longest = 0
        self._begin_session(now)
        self._stream_before: int | None = None
        if self.options.look is not None:
            self.look(self.options.look)

    def next_at(self) -> float | None:
        """When to call `poll` next; None when it is over."""
        if self.finished:
            return None
        end = math.inf if self.options.deadline_s is None else self._began + self.options.deadline_s
        greeting = math.inf if self._greeting is None else self._greeting.next_at
        return min(greeting, math.inf if self._welcome is None else self._feedback_at, end)

    def poll(self, now: float) -> tuple[list[bytes], list[Event]]:
        """Does what is due: greets again, reports, gives up."""
        if self.finished:
            return [], []
        if reason := self._over(now):
            return self._finish(reason)
        events: list[Event] = []
        if self._is_silent(now):
            events = self.greet_again(now)
        greetings = self._greeting.poll(now) if self._greeting is not None else []
        if self._welcome is None or now < self._feedback_at:
            return greetings, events
        return [*greetings, *self._having(now), self._feedback(now), *self._looking(now)], events

    def receive(self, data: bytes, now: float) -> tuple[list[bytes], list[Event]]:
        """Takes a datagram; anything at all may come."""
        if self.finished:
            return [], []
        try:
            frame = decode(data)
        except BitstreamError:
            self.num_rejected += 1
            return [], []
        self.num_bytes += len(data)
        self._longest = len(data) if self._welcome is not None and len(data) > self._longest else self._longest
        if isinstance(frame, (Side, Data, Parity, End)):
            return self._transferred(frame, now)
        return self._greeted(frame, now)

    def look(self, look: Look, budget: int = BUDGET) -> None:
        """Says where somebody looks from: what they see comes first. Of streams without levels all comes as ever."""
        rows = tuple(look.viewmat[:3].ravel().tolist())
        self._view_number, self._told = self._view_number + 1, 0
        self._view = View(0, self._view_number, budget, look.width, look.height, look.focal, rows)
        self._feedback_at = min(self._feedback_at, self._heard_at)

    def greet_again(self, now: float) -> list[Event]:
        """Begins another attempt: the server fell silent, or the connection to it ended. What arrived is kept.

        Args:
            now: Time, seconds.
        """
        events: list[Event] = [] if self._greeting is not None else [Interrupted()]
        self._greeting = self._last_greeting = self._last_greeting.again(now)
        return events

    def may_resume(self, now: float) -> bool:
        """Returns True if a transfer that broke off is worth another attempt.

        Args:
            now: Time, seconds.
        """
        within = now - self._heard_at <= self.options.reconnect_s
        return self.finished is None and self._welcome is not None and within

    def stop(self, reason: str = "stopped") -> tuple[list[bytes], list[Event]]:
        """Ends the transfer here; what arrived stays."""
        return ([], []) if self.finished else self._finish(reason)

    def _greeted(self, frame: Frame, now: float) -> tuple[list[bytes], list[Event]]:
        """The handshake; answers to other attempts are ignored."""
        nonce, greeting = getattr(frame, "nonce", None), self._greeting
        if self._welcome is not None and nonce == self._nonce and isinstance(frame, Welcome):
            return self._told_again(self._welcome, frame, now)
        if greeting is None or nonce != greeting.nonce:
            self.num_rejected += 1
            return [], []
        match frame:
            case Challenge():
                return [greeting.challenged(frame.token, now)], []
            case Refuse():
                return self._refused(greeting, frame.reason, now)
            case Welcome() if greeting.shown:
                if problem := check_welcome(frame, self.options.limits):
                    return self._finish(problem)
                return self._welcomed(frame, now)
        self.num_rejected += 1
        return [], []

    def _refused(self, greeting: Greeting, reason: int, now: float) -> tuple[list[bytes], list[Event]]:
        """Takes a refusal: it may not last where nothing is there yet, or a transfer that broke off holds the place."""
        if reason == NOT_YET:
            self._asking_since = now
            greeting.refused(now, RETRY_S)
            return [], []
        self._refusal = REFUSALS[reason] if 0 < reason < len(REFUSALS) else "the server refused"
        if self._welcome is None or reason == MISSING_STREAM:
            return self._finish(self._refusal)
        greeting.refused(now)
        return [], []

    def _welcomed(self, frame: Welcome, now: float) -> tuple[list[bytes], list[Event]]:
        """Begins a transfer, or goes on with one that broke off."""
        before, events = self._welcome, list[Event]()
        known = 0 if self._collector is None else self._collector.num_packets
        if before is None:
            self._begin(frame, anew=True)
        else:
            self._vain = self._vain + 1 if known == self._before else 0
            if self._vain > MAX_VAIN:
                return self._finish("the server fell silent again and again")
            kept = self._resume(before, frame)
            if not kept and before.open and (stream := self.stream()) is not None:
                events.append(StreamLeft(stream))
            if not kept:
                self._begin(frame, anew=True)
            events.append(Resumed(kept))
        assert self._greeting is not None
        self._nonce, self._greeting, self._refusal = self._greeting.nonce, None, ""
        self._before = 0 if self._collector is None else self._collector.num_packets
        self._begin_session(now)
        if before is not None:
            self._list_held(now)
        self._asked.most = MOST_TRIES if before is not None and frame.open else self._asked.most
        self._heard_at, self._feedback_at = now, now + FEEDBACK_S
        out = [] if before is None else [encode(Bye(before.session))]
        out += [*self._having(now), self._feedback(now), *self._looking(now)]
        return out, [*events, Welcomed.of(frame)]

    def _begin_session(self, now: float) -> None:
        """Forgets what belongs to one transfer: its sequence numbers, and what was asked for in it."""
        self._largest, self._received, self._largest_at = -1, 0, now
        self._asked, self._gaps = Asked(), Gaps()
        self._told, self._ends_in_vain = 0, 0
        self._ended_at: float | None = None
        if self._collector is not None:
            self._collector.highest = -1

    def _having(self, now: float) -> list[bytes]:
        """What was there when the transfer was gone on with, for a server that would send it again."""
        if not self._have_left or now < self._have_at:
            return []
        self._have_left, self._have_at = self._have_left - 1, now + HAVE_S
        return self._have

    def _list_held(self, now: float) -> None:
        """Lists what is there, which the server does not count as sent; a stream that grows has no such list."""
        assert self._welcome is not None
        assert self._collector is not None
        nonce, stream_id, head = self._nonce, self._welcome.stream_id, int(self._head is None)
        held = [] if self._welcome.open else list(self._collector.held())
        self._have = [encode(Have(nonce, stream_id, head, first, bits)) for first, bits in held]
        self._have_left, self._have_at = HAVE_TIMES, now

    def _told_again(self, before: Welcome, frame: Welcome, now: float) -> tuple[list[bytes], list[Event]]:
        """What there is by now of a stream that grows, or the one that follows; else an answer that came twice."""
        follows = frame.stream_id not in (before.stream_id, self._stream_before)
        grows = frame.stream_id == before.stream_id and frame.num_packets >= before.num_packets
        if not (frame.session == before.session and before.open and (grows or follows)):
            self.num_rejected += 1
            return [], []
        self._heard_at = now
        if (frame.open, frame.digest) == (before.open, before.digest):
            return [], []
        if problem := check_welcome(frame, self.options.limits):
            return self._finish(problem)
        left = [StreamLeft(stream)] if follows and (stream := self.stream()) else []
        self._begin(frame, anew=follows)
        if follows:
            self._stream_before, self._asked = before.stream_id, Asked()
        self._asked.most, self._ended_at = MOST_TRIES, None
        return [self._feedback(now)], [*left, Welcomed.of(frame)]

    def _transferred(self, frame: Side | Data | Parity | End, now: float) -> tuple[list[bytes], list[Event]]:
        known = self._welcome is not None and frame.session == self._welcome.session
        if not known or self._collector is None or frame.sequence > self._largest + MOST_AHEAD:
            self.num_rejected += 1
            return [], []
        assert self._welcome is not None
        self._heard_at = now
        if not (self._reliable and isinstance(frame, Side)):
            self.num_datagrams += 1
            self._received += 1
            if self._welcome.viewable:
                self._gaps.came(frame.sequence, self._largest)
            if frame.sequence > self._largest:
                self._largest, self._largest_at = frame.sequence, now
        events: list[Event] = [] if self._greeting is None else [Resumed(True)]
        self._greeting = None
        match frame:
            case Data() if not self._ahead(frame):
                repaired = self._collector.num_repaired
                new = self._collector.add(frame)
                back = self._collector.num_repaired - repaired
                events += [PacketArrived(packet, n >= len(new) - back) for n, packet in enumerate(new)]
            case Side():
                events += self._side(frame)
            case Parity():
                events += [PacketArrived(packet, True) for packet in self._collector.add_parity(frame)]
            case End():
                self._ended_at = now if self._ended_at is None else self._ended_at
                self._ends_in_vain += 1
        if not isinstance(frame, End):
            self._ends_in_vain = 0
            self._ended_at = None if self._viewing else self._ended_at
        if self.finished:
            return [encode(Bye(self._welcome.session))] * BYES, [*events, self.finished]
        everything = self._head is None and self._collector.num_packets == self._welcome.num_packets
        if everything and not self._welcome.open:
            out, over = self._finish("complete")
            return out, [*events, *over]
        return [], events

    def _side(self, frame: Side) -> list[Event]:
        assert self._welcome is not None
        if self._head is None or self._collector is None:
            return []
        data = self._head.add(frame)
        if data is None:
            return []
        try:
            self._manifest, self._side_info, carried = read_head(data, self._welcome)
        except BitstreamError as error:
            self.finished = Finished(str(error), False)
            return []
        self._head = None
        intake, new = self._collector.open(self._manifest, carried)
        arrived = SideInfoArrived(self._manifest, self._side_info, intake)
        return [arrived, *(PacketArrived(packet, False) for packet in new)]

    def _over(self, now: float) -> str | None:
        """Why it is over, if it is."""
        if self.options.deadline_s is not None and now >= self._began + self.options.deadline_s:
            return "deadline"
        if self._welcome is None:
            late = now - self._asking_since > CONNECT_S
            return f"no answer: nothing seems to serve there, or {SMALL_PATH}" if late else None
        if now - self._heard_at > max(self.options.silence_s, self.options.reconnect_s):
            return f"the server fell silent{f', then: {self._refusal}' if self._refusal else ''}"
        if self._ends_in_vain >= ENDS_IN_VAIN and self._is_cut_off:
            return f"only small datagrams arrive: {SMALL_PATH}"
        ended = self._ended_at is not None and now - self._ended_at > GRACE_S and not self._welcome.open
        if self._viewing:
            seen = ended and self._manifest is not None and not (self._gaps and self.options.nack)
            return "seen" if seen and not self.options.stays else None
        if ended and self._manifest is not None and (not self.options.nack or self._ends_in_vain >= ENDS_IN_VAIN):
            return "sent"
        return None

    def _finish(self, reason: str) -> tuple[list[bytes], list[Event]]:
        self.finished = Finished(reason, self._manifest is not None)
        out = [encode(Bye(self._welcome.session))] * BYES if self._welcome else []
        return out, [self.finished]

    def _is_silent(self, now: float) -> bool:
        """Whether it is time for another attempt: nothing came for long, and the last attempt brought nothing."""
        suspect_s = min(SUSPECT_S, self.options.silence_s)
        suspect_s += self.options.silence_s if self._reliable else 0.0  # QUIC itself ends the connection before
        if self._welcome is None or now - self._heard_at <= suspect_s:
            return False
        if self._greeting is None:
            return self.options.reconnect_s > 0
        return not self._reliable and now - self._greeting.began_at > ATTEMPT_S

    @property
    def _is_cut_off(self) -> bool:
        """Whether no packet has arrived in this transfer, and no datagram as long as one is."""
        assert self._welcome is not None
        assert self._collector is not None
        return self._collector.highest < 0 and self._longest < min(MAX_DATAGRAM // 2, self._welcome.packet_bytes)

    def _feedback(self, now: float) -> bytes:
        assert self._welcome is not None
        idle = self._viewing and self._ended_at is not None and not self._gaps and now - self._ended_at > IDLE_S
        self._feedback_at = now + (IDLE_S / 2 if idle else FEEDBACK_S)
        missing = self._head.num_missing if self._head else 0
        nacks = self._nacks(now) if self.options.nack else []
        time_us = int(self._largest_at * 1e6) & 0xFFFFFFFF
        largest, received = max(self._largest, 0), min(self._received, self._largest + 1)
        return encode(Feedback(self._welcome.session, largest, received, time_us, missing, tuple(nacks)))

    @property
    def _viewing(self) -> bool:
        """Whether what comes is what is looked at."""
        return self._view is not None and self._welcome is not None and self._welcome.viewable

    def _looking(self, now: float) -> list[bytes]:
        """Where somebody looks from, if it is time to say so: it may not have come the last time."""
        if self._view is None or self._welcome is None or not self._welcome.viewable:
            return []
        if now - self._view_at < (VIEW_S if self._told < TWICE else VIEW_AGAIN_S):
            return []
        self._view_at, self._told = now, self._told + 1
        return [encode(self._view._replace(session=self._welcome.session))]

    def _nacks(self, now: float) -> list[int]:
        """Packets that should have come and were not asked for a moment ago, the earliest first."""
        assert self._welcome is not None
        if self._collector is None:
            return []
        if self._viewing:
            return self._gaps.due(self._largest + 1 - (REORDER if self._ended_at is None else 0), now)
        start = self._welcome.carried if self._manifest is None else 0  # the first ones come with the head object
        stop = self._collector.highest + 1 - REORDER
        if self._ended_at is not None:
            stop = self._welcome.num_packets
        return self._asked.due(self._collector.missing(start, max(stop, 0)), now)
