"""A transfer survives an outage, an address change of its client, and a server restart."""

import heapq
import logging
import random
from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import numpy as np
import pytest

from splatwire.bitstream import PacketId, make_packet
from splatwire.bitstream.tile_selection import Viewpoint
from splatwire.transport import Receiver, ReceiverOptions, Server, ServerLimits, StreamReplaced, make_served_stream
from splatwire.transport.protocol import nack
from splatwire.transport.protocol import transfer as transfer_module
from splatwire.transport.protocol.events import Finished, Interrupted, NotBegun, Resumed
from splatwire.transport.protocol.gap_tracker import MAX_GAPS, GapTracker
from splatwire.transport.protocol.known_packets import KnownPackets
from splatwire.transport.protocol.messages import NOT_YET, Data, End, Feedback, Have, ParityRange, Refuse, Welcome
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.transfer import ServerTransfer
from splatwire.transport.protocol.wire import DATA, PARITY, SMALL_MTU, decode, encode, message_kind
from transport.network import SECRET, Link, bernoulli, datagram_stream, transfer

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
STREAM = datagram_stream()
OTHER = datagram_stream(seed=1)
PROGRAM = make_served_stream(STREAM)
LIMITS = ServerLimits(fixed_rate=250_000.0)


@dataclass
class Path:
    """A path between a receiver and a server; both may change over time.

    Attributes:
        server: The server; None during an outage.
        address: Address of the client that the server sees.
        is_up: True if datagrams arrive.
        most_bytes: Longest datagram that arrives.
        delay_s: One way, seconds.
    """

    server: Server | None
    address: str = "client"
    is_up: bool = True
    most_bytes: int = 1 << 16
    delay_s: float = 0.02
    plan: list[tuple[float, Callable[[], None]]] = field(default_factory=list)
    events: list[object] = field(default_factory=list)
    datagrams_down: int = 0
    now: float = 0.0

    def run(self, receiver: Receiver, most_s: float = 200.0) -> Receiver:
        queue: list[tuple[float, int, str | None, bytes]] = []
        count = 0

        def send(to: str | None, data: bytes) -> None:
            nonlocal count
            self.datagrams_down += to is not None
            if self.is_up and len(data) <= self.most_bytes:
                count += 1
                heapq.heappush(queue, (self.now + self.delay_s, count, to, data))

        while receiver.finished is None and self.now < most_s:
            times = [receiver.next_at(), self.server.next_at() if self.server else None]
            times += [queue[0][0] if queue else None, self.plan[0][0] if self.plan else None]
            self.now = max(self.now, min(at for at in times if at is not None))
            while self.plan and self.plan[0][0] <= self.now:
                self.plan.pop(0)[1]()
            for address, data in self.server.poll(self.now) if self.server else ():
                send(str(address), data)
            out, events = receiver.poll(self.now)
            self.events += events
            for data in out:
                send(None, data)
            while queue and queue[0][0] <= self.now and receiver.finished is None:
                _, _, to, data = heapq.heappop(queue)
                if to is None:
                    answer = self.server.receive(self.address, data, self.now) if self.server else None
                    if answer is not None:
                        send(self.address, answer)
                elif to == self.address:
                    out, events = receiver.receive(data, self.now)
                    self.events += events
                    for reply in out:
                        send(None, reply)
        return receiver


def serving(program=PROGRAM, seed: int = 0, limits: ServerLimits = LIMITS) -> Server:
    secret = bytes([seed]) * len(SECRET)
    return Server({"scene": program}, secret=secret, random=random.Random(seed).randbytes, limits=limits)


def serving_nothing() -> Server:
    """A live server before its first group of frames."""
    return Server({}, secret=SECRET, random=random.Random(2).randbytes, limits=LIMITS)


def kinds(path: Path) -> list[object]:
    return [event for event in path.events if isinstance(event, (Interrupted, Resumed, Finished, StreamReplaced))]


@pytest.mark.parametrize(("lasts", "reason"), [(0.5, "complete"), (20.0, "complete"), (70.0, "the server fell silent")])
def test_wait_for_a_stream_that_has_not_begun_survives_a_restart_of_the_server(lasts: float, reason: str):
    path = Path(serving_nothing())
    path.plan = [
        (5.0, lambda: setattr(path, "server", None)),
        (5.0 + lasts, lambda: setattr(path, "server", serving(seed=1))),
    ]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    assert receiver.finished is not None
    assert receiver.finished.reason == reason
    assert (receiver.stream() == STREAM) is (reason == "complete")
    states = [] if lasts < 1.0 else [Interrupted(), Resumed(True)] if reason == "complete" else [Interrupted()]
    assert [event for event in kinds(path) if not isinstance(event, Finished)] == states


@pytest.mark.parametrize("reliable", [False, True])
@pytest.mark.parametrize("answers_again", [False, True])
def test_waiting_receiver_reports_within_seconds_that_the_server_is_gone(reliable: bool, answers_again: bool) -> None:
    receiver, now = Receiver(5, 0.0, ReceiverOptions(), reliable=reliable), 0.0
    reports: list[tuple[float, object]] = []

    def refuse(at: float) -> None:
        attempt = receiver._attempt
        assert attempt is not None
        reports.extend((at, event) for event in receiver.receive(encode(Refuse(attempt.nonce, NOT_YET)), at)[1])

    refuse(0.1)
    refuse(2.0)
    while (due_at := receiver.next_at()) is not None and due_at < 50.0:
        now = max(due_at, now + 1e-3)
        reports += [(now, event) for event in receiver.poll(now)[1]]
        if answers_again and now > 20.0:
            refuse(now)
            break
    assert receiver.finished is None
    (_, begun), (at, interrupted), *others = reports
    assert (begun, interrupted) == (NotBegun(), Interrupted())
    assert 2.5 < at < 6.0
    assert [event for _, event in others] == [Resumed(True)] * answers_again


@pytest.mark.parametrize("begins", [0.03, 0.3, 1.0])
@pytest.mark.parametrize("lasts", [0.5, 3.0, 6.0, 10.0, 40.0])
def test_transfer_resumes_after_an_outage(begins, lasts):
    path = Path(serving())
    path.plan = [
        (begins, lambda: setattr(path, "is_up", False)),
        (begins + lasts, lambda: setattr(path, "is_up", True)),
    ]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    if begins == 0.03 and lasts >= 10.0:  # before any answer the server is not known to exist
        assert "no answer" in receiver.finished.reason
        return
    assert receiver.finished == Finished("complete", True)
    assert receiver.stream() == STREAM
    assert path.now < begins + lasts + 7.0


def test_resumed_transfer_does_not_resend_received_packets():
    path = Path(serving())
    path.plan = [(1.2, lambda: setattr(path, "is_up", False)), (11.2, lambda: setattr(path, "is_up", True))]
    receiver = Receiver(5, 0.0, ReceiverOptions())
    seen: list[int] = []
    path.plan.insert(1, (2.0, lambda: seen.append(receiver.collector.num_packets)))
    path.run(receiver)
    assert receiver.finished == Finished("complete", True)
    assert 0 < seen[0] < len(STREAM.packets)
    assert receiver.collector.num_duplicate < 0.1 * seen[0] + 8
    assert kinds(path) == [Interrupted(), Resumed(True), Finished("complete", True)]


def test_transfer_continues_after_an_address_change():
    path = Path(serving(limits=ServerLimits(fixed_rate=250_000.0, per_network=1)))
    path.plan = [(1.0, lambda: setattr(path, "address", "another"))]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    assert receiver.finished == Finished("complete", True)
    assert receiver.stream() == STREAM
    assert path.now < 15.0


@pytest.mark.parametrize("pause", [0.0, 3.0, 20.0])
def test_transfer_resumes_with_a_restarted_server_of_the_same_stream(pause):
    path = Path(serving())
    path.plan = [
        (1.0, lambda: setattr(path, "server", None)),
        (1.0 + pause, lambda: setattr(path, "server", serving(seed=1))),
    ]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    assert receiver.finished == Finished("complete", True)
    assert receiver.stream() == STREAM
    assert Resumed(True) in path.events


@pytest.mark.parametrize(
    ("program", "stream"),
    [
        (make_served_stream(OTHER), OTHER),
        (make_served_stream(STREAM, Protection(init_repair=1.0, tier_repair=(0.5,))), STREAM),
    ],
    ids=["another stream", "another protection"],
)
def test_transfer_restarts_with_a_server_of_another_stream(program, stream):
    path = Path(serving())
    path.plan = [(1.0, lambda: setattr(path, "server", serving(program, seed=1)))]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    assert receiver.finished == Finished("complete", True)
    assert receiver.stream() == stream
    assert Resumed(False) in path.events


def test_resumed_transfer_gets_repair_symbols_of_the_packets_that_it_lacks():
    """Without retransmission, they replace packets that were lost before and after the restart."""
    program, rng = make_served_stream(STREAM, Protection(tier_repair=(0.6,))), random.Random(1)
    sent: list[list[tuple[int, bytes]]] = [[]]

    def lossy(server: Server) -> Server:
        poll = server.poll

        def lossy_poll(now: float) -> list[tuple[Hashable, bytes]]:
            datagrams = poll(now)
            sent[-1] += [(message_kind(data), data) for _, data in datagrams]
            return [one for one in datagrams if message_kind(one[1]) not in (DATA, PARITY) or rng.random() >= 0.2]

        server.poll = lossy_poll
        return server

    path = Path(lossy(serving(program)))
    begins = lambda: setattr(path, "server", lossy(serving(program, seed=1))) or sent.append([])  # noqa: E731
    path.plan = [(0.6, lambda: setattr(path, "server", None)), (1.6, begins)]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions(nack=False)))
    assert Resumed(True) in path.events
    assert receiver.stream() == STREAM
    kinds_sent = Counter(kind for kind, _ in sent[-1])
    assert kinds_sent[DATA] < len(STREAM.packets)
    assert 0 < kinds_sent[PARITY] <= sum(map(len, program.parity))


def test_client_gets_no_repair_symbols_of_groups_that_it_has():
    program = make_served_stream(STREAM, Protection(tier_repair=(0.6,)))
    known, group = KnownPackets(), program.parity_groups[0]
    held = bytearray(-(-len(program.packets) // 8))
    members = [group.packet_of(number) for number in range(group.size)]
    for index in members:
        assert not known.has((PARITY, 0, 0), program)
        held[index // 8] |= 1 << index % 8
        known.add(Have(1, program.stream_id, True, 0, bytes(held)), program)
    assert known.has((PARITY, 0, 0), program)


def test_unreturning_server_ends_the_transfer_with_a_reason():
    path = Path(serving())
    path.plan = [(1.0, lambda: setattr(path, "server", None))]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions(reconnect_s=30.0)))
    assert receiver.finished == Finished("the server fell silent", True)
    assert 30.0 < path.now < 33.0
    assert len(receiver.stream().packets) < len(STREAM.packets)


@pytest.mark.parametrize("is_live", [True, False])
def test_a_server_that_repeats_itself_without_end_ends_the_transfer(is_live):
    tiers = (ParityRange(60, 0, 0),)
    welcome = Welcome(5, 1, 9, 1000, b"a" * 32, 256, 60, 1150, 0, tiers, is_live=is_live)
    receiver, now = Receiver(5, 0.0, reliable=True), 0.1
    receiver.poll(0.0)
    receiver.receive(encode(welcome), now)
    packet = make_packet(PacketId(0, 59), 1, b"", 9)
    for sequence in range(300):
        now += 0.5
        receiver.receive(encode(Data(1, sequence, 59, packet.data)), now)
        receiver.poll(now)
    assert receiver.finished == (None if is_live else Finished("the server sends nothing new", False))


def test_a_live_stream_that_ends_after_a_long_pause_is_received():
    tiers = (ParityRange(60, 0, 0),)
    welcome = Welcome(5, 1, 9, 1000, b"a" * 32, 256, 60, 1150, 0, tiers, is_live=True)
    receiver, now = Receiver(5, 0.0, reliable=True), 0.1
    receiver.poll(0.0)
    receiver.receive(encode(welcome), now)
    receiver.receive(encode(Data(1, 0, 59, make_packet(PacketId(0, 59), 1, b"", 9).data)), now)
    for sequence in range(1, 300):
        now += 0.5
        receiver.receive(encode(End(1, sequence)), now)
        receiver.poll(now)
    receiver.receive(encode(welcome._replace(digest=b"b" * 32, is_live=False)), now)
    receiver.poll(now + 0.02)
    assert receiver.finished is None


def test_silence_ends_the_transfer_without_reconnection():
    path = Path(serving())
    path.plan = [(1.0, lambda: setattr(path, "server", None))]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions(reconnect_s=0.0)))
    assert receiver.finished == Finished("the server fell silent", True)
    assert path.now < 6.0


def test_a_deadline_ends_an_outage():
    path = Path(serving())
    path.plan = [(1.0, lambda: setattr(path, "is_up", False))]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions(deadline_s=4.0)))
    assert (receiver.finished.reason, path.now) == ("deadline", 4.0)


def test_a_restarted_server_without_the_stream_ends_the_transfer():
    path = Path(serving())
    other = Server({"other": PROGRAM}, secret=SECRET, random=random.Random(3).randbytes, limits=LIMITS)
    path.plan = [(1.0, lambda: setattr(path, "server", other))]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions(name="scene")))
    assert receiver.finished.reason == "no such stream"


def test_transfer_survives_many_outages_and_address_changes():
    path, rng = Path(serving()), random.Random(4)
    at = 0.4
    for number in range(12):
        length = rng.uniform(0.1, 8.0)
        path.plan.append((at, lambda: setattr(path, "is_up", False)))
        if number % 2:
            path.plan.append((at + length, lambda number=number: setattr(path, "address", f"client {number}")))
        path.plan.append((at + length, lambda: setattr(path, "is_up", True)))
        at += length + 2.6
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    assert receiver.finished == Finished("complete", True)
    assert receiver.stream() == STREAM


def test_path_that_passes_only_small_datagrams_gives_a_message():
    path = Path(serving(), most_bytes=1100)
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    assert "MTU" in receiver.finished.reason  # not even a greeting arrives
    path = Path(serving())
    path.plan = [(0.05, lambda: setattr(path, "most_bytes", 300))]  # only the server's datagrams are too long
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    assert "MTU" in receiver.finished.reason
    assert path.now < 15.0


@pytest.mark.parametrize(("rate", "begins"), [(250_000.0, 0.6), (60_000.0, 3.0)])
def test_path_whose_mtu_falls_in_mid_transfer_is_named_at_both_ends(rate, begins, caplog):
    """The datagrams of packets are lost from then on, in the second case until the receiver gives up."""
    path = Path(serving(limits=ServerLimits(fixed_rate=rate)))
    path.plan = [(begins, lambda: setattr(path, "most_bytes", 900))]
    receiver = path.run(Receiver(5, 0.0, ReceiverOptions()))
    assert receiver.finished == Finished(f"only small datagrams arrive: {SMALL_MTU}", True)
    assert 0 < receiver.collector.num_packets < len(STREAM.packets)
    assert path.now < begins + 8.0
    lines = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert len(lines) == 1
    assert lines[0].startswith("nothing arrives client=")
    assert SMALL_MTU in lines[0]
    assert not any(isinstance(event, Interrupted) for event in path.events)


@pytest.mark.parametrize("loss", [0.3, 0.5])
def test_lossy_path_is_not_taken_for_a_small_mtu(loss, caplog):
    rng = random.Random(3)
    for protection in (Protection(), Protection(retransmit_share=0.0)):
        stalled = transfer(PROGRAM if protection == Protection() else STREAM, protection=protection,
                           down=Link(bernoulli(loss, rng)), up=Link(bernoulli(loss, rng)))  # fmt: skip
        assert "MTU" not in stalled.receiver.finished.reason
    assert not [record for record in caplog.records if "MTU" in record.getMessage()]


def test_idle_view_over_a_lossy_path_is_not_taken_for_a_small_mtu():
    now = 0.1
    welcome = Welcome(5, 1, 9, 1000, b"a" * 32, 256, 60, 1150, 0, (ParityRange(60, 0, 0),), b"", False, True)
    viewer = Receiver(
        5, 0.0, ReceiverOptions(viewpoint=Viewpoint(np.eye(4), 200.0, 320, 240), keep_open=True), reliable=True
    )
    viewer.receive(encode(welcome), now)
    viewer.receive(encode(Data(1, 0, 0, make_packet(PacketId(0, 0), 1, b"", 9).data)), now)
    for number in range(1, 400, 3):
        now += 1.0
        viewer.receive(encode(End(1, number)), now)
        viewer.poll(now)
    assert viewer.finished is None


@pytest.mark.parametrize("is_live", [False, True])
def test_resumed_stream_without_new_data_is_not_taken_for_a_small_mtu(is_live):
    """The server has nothing to send: the view needs no more packets, or the live stream has paused."""
    welcome = Welcome(5, 1, 9, 1000, b"a" * 32, 256, 60, 1150, 0, (ParityRange(60, 0, 0),), b"", is_live, not is_live)
    viewpoint = None if is_live else Viewpoint(np.eye(4), 200.0, 320, 240)
    viewer, now = Receiver(5, 0.0, ReceiverOptions(viewpoint=viewpoint, keep_open=True), reliable=True), 0.1
    viewer.poll(0.0)
    viewer.receive(encode(welcome), now)
    viewer.receive(encode(Data(1, 0, 0, make_packet(PacketId(0, 0), 1, b"", 9).data)), now)
    viewer.reconnect(10.0)
    nonce, now = decode(viewer.poll(10.0)[0][0]).nonce, 10.1
    viewer.receive(encode(welcome._replace(nonce=nonce, session=2)), now)
    for number in range(100):
        now += 0.1 if is_live else 1.0
        viewer.receive(encode(End(2, number)), now)
        viewer.poll(now)
    assert viewer.finished is None


def test_rate_far_above_the_link_is_named_at_both_ends(caplog):
    down = Link(rate=40_000.0)
    result = transfer(PROGRAM, down=down, limits=ServerLimits(fixed_rate=2e6), options=ReceiverOptions(deadline_s=3.0))
    assert result.receiver.finished.reason == "deadline"
    text = result.receiver.describe_missing()
    assert "% of the datagrams were lost: a server with --rate may send faster than the path carries" in text
    (line,) = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert line.startswith("rate too high client=")
    assert "without --rate, the server adapts" in line


@pytest.mark.parametrize("is_live", [True, False])
def test_packets_of_a_live_stream_are_requested_a_limited_number_of_times(is_live):
    tiers = (ParityRange(60, 0, 0),)
    welcome = Welcome(5, 1, 9, 1000, b"a" * 32, 256, 60, 1150, 0, tiers, is_live=is_live)
    receiver, requests, now = Receiver(5, 0.0, reliable=True), 0, 0.1
    receiver.poll(0.0)
    receiver.receive(encode(welcome), now)
    packet = make_packet(PacketId(0, 59), 1, b"", 9)
    receiver.receive(encode(Data(1, 0, 59, packet.data)), now)
    while now < 4.0:
        now += 0.05
        messages = (decode(data) for data in receiver.poll(now)[0])
        requests += sum(isinstance(message, Feedback) and 0 in message.nacks for message in messages)
    assert requests == nack.MAX_NACK_ATTEMPTS if is_live else requests > 20


def test_packets_that_are_not_requested_again_take_no_memory():
    tracker, requested = nack.NackTracker(), []
    tracker.max_attempts = nack.MAX_NACK_ATTEMPTS
    for turn in range(200):
        requested += tracker.due(range(tracker.exhausted, 1000), float(turn))
    assert sorted(requested) == [n for n in range(1000) for _ in range(nack.MAX_NACK_ATTEMPTS)]
    assert (tracker.exhausted, bool(tracker)) == (1000, False)


def test_sequence_jump_is_one_gap_range():
    gaps, largest = GapTracker(), -1
    for jump in range(1, 20_000):  # 2.6 billion numbers, which would take minutes one by one
        gaps.on_received(jump << 17, largest)
        largest = jump << 17
    assert bool(gaps)
    assert len(gaps._starts) == 1
    assert len(gaps.due(largest, 1.0)) == 250


@pytest.mark.slow
def test_gaps_equal_the_missing_sequence_numbers():
    rng = random.Random(7)
    gaps, missing, largest = GapTracker(), set(), -1
    for _ in range(1500):
        number = (
            max(largest + rng.choice((1, 1, 1, 2, 9, 300)), 0) if rng.random() < 0.7 else rng.randrange(largest + 2)
        )
        gaps.on_received(number, largest)
        missing |= set(range(largest + 1, number))
        missing.discard(number)
        missing = set(sorted(missing)[-MAX_GAPS:])
        largest = max(largest, number)
        assert set(gaps._below(largest)) == missing
    for turn in range(nack.MAX_NACK_ATTEMPTS):
        assert gaps.due(largest, 10.0 * turn)[0] == min(missing)


def test_repeated_welcomes_of_a_reliable_stream_say_nothing_about_the_mtu():
    """After an outage, a QUIC stream delivers them all at once, before the first data."""
    tiers = (ParityRange(60, 0, 0),)
    welcome = encode(Welcome(5, 1, 9, 1000, b"a" * 32, 256, 60, 1150, 0, tiers))
    receiver = Receiver(5, 0.0, reliable=True)
    receiver.poll(0.0)
    for _ in range(100):
        receiver.receive(welcome, 0.2)
    receiver.poll(0.3)
    assert receiver.finished is None


def begun_receiver() -> tuple[Receiver, int, float]:
    """A receiver over QUIC with a third of the packets; its session's next sequence number, and the time."""
    receiver, now = Receiver(5, 0.0, reliable=True), 0.0
    sender = ServerTransfer(PROGRAM, 7, ServerLimits(fixed_rate=1e9), 0.0, reliable_init_segment=True, nonce=5)
    receiver.poll(now)
    receiver.receive(sender.welcome(), now)
    while receiver.collector is None or receiver.collector.num_packets < len(STREAM.packets) // 3:
        now += 0.001
        sender.heard_at = now
        if data := sender.poll(now):
            receiver.receive(data, now)
    return receiver, sender._feedback_tracker.sequence, now


def test_many_ends_at_once_after_an_outage_end_no_transfer():
    """QUIC keeps them while nothing is acknowledged. The server has not even got the requests for missing packets."""
    receiver, number, now = begun_receiver()
    receiver.receive(encode(End(7, number)), now)
    for later in range(number + 500, number + 560):  # the outage has lost 500 datagrams
        receiver.receive(encode(End(7, later)), now + 2.0)
    for step in range(10):
        receiver.receive(encode(End(7, number + 560 + step)), now + 2.1 + step / 10)
        receiver.poll(now + 2.1 + step / 10)
        assert receiver.finished is None


def test_losses_after_the_last_data_give_no_advice_about_the_rate():
    """They may have another cause, such as a path whose MTU has fallen."""
    receiver, number, now = begun_receiver()
    for step in range(80):
        now += 0.1
        receiver.receive(encode(End(7, number + 500 + step)), now)
        receiver.poll(now)
        if receiver.finished is not None:
            break
    assert receiver.finished == Finished("sent", True)
    assert step >= 20
    assert "--rate" not in receiver.describe_missing()


@pytest.mark.parametrize("data_arrive", [False, True])
def test_the_log_blames_the_rate_only_while_data_arrive(data_arrive, monkeypatch):
    monkeypatch.setattr(transfer_module, "MIN_LOSS_DATAGRAMS", 50)
    sender, now, received = ServerTransfer(PROGRAM, 7, ServerLimits(fixed_rate=1e9), 0.0), 0.0, 0
    sender.on_feedback(Feedback(7, 0, 0, 0, 0, ()), now)
    ends = 0
    while ends < 30:
        now += 0.01
        sender.heard_at = now
        data = sender.poll(now)
        if data is None:
            continue
        number, is_end = sender._feedback_tracker.sequence - 1, isinstance(decode(data), End)
        ends += is_end
        if is_end or number < 10 or (data_arrive and number % 8 == 0):
            received += 1
            sender.on_feedback(Feedback(7, number, received, int(now * 1e6), 0, ()), now)
    assert ("rate too high" in sender.new_problems()) is data_arrive


@pytest.mark.parametrize("small", [False, True])
def test_silent_server_whose_quic_packets_arrive_suggests_a_small_mtu(small):
    receiver, number, now = begun_receiver()
    for later in range(200):  # most datagrams are lost already
        receiver.receive(encode(Data(7, number + 9 * later, 0, make_packet(PacketId(0, 0), 1, b"", 9).data)), now)
    assert "--rate" in receiver.describe_missing()
    while receiver.finished is None:
        now += 0.1
        receiver.on_quic_packet(40 if small else 1232)
        receiver.poll(now)
    assert receiver.finished.reason.startswith("the server fell silent")
    assert (SMALL_MTU in receiver.finished.reason) is small
    assert "--rate" not in receiver.describe_missing()
