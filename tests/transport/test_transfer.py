"""Both ends over a simulated network: the received stream equals the sent one under all conditions."""

import dataclasses
import itertools
import random
from typing import Any

import pytest

from splatwire.bitstream import HACPP_ANCHORS, Packetization, PacketPlan, make_packet, make_stream, packet_from_bytes
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.planning.transfer_model import StreamLoad, model_transfer
from splatwire.transport import (
    Finished,
    PacketArrived,
    Protection,
    Receiver,
    ReceiverLimits,
    ReceiverOptions,
    Server,
    ServerLimits,
    SideInfoArrived,
    Welcomed,
    make_served_stream,
)
from splatwire.transport.protocol.layout import init_segment, split_init_segment
from splatwire.transport.protocol.messages import (
    MAX_PREVIEW,
    Data,
    Feedback,
    Have,
    Hello,
    InitSymbol,
    Refuse,
    Request,
    Welcome,
)
from splatwire.transport.protocol.preview import SECTION, stream_preview
from splatwire.transport.protocol.send_queue import SendQueue
from splatwire.transport.protocol.transfer import ServerTransfer
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL, PARITY, decode, encode
from transport.network import SECRET, Link, bernoulli, bursts, datagram_stream, tiered_stream, transfer

pytest.importorskip("raptorq", reason="the package raptorq is not installed")
STREAM = datagram_stream()
PROGRAM = make_served_stream(STREAM)


def complete(result) -> None:
    assert result.receiver.finished == Finished("complete", True)
    assert result.receiver.stream() == STREAM
    assert result.receiver.report().complete


def test_lossless_path_delivers_the_stream_without_duplicates():
    result = transfer(PROGRAM)
    complete(result)
    assert result.bytes_down < 1.01 * sum(PROGRAM.sizes().values())
    kinds = [type(event) for event in result.events]
    assert (kinds[0], kinds[-1]) == (Welcomed, Finished)
    assert kinds.count(PacketArrived) == len(STREAM.packets)
    assert kinds.count(SideInfoArrived) == 1
    assert kinds.index(PacketArrived) > kinds.index(SideInfoArrived)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["random", "burst", "rough"])
def test_lossy_paths_deliver_the_stream(kind, seed):
    rng = random.Random(seed)
    link = {
        "random": lambda: Link(bernoulli(0.2, rng)),
        "burst": lambda: Link(bursts(0.2, 20, rng)),
        "rough": lambda: Link(bernoulli(0.3, rng), jitter_s=0.03, duplicate=0.2, rate=2e6),
    }[kind]
    complete(transfer(PROGRAM, down=link(), up=Link(bernoulli(0.2, rng)), seed=seed))


def test_transfer_without_nack_sends_everything_once():
    rng = random.Random(5)
    result = transfer(PROGRAM, down=Link(bernoulli(0.2, rng)), options=ReceiverOptions(nack=False))
    assert result.receiver.finished == Finished("sent", True)
    arrived = result.receiver.collector.num_packets
    assert 0.7 * len(STREAM.packets) < arrived < 0.9 * len(STREAM.packets)
    assert set(result.receiver.stream().packets) < set(STREAM.packets)


def test_parity_restores_the_first_tier():
    stream, protection = tiered_stream(), Protection(init_until=0.1, tier_repair=(0.9,))
    result = transfer(
        stream, protection=protection, down=Link(bernoulli(0.2, random.Random(6))), options=ReceiverOptions(nack=False)
    )
    program = make_served_stream(stream, protection)
    first = set(program.packets[: program.parity_ranges[0].num_packets])
    have = result.receiver.collector
    assert list(have.missing(0, program.parity_ranges[0].num_packets)) == []
    assert have.num_repaired > 0
    assert any(True for _ in have.missing(0, len(program.packets)))
    assert len(first) == program.parity_ranges[0].num_packets
    repaired = [event.packet for event in result.events if isinstance(event, PacketArrived) and event.repaired]
    assert 0 < len(repaired) <= have.num_repaired
    assert set(result.receiver.stream().packets) <= set(stream.packets)


def test_deadline_ends_the_transfer_and_keeps_received_packets():
    options = ReceiverOptions(deadline_s=0.3)
    result = transfer(PROGRAM, options=options, limits=ServerLimits(fixed_rate=1e6))
    assert result.receiver.finished == Finished("deadline", True)
    assert result.ended_at == pytest.approx(0.3, abs=0.01)
    assert 0 < result.receiver.collector.num_packets < len(STREAM.packets)


def test_side_information_is_retransmitted_on_request():
    """No redundancy and no retransmission."""
    program = make_served_stream(STREAM, Protection(init_repair=0.0))
    result = transfer(program, down=Link(bernoulli(0.3, random.Random(1))), options=ReceiverOptions(nack=False))
    assert result.receiver.finished.ok
    assert result.receiver.stream().side_info == STREAM.side_info


@pytest.mark.parametrize("burst", [1, 20])
def test_retransmission_is_limited_and_ordered_by_importance(burst):
    """The init segment is sent first, then tier 0; the receiver learns of the end."""
    stream = tiered_stream()
    program = make_served_stream(stream, Protection(init_repair=0.0, init_until=0.0, retransmit_share=0.08))
    one_pass = sum(program.sizes().values())
    important = sum(packet.id.block < 1 for packet in stream.packets)
    lost_important, spent = 0, []
    for seed in range(6):
        rng = random.Random(seed)
        lost = bernoulli(0.2, rng) if burst == 1 else bursts(0.2, burst, rng)
        result = transfer(program, down=Link(lost, rate=2e6), seed=seed)
        assert result.receiver.finished.ok
        assert result.receiver.stream().side_info == stream.side_info
        spent.append((result.bytes_down - 5_000) / one_pass - 1)  # without handshake and close
        lost_important += important - sum(packet.id.block < 1 for packet in result.receiver.stream().packets)
        if burst == 1:  # a burst may also miss everything
            assert result.receiver.finished.reason == "sent"
            assert len(result.receiver.stream().packets) < len(stream.packets)
    assert lost_important <= 0.08 * 6 * important  # a fifth of all
    if burst == 1:
        assert max(spent) <= 0.08
    else:  # one burst may remove the whole init segment, which is retransmitted in any case
        assert sum(spent) / len(spent) <= 0.08


@pytest.mark.parametrize("burst", [1, 20])
def test_only_the_first_packets_are_retransmitted(burst):
    """All of tier 0 arrives despite losses, without retransmission of the rest."""
    stream = tiered_stream()
    important = sum(packet.id.block < 1 for packet in stream.packets)
    share = important / len(stream.packets)
    program = make_served_stream(stream, Protection(init_repair=0.0, init_until=0.0, retransmit_until=share))
    for seed in range(4):
        rng = random.Random(seed)
        lost = bernoulli(0.2, rng) if burst == 1 else bursts(0.2, burst, rng)
        result = transfer(program, down=Link(lost, rate=2e6), seed=seed)
        assert result.receiver.finished.ok
        assert sum(packet.id.block < 1 for packet in result.receiver.stream().packets) == important
        resent = result.datagrams_down - len(program.schedule)
        assert resent < 3 * (0.5 * sum(map(len, program.init_symbols)) + important)
        if burst == 1:
            assert result.receiver.finished.reason == "sent"
            assert len(result.receiver.stream().packets) < len(stream.packets)


@pytest.mark.parametrize("rate", [5e4, 1e6])
def test_retransmitted_bytes_barely_exceed_lost_bytes(rate):
    """Packets that wait to be sent are not requested again, even from a slow sender."""
    protection = Protection(init_repair=0.0, retransmit_until=0.5)
    program = make_served_stream(datagram_stream(num_anchors=30_000), protection)
    limits, again = ServerLimits(fixed_rate=rate), 0
    for seed in range(3):
        result = transfer(program, down=Link(bernoulli(0.2, random.Random(seed))), seed=seed, limits=limits)
        assert result.receiver.finished == Finished("sent", True)
        again += result.datagrams_down - len(program.schedule) - 27  # two greetings; 25 closes
    wanted = len(program.schedule) - 0.5 * len(program.packets)
    assert 0.9 < again / (3 * 0.2 / 0.8 * wanted) < 1.15


def test_nothing_is_retransmitted_when_disabled():
    program = make_served_stream(STREAM, Protection(init_repair=2.0, retransmit_share=0.0))
    result = transfer(program, down=Link(bernoulli(0.1, random.Random(3))))
    assert result.receiver.finished == Finished("sent", True)
    assert len(result.receiver.stream().packets) < len(STREAM.packets)
    with pytest.raises(InvalidValueError, match="retransmit_share"):
        Protection(retransmit_share=-0.1)
    with pytest.raises(InvalidValueError, match="retransmit_until"):
        Protection(retransmit_until=1.1)


def test_side_information_is_retransmitted_before_the_schedule_ends():
    program = make_served_stream(
        datagram_stream(num_anchors=60_000), Protection(init_repair=0.0, init_until=0.0, retransmit_share=4.0)
    )
    result = transfer(program, down=Link(bernoulli(0.2, random.Random(4)), rate=1e6))
    kinds = [type(event) for event in result.events]
    assert kinds.index(SideInfoArrived) < 0.3 * len(kinds)
    assert result.receiver.finished == Finished("complete", True)


@pytest.mark.slow
def test_transfer_fills_a_link_without_flooding_it():
    """10 Mbit/s with a queue of 100 ms, with and without 20 % of random loss."""
    stream = make_served_stream(datagram_stream(num_anchors=120_000, side_bytes=200_000))
    for loss, seeds in ((0.0, (7,)), (0.2, (7, 8, 9))):
        useful = []
        for seed in seeds:
            lost = bernoulli(loss, random.Random(seed))
            result = transfer(stream, down=Link(lost, rate=1.25e6), options=ReceiverOptions(nack=False))
            useful.append(result.receiver.num_bytes / result.ended_at)
            assert result.receiver.finished.ok
            assert result.bytes_down / result.ended_at < 1.3 * 1.25e6
        assert sum(useful) / len(useful) > 0.7 * (1 - loss) * 1.25e6


def test_unreachable_server_ends_the_transfer():
    result = transfer(PROGRAM, up=Link(lambda: True))
    assert not result.receiver.finished.ok
    assert "no answer" in result.receiver.finished.reason
    assert "quic://" in result.receiver.finished.reason
    assert result.datagrams_down == 0


@pytest.mark.parametrize(
    ("reliable", "connected", "reason"),
    [
        (False, False, "nothing seems to serve UDP there"),
        (True, False, "nothing seems to serve QUIC there"),
        (True, True, "the server accepts connections, but sends nothing"),
    ],
)
def test_a_server_without_an_answer_is_described_for_the_transport(reliable, connected, reason):
    receiver, now = Receiver(5, 0.0, reliable=reliable), 0.0
    if connected:
        receiver.on_connected(now)
    while not receiver.finished and now < 60:
        now += 0.05
        receiver.poll(now)
    assert reason in receiver.finished.reason


def test_refusals_are_reported():
    result = transfer(PROGRAM, options=ReceiverOptions(name="other"))
    assert result.receiver.finished == Finished("no such stream", False)
    result = transfer(PROGRAM, limits=ServerLimits(sessions=0))
    assert result.receiver.finished == Finished("the server is full", False)


def test_stream_beyond_the_limits_is_refused():
    for limits in (
        ReceiverLimits(init_segment_bytes=1000),
        ReceiverLimits(stream_bytes=100_000),
        ReceiverLimits(packets=10),
    ):
        result = transfer(PROGRAM, options=ReceiverOptions(limits=limits))
        assert "the server announces" in result.receiver.finished.reason
        assert result.receiver.collector is None


def test_bursts_leave_packets_of_every_block():
    """Every block keeps some packets under 20 % loss in bursts of 20, because the send order spreads them."""
    stream = datagram_stream(num_anchors=60_000)
    program = make_served_stream(stream)
    for seed in range(3):
        result = transfer(
            program, down=Link(bursts(0.2, 20, random.Random(seed))), seed=seed, options=ReceiverOptions(nack=False)
        )
        blocks = {packet.id.block for packet in result.receiver.stream().packets}
        assert blocks == set(range(20))


def test_init_segment_is_interleaved_with_a_share_of_the_packets():
    def packets_before_its_end(lead: float) -> float:
        schedule = make_served_stream(STREAM, Protection(init_until=lead)).schedule
        last = max(n for n, item in enumerate(schedule) if item[0] == INIT_SYMBOL)
        return sum(item[0] == DATA for item in schedule[:last]) / len(STREAM.packets)

    assert packets_before_its_end(0.0) == 0
    assert packets_before_its_end(0.5) == pytest.approx(0.5, abs=0.02)
    assert packets_before_its_end(1.0) > 0.98


def test_unservable_streams_are_refused():
    with pytest.raises(InvalidValueError, match="only a complete stream"):
        make_served_stream(STREAM.with_packets(STREAM.packets[1:]))
    plan = PacketPlan(Packetization(), 100)
    paper = make_stream(
        packetization=Packetization(), num_elements=100, feature_dim=1, num_offsets=1, feature_groups=(1,),
        side_info=b"s", packets=[make_packet(i, plan.count(i), bytes(2000)) for i in plan.ids], symbols_digest="5" * 64,
        writer="test",
    )  # fmt: skip
    with pytest.raises(InvalidValueError, match="--preset datagram"):
        make_served_stream(paper)
    for wrong in ({"init_repair": 3.0}, {"bundled_share": 1.1}, {"tier_repair": (0.5, 3.0)}):
        with pytest.raises(InvalidValueError):
            Protection(**wrong)


def test_stream_tiers_are_sent_in_order_and_tier_0_survives():
    """Parity for tier 0 restores all of it at 20 % loss; the rest loses a fifth."""
    stream = tiered_stream()
    program = make_served_stream(stream, Protection(tier_repair=(0.9,), parity_until=0.6))
    assert [(tier.num_packets, tier.groups > 0) for tier in program.parity_ranges] == [(23, True), (204, False)]
    tier_of = {p.id: stream.manifest.plan.tier_of(p.id.block) for p in stream.packets}
    kinds = [kind for kind, _, _ in program.schedule]
    sent = [program.packets[n] for kind, _, n in program.schedule if kind == DATA]
    order = [tier_of[packet_from_bytes(data, None).id] for data in sent]
    assert order == [0] * 23 + [1] * 204
    last = max(n for n, kind in enumerate(kinds) if kind == PARITY)
    assert sum(kind == DATA for kind in kinds[:last]) == pytest.approx(0.6 * 227, abs=5)
    for seed in range(3):
        rng = random.Random(seed)
        result = transfer(program, down=Link(bernoulli(0.2, rng)), seed=seed, options=ReceiverOptions(nack=False))
        arrived = [tier_of[packet.id] for packet in result.receiver.stream().packets]
        assert arrived.count(0) == 23
        assert 130 < arrived.count(1) < 190


def test_parity_for_absent_tiers_is_refused():
    with pytest.raises(InvalidValueError, match="encode with --tiers"):
        make_served_stream(STREAM, Protection(tier_repair=(0.4, 0.1)))


def test_packets_bundled_in_the_init_segment_are_protected_with_it():
    """Packets of the head are never sent separately, not even with retransmission of all missing packets."""
    stream = tiered_stream()
    protection = Protection(bundled_share=23 / 227, tier_repair=(0.0, 0.1))
    program = make_served_stream(stream, protection)
    assert [tier.num_packets for tier in program.parity_ranges] == [23, 204]
    assert sorted(n for kind, _, n in program.schedule if kind == DATA) == list(range(23, 227))
    assert sum(program.sizes().values()) == model_transfer(StreamLoad.of_stream(stream), protection).num_bytes.sum()
    for seed in range(3):
        rng = random.Random(seed)
        result = transfer(program, down=Link(bernoulli(0.2, rng)), seed=seed, options=ReceiverOptions(nack=False))
        assert list(result.receiver.collector.missing(0, 23)) == []
        assert set(result.receiver.stream().packets) < set(stream.packets)
        side = next(n for n, event in enumerate(result.events) if isinstance(event, SideInfoArrived))
        with_it = [event.packet for event in result.events[side + 1 : side + 24]]
        assert {packet.id for packet in with_it} <= {packet.id for packet in result.receiver.stream().packets}
    complete_one = transfer(program, down=Link(bursts(0.2, 20, random.Random(3))))
    assert complete_one.receiver.stream() == stream
    everything = transfer(
        make_served_stream(stream, Protection(bundled_share=1.0)), down=Link(bernoulli(0.2, random.Random(4)))
    )
    assert everything.receiver.stream() == stream


def test_init_segment_with_undeclared_packets_ends_the_transfer():
    stream = tiered_stream()
    program = make_served_stream(stream, Protection(bundled_share=0.1))
    for wrong in (program.num_bundled - 1, program.num_bundled + 1, 0):
        result = transfer(dataclasses.replace(program, num_bundled=wrong))
        assert not result.receiver.finished.ok
        assert f"not {wrong}" in result.receiver.finished.reason
    data = init_segment(stream.manifest, stream.side_info, [b"packet", b"other"])
    assert split_init_segment(data)[2] == (b"packet", b"other")
    for cut in (1, 3, 6):
        with pytest.raises(BitstreamError, match="within a packet"):
            split_init_segment(data[:-cut])


def test_small_symbols_are_transferred():
    program = make_served_stream(STREAM, Protection(init_symbol_bytes=128, init_until=1.0))
    assert program.symbol_bytes == 128
    complete(transfer(program, down=Link(bursts(0.2, 20, random.Random(3)))))
    for size in (60, 100, 2000):
        with pytest.raises(InvalidValueError, match="symbols of side information"):
            Protection(init_symbol_bytes=size)


def test_silent_client_is_paused():
    server = Server({"scene": PROGRAM}, secret=SECRET, random=random.Random(0).randbytes)
    receiver = Receiver(7, 0.0)
    pending = receiver.poll(0.0)[0]
    while pending:
        answers = [server.receive("client", data, 0.0) for data in pending]
        pending = [reply for answer in answers if answer for reply in receiver.receive(answer, 0.0)[0]]
    assert server.poll(0.5)
    while server.poll(0.9):
        pass
    assert server.poll(2.0) == []
    server.receive("client", receiver.poll(2.0)[0][0], 2.0)
    assert server.poll(2.0)


def test_one_address_cannot_hold_all_sessions():
    server = Server({"scene": PROGRAM}, secret=SECRET, random=random.Random(0).randbytes)
    requests = [encode(Request(n, bytes(16), "")) for n in range(18)]
    answers = [decode(server.receive("greedy", request, 0.0, reliable=True)) for request in requests]
    assert [type(answer) for answer in answers] == [Welcome] * 16 + [Refuse] * 2
    assert server.num_transfers == 16
    server.forget("greedy")
    assert server.num_transfers == 0


def test_retransmission_of_the_init_segment_sends_new_symbols():
    """New symbols are useful to every client, whereas repeated ones would mostly be duplicates."""
    program = make_served_stream(STREAM, Protection(init_repair=0.1))
    run = ServerTransfer(program, 7, ServerLimits(fixed_rate=1e9), 0.0)
    sent: list[tuple[int, int]] = []

    def polled(now: float) -> None:
        while (data := run.poll(now)) is not None:
            message = decode(data)
            if isinstance(message, InitSymbol):
                sent.append((message.source_block, message.symbol))

    run.on_feedback(Feedback(7, 0, 0, 0, 0, ()), 0.0)
    now = 0.0
    while (at := run.next_at()) is not None and at < 1.0:
        now = max(now, at)
        polled(now)
        run.heard_at = now
    scheduled = {(group, symbol) for kind, group, symbol in program.schedule if kind == INIT_SYMBOL}
    assert set(sent) == scheduled
    missing = len(scheduled) // 5
    run.on_feedback(Feedback(7, 0, 0, 0, missing, ()), 1.0)
    polled(1.5)
    again = sent[len(scheduled) :]
    assert len(again) >= missing
    assert len(set(again)) == len(again)
    assert not scheduled & set(again)


def test_deprecated_name_of_feedback_warns_and_processes_the_report():
    transfer: Any = ServerTransfer(make_served_stream(STREAM), 7, ServerLimits(), 0.0)  # `Any` allows deprecated names
    assert transfer.next_at() is None
    with pytest.warns(DeprecationWarning, match="use on_feedback"):
        transfer.feedback(Feedback(7, 0, 0, 0, 0), 0.0)
    assert transfer.next_at() is not None


def test_preview_is_part_of_the_first_answer():
    """The preview may contain any bytes, and arrives even if no symbol of the side information does."""
    preview = random.Random(0).randbytes(MAX_PREVIEW)
    program = make_served_stream(STREAM, preview=preview)
    sent = itertools.count()
    lost = Link(lambda: next(sent) >= 2)  # challenge and welcome arrive, and nothing after them
    result = transfer(program, down=lost, options=ReceiverOptions(deadline_s=1.0))
    receiver = result.receiver
    assert (receiver.finished, receiver.stream()) == (Finished("deadline", False), None)
    assert receiver.preview == preview
    assert result.events[0] == Welcomed(len(STREAM.packets), program.init_segment_bytes, preview)
    complete(transfer(program, down=Link(bernoulli(0.3, random.Random(3)))))
    assert transfer(PROGRAM).receiver.preview == b""
    with pytest.raises(InvalidValueError, match="at most 1024"):
        make_served_stream(STREAM, preview=bytes(MAX_PREVIEW + 1))


def test_preview_requires_a_token():
    rng = random.Random(0)
    server = Server({"scene": make_served_stream(STREAM, preview=bytes(1000))}, secret=SECRET, random=rng.randbytes)
    assert len(server.receive("me", encode(Hello(1, "")), 0.0)) < 40
    assert server.receive("me", encode(Request(1, bytes(16), "")), 0.0) is None


def test_the_preview_is_found_in_the_side_information():
    from splatwire.bitstream.limits import FORMAT_1_SECTIONS
    from splatwire.codec import preview as codec
    from splatwire.codec import with_section

    assert (codec.SECTION, codec.MAX_PREVIEW_BYTES) == (SECTION, MAX_PREVIEW)
    side_info = b"".join(bytes([n]) + b"x" * n for n in range(len(FORMAT_1_SECTIONS)))
    bare = dataclasses.replace(STREAM, side_info=side_info)
    assert stream_preview(side_info, HACPP_ANCHORS) == b""
    richer = with_section(with_section(bare, "gnn", b"weights"), "preview", b"scene")
    assert stream_preview(with_section(richer, "sketch", b"copies").side_info, HACPP_ANCHORS) == b"scene"
    for damaged in (
        side_info[:-1],
        richer.side_info[:-1],
        b"",
        with_section(bare, "preview", bytes(1025)).side_info,
    ):
        with pytest.raises(BitstreamError):
            stream_preview(damaged, HACPP_ANCHORS)


def answers_to_request(server: Server, nonce: int, haves: list[Have], name: str = "client") -> list:
    """Datagrams that the server sends to a client that reports packets it already has."""
    server.receive(name, encode(Request(nonce, bytes(16), "")), 0.0, reliable=True)
    for have in haves:
        server.receive(name, encode(have), 0.0, reliable=True)
    found = [decode(data) for step in range(400) for _, data in server.poll(step / 400)]
    return [message for message in found if not isinstance(message, Welcome)]


def test_packets_held_by_the_client_are_not_sent_but_counted():
    program = make_served_stream(STREAM, Protection(init_repair=0.0))
    limits = ServerLimits(fixed_rate=1e9)
    server = Server({"scene": program}, secret=SECRET, random=random.Random(0).randbytes, limits=limits)
    count, rng = len(program.packets), random.Random(3)
    held = [rng.random() < 0.6 for _ in range(count)]
    bits = sum(1 << place for place, have in enumerate(held) if have).to_bytes(-(-count // 8), "little")
    cut = len(bits) // 2
    for nonce, stream_id, left_out in ((1, program.stream_id, True), (2, program.stream_id ^ 1, False)):
        haves = [Have(nonce, stream_id, 1, 0, bits[:cut]), Have(nonce, stream_id, 1, 8 * cut, bits[cut:] + bytes(9))]
        messages = answers_to_request(server, nonce, haves * 3, f"client {nonce}")
        places = {message.packet_index for message in messages if isinstance(message, Data)}
        scheduled = set(range(program.num_bundled, count))
        assert places == ({place for place in scheduled if not held[place]} if left_out else scheduled)
        assert any(isinstance(message, InitSymbol) for message in messages) is not left_out
        key = (f"client {nonce}", nonce)
        most = server._transfers[key]._max_bytes
        assert most < 0.6 * server._limits.max_sent_ratio * sum(program.sizes().values()) if left_out else most > 0
    server.receive("client 1", encode(Have(1, program.stream_id, 1, 8 << 25, b"\xff")), 1.0, reliable=True)


LINE, DELAY_S = 2.5e6, 0.05
"""20 Mbit/s, 50 ms each way."""


def test_random_loss_hardly_slows_the_start():
    """A few losses do not end slow start."""
    stream = datagram_stream(num_anchors=18_000)

    def seconds(loss: float, seed: int) -> float:
        down, up = (Link(bernoulli(loss, random.Random(2 * seed + n)), DELAY_S, rate=LINE) for n in range(2))
        return transfer(stream, down=down, up=up, seed=seed).ended_at

    whole = seconds(0.0, 0)
    assert max(seconds(0.05, seed) for seed in range(3)) < 2.0 * whole
    assert max(seconds(0.1, seed) for seed in range(3)) < 2.0 * whole


def test_a_lost_first_flight_does_not_end_slow_start():
    stream, sent = datagram_stream(num_anchors=18_000), itertools.count()
    whole = transfer(stream, down=Link(delay_s=DELAY_S, rate=LINE), up=Link(delay_s=DELAY_S))
    dead = Link(lambda: 1 <= next(sent) < 15, DELAY_S, rate=LINE)  # the first is the answer to the greeting
    late = transfer(stream, down=dead, up=Link(delay_s=DELAY_S))
    assert late.receiver.report().complete
    assert late.ended_at < 2.0 * whole.ended_at


@pytest.mark.parametrize("reliable", [True, False])
def test_stream_that_is_set_again_is_still_sent_whole_if_nothing_may_be_retransmitted(reliable):
    served = make_served_stream(STREAM, Protection(retransmit_until=0.0))
    queue, sent = SendQueue(served, reliable), []
    for _ in range(5):
        sent.append(queue.pop())
    queue.set_stream(served, reliable, len(served.packets))
    while queue:
        sent.append(queue.pop())
    packets = sorted(index for kind, _, index in sent if kind == DATA)
    assert packets == list(range(served.num_bundled, len(served.packets)))
    assert not any(served.may_retransmit(index) for index in packets)
