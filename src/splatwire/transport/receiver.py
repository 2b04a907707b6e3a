"""The receiving side of one transfer. Bytes and time in, bytes and events out; no socket, no clock."""

import math

from splatwire.errors import BitstreamError
from splatwire.packets.view import BUDGET, Look
from splatwire.transport.arrived import Arrived
from splatwire.transport.asked import MOST_TRIES, Asked
from splatwire.transport.collect import check_welcome, read_head
from splatwire.transport.events import Event, Finished, PacketArrived, SideInfoArrived, StreamLeft, Welcomed
from splatwire.transport.frames import (
    NOT_YET,
    REFUSALS,
    TOKEN_BYTES,
    Bye,
    Challenge,
    Data,
    End,
    Feedback,
    Frame,
    Hello,
    Parity,
    Refuse,
    Request,
    Side,
    View,
    Welcome,
)
from splatwire.transport.gaps import Gaps
from splatwire.transport.receiver_options import ReceiverOptions
from splatwire.transport.wire import decode, encode

CONNECT_S = 10.0
"""A server that has not answered for so long is not there."""
RETRY_S = 0.2
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
        self._began = self._asking_since = self._heard_at = self._retry_at = self._largest_at = self._feedback_at = now
        self._reliable = reliable
        self._token: bytes | None = bytes(TOKEN_BYTES) if reliable else None
        self._largest = -1
        self._received = 0
        self._asked, self._gaps = Asked(), Gaps()
        self._view: View | None = None
        self._view_number, self._view_at, self._told = 0, -math.inf, 0
        self._ended_at: float | None = None
        self._ends_in_vain = 0
        self._stream_before: int | None = None
        if self.options.look is not None:
            self.look(self.options.look)

    def next_at(self) -> float | None:
        """When to call `poll` next; None when it is over."""
        if self.finished:
            return None
        end = math.inf if self.options.deadline_s is None else self._began + self.options.deadline_s
        return min(self._retry_at if self._welcome is None else self._feedback_at, end)

    def poll(self, now: float) -> tuple[list[bytes], list[Event]]:
        """Does what is due: greets again, reports, gives up."""
        if self.finished:
            return [], []
        if reason := self._over(now):
            return self._finish(reason)
        if self._welcome is None:
            if now < self._retry_at:
                return [], []
            self._retry_at = now + (RETRY_S if not self._reliable else RETRY_S + CONNECT_S)
            return [self._greeting()], []
        if now < self._feedback_at:
            return [], []
        return [self._feedback(now), *self._looking(now)], []

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
        if isinstance(frame, (Side, Data, Parity, End)):
            return self._transferred(frame, now)
        return self._greeted(frame, now)

    def look(self, look: Look, budget: int = BUDGET) -> None:
        """Says where somebody looks from: what they see comes first. Of streams without levels all comes as ever."""
        rows = tuple(look.viewmat[:3].ravel().tolist())
        self._view_number, self._told = self._view_number + 1, 0
        self._view = View(0, self._view_number, budget, look.width, look.height, look.focal, rows)
        self._feedback_at = min(self._feedback_at, self._heard_at)

    def stop(self, reason: str = "stopped") -> tuple[list[bytes], list[Event]]:
        """Ends the transfer here; what arrived stays."""
        return ([], []) if self.finished else self._finish(reason)

    def _greeted(self, frame: Frame, now: float) -> tuple[list[bytes], list[Event]]:
        """The handshake; answers to other attempts are ignored."""
        if getattr(frame, "nonce", None) != self._nonce or (self._welcome and not isinstance(frame, Welcome)):
            self.num_rejected += 1
            return [], []
        match frame:
            case Challenge():
                self._token = frame.token
                self._retry_at = now + RETRY_S
                return [self._greeting()], []
            case Refuse() if frame.reason == NOT_YET:
                self._asking_since, self._retry_at = now, now + RETRY_S
                self._token = self._token if self._reliable else None  # one does not hold for long
                return [], []
            case Refuse():
                reason = REFUSALS[frame.reason] if 0 < frame.reason < len(REFUSALS) else "the server refused"
                return self._finish(reason)
            case Welcome() if self._welcome is not None:
                return self._told_again(self._welcome, frame, now)
            case Welcome() if self._token is not None:
                if problem := check_welcome(frame, self.options.limits):
                    return self._finish(problem)
                self._begin(frame, anew=True)
                self._heard_at, self._feedback_at = now, now + FEEDBACK_S
                return [self._feedback(now), *self._looking(now)], [Welcomed.of(frame)]
        self.num_rejected += 1
        return [], []

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
        events: list[Event] = []
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
            return "no answer: nothing seems to serve there" if now - self._asking_since > CONNECT_S else None
        if now - self._heard_at > self.options.silence_s:
            return "the server fell silent"
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

    def _greeting(self) -> bytes:
        if self._token is None:
            return encode(Hello(self._nonce, self.options.name))
        return encode(Request(self._nonce, self._token, self.options.name))

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
