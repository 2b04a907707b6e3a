"""The receiving side of one transfer. Bytes and time in, bytes and events out; no socket, no clock."""

import math

from splatwire.errors import BitstreamError
from splatwire.packets import Manifest, ReadReport, SceneStream
from splatwire.transport.asked import MOST_TRIES, Asked
from splatwire.transport.collect import (
    HeadCollector,
    PacketCollector,
    check_welcome,
    read_head,
)
from splatwire.transport.events import Event, Finished, PacketArrived, SideInfoArrived, Welcomed
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
    Welcome,
)
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
ENDS_IN_VAIN = 25
"""A server that says so often that everything was sent, and sends nothing in between although it is asked, does not
want to send again (`Protection.resend`). It says so ten times a second: no round trip beyond 2.5 s is waited for."""


class Receiver:
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
        self.options = options or ReceiverOptions()
        self.finished: Finished | None = None
        self.num_datagrams = self.num_rejected = self.num_bytes = 0
        self._nonce = nonce
        self._began = self._asking_since = self._heard_at = self._retry_at = self._largest_at = self._feedback_at = now
        self._reliable = reliable
        self._token: bytes | None = bytes(TOKEN_BYTES) if reliable else None
        self._welcome: Welcome | None = None
        self._head: HeadCollector | None = None
        self._collector: PacketCollector | None = None
        self._manifest: Manifest | None = None
        self._side_info = b""
        self._largest = -1
        self._received = 0
        self._asked = Asked()
        self._ended_at: float | None = None
        self._ends_in_vain = 0

    @property
    def welcome(self) -> Welcome | None:
        """What the server declared, once it did."""
        return self._welcome

    @property
    def preview(self) -> bytes:
        """What the welcome shows of the scene, as it came; empty before it, and where there is none."""
        return self._welcome.preview if self._welcome else b""

    @property
    def collector(self) -> PacketCollector | None:
        """The packets so far."""
        return self._collector

    def stream(self) -> SceneStream | None:
        """What is there by now; None as long as side information is missing."""
        if self._manifest is None or self._collector is None:
            return None
        return SceneStream(self._manifest, self._side_info, self._collector.packets)

    def report(self) -> ReadReport | None:
        """Counts of the packets; None as long as side information is missing."""
        intake = self._collector.intake if self._collector else None
        return intake.report() if intake else None

    def lacking(self) -> str:
        """What is missing, in words; empty before the server declared what there is."""
        if self._welcome is None or self._collector is None:
            return ""
        packets = f"{self._collector.num_packets} of {self._welcome.num_packets} packets arrived"
        if self._head is None:
            return packets
        missing, total = self._head.num_missing, self._head.num_symbols
        return f"of the side information at least {missing} of {total} pieces are missing; {packets}"

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
        return [self._feedback(now)], []

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
                self._asking_since = now
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
                self._welcome, self._heard_at, self._feedback_at = frame, now, now + FEEDBACK_S
                self._head, self._collector = HeadCollector(frame), PacketCollector(frame)
                return [self._feedback(now)], [Welcomed.of(frame)]
        self.num_rejected += 1
        return [], []

    def _told_again(self, before: Welcome, frame: Welcome, now: float) -> tuple[list[bytes], list[Event]]:
        """What there is by now of a stream that grows; anything else is an answer that came twice."""
        same = (frame.session, frame.stream_id) == (before.session, before.stream_id)
        if not (same and before.open and frame.num_packets >= before.num_packets):
            self.num_rejected += 1
            return [], []
        self._heard_at = now
        if (frame.open, frame.digest) == (before.open, before.digest):
            return [], []
        if problem := check_welcome(frame, self.options.limits):
            return self._finish(problem)
        assert self._collector is not None
        self._welcome, self._head, self._ended_at = frame, HeadCollector(frame), None
        self._collector.renew(frame)
        self._asked.most = MOST_TRIES
        return [self._feedback(now)], [Welcomed.of(frame)]

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
            if frame.sequence > self._largest:
                self._largest, self._largest_at = frame.sequence, now
        events: list[Event] = []
        match frame:
            case Data():
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
        self._feedback_at = now + FEEDBACK_S
        missing = self._head.num_missing if self._head else 0
        nacks = self._nacks(now) if self.options.nack else []
        time_us = int(self._largest_at * 1e6) & 0xFFFFFFFF
        largest, received = max(self._largest, 0), min(self._received, self._largest + 1)
        return encode(Feedback(self._welcome.session, largest, received, time_us, missing, tuple(nacks)))

    def _nacks(self, now: float) -> list[int]:
        """Packets that should have come and were not asked for a moment ago, the earliest first."""
        assert self._welcome is not None
        if self._collector is None:
            return []
        start = self._welcome.carried if self._manifest is None else 0  # the first ones come with the head object
        stop = self._collector.highest + 1 - REORDER
        if self._ended_at is not None:
            stop = self._welcome.num_packets
        return self._asked.due(self._collector.missing(start, max(stop, 0)), now)
