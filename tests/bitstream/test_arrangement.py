from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reference.splitmix64 import splitmix64_reference
from splatwire.bitstream import (
    PRESETS,
    Packet,
    PacketId,
    PacketIntake,
    Packetization,
    PacketPlan,
    SceneStream,
    assign_packets,
    make_packet,
    make_stream,
    manifest_from_bytes,
    manifest_to_bytes,
    stream_from_bytes,
    stream_to_bytes,
)
from splatwire.channel.transmit import datagrams_of
from splatwire.errors import InvalidValueError, UnknownNameError

HASHED = Packetization(block_size=50, lanes=1, grouping="hashed", packet_bytes=128)


def hashed_stream(num_elements: int, rng: np.random.Generator, packetization: Packetization = HASHED) -> SceneStream:
    """A stream with random packet boundaries."""
    plan, packets = PacketPlan(packetization, num_elements), []
    for block in range(plan.num_blocks):
        position = 0
        while position < plan.block_elements(block):
            size = min(int(rng.integers(1, 20)), plan.block_elements(block) - position)
            packets.append(make_packet(PacketId(block, position), size, rng.bytes(int(rng.integers(1, 100)))))
            position += size
    return make_stream(
        packetization=packetization,
        num_elements=num_elements,
        feature_dim=3,
        num_offsets=2,
        feature_groups=(1, 2),
        side_info=b"side",
        packets=packets,
        symbols_digest="5" * 64,
        writer="test",
    )


@settings(deadline=None)
@given(st.integers(1, 230), st.integers(0, 2**32), st.floats(0, 1))
def test_arrived_and_missing_anchors_are_complementary(num_elements, seed, loss):
    rng = np.random.default_rng(seed)
    stream = hashed_stream(num_elements, rng)
    kept = [packet for packet in stream.packets if rng.random() >= loss]
    (ranks, starts), packets = assign_packets(stream.manifest.plan, kept)
    assert sorted(ranks.tolist()) == list(range(num_elements))
    assert [packet for packet in packets if packet is not None] == kept
    for packet, start, stop in zip(packets, starts[:-1], starts[1:], strict=True):
        assert stop > start
        if packet is not None:
            assert ranks[start:stop].tolist() == expected_ranks(packet, num_elements)
            assert stream.manifest.plan.members(packet.id, packet.num_elements).tolist() == ranks[start:stop].tolist()


def expected_ranks(packet: Packet, num_elements: int) -> list[int]:
    block = range(packet.id.block * 50, min(packet.id.block * 50 + 50, num_elements))
    hashed = sorted(block, key=lambda rank: splitmix64_reference(rank ^ HASHED.seed))
    return hashed[packet.id.index_in_block : packet.id.index_in_block + packet.num_elements]


def test_fixed_plans_keep_their_arrangement():
    plan = PacketPlan(Packetization(block_size=10, lanes=3), 25)
    kept = [make_packet(i, plan.count(i), b"x") for i in plan.ids[::2]]
    groups, packets = assign_packets(plan, kept)
    assert groups.indices.tolist() == plan.all_members().indices.tolist()
    assert [i for i, packet in zip(plan.ids, packets, strict=True) if packet] == list(plan.ids[::2])


def test_arrangement_round_trips_through_bytes():
    stream = hashed_stream(230, np.random.default_rng(1))
    again, report = stream_from_bytes(stream_to_bytes(stream))
    assert again == stream
    assert report.complete
    assert manifest_from_bytes(manifest_to_bytes(stream.manifest)) == stream.manifest


def test_packet_size_is_stored_only_for_hashed_packets():
    """Manifests and ids of other streams are unchanged since before datagrams."""
    stream = hashed_stream(9, np.random.default_rng(1))
    assert b'"packet_bytes":128' in manifest_to_bytes(stream.manifest)
    plain = make_stream(
        packetization=PRESETS["paper"], num_elements=0, feature_dim=1, num_offsets=1, feature_groups=(1,),
        side_info=b"", packets=[], symbols_digest="5" * 64, writer="test",
    )  # fmt: skip
    assert b"packet_bytes" not in manifest_to_bytes(plain.manifest)


def test_incomplete_overlapping_or_large_packets_are_refused():
    stream = hashed_stream(120, np.random.default_rng(2))
    m = stream.manifest
    facts = {
        "packetization": m.packetization, "num_elements": m.num_elements, "feature_dim": 3, "num_offsets": 2,
        "feature_groups": (1, 2), "side_info": b"side", "symbols_digest": "5" * 64, "writer": "test",
    }  # fmt: skip
    first, second, *rest = stream.packets
    bad = [
        [second, *rest],
        stream.packets[:-1],
        [make_packet(first.id, first.num_elements + 1, b"x"), second, *rest],
        [make_packet(first.id, first.num_elements, bytes(113)), second, *rest],
    ]
    for packets in bad:
        with pytest.raises(InvalidValueError):
            make_stream(packets=packets, **facts)
    assert make_stream(packets=stream.packets, **facts) == stream


def test_intake_refuses_packets_with_overlapping_anchors():
    stream = hashed_stream(120, np.random.default_rng(3))
    intake = PacketIntake(stream.manifest)

    def offer(block: int, first: int, count: int, size: int = 5) -> Packet | None:
        packet = make_packet(PacketId(block, first), count, bytes(size), stream.manifest.stream_id)
        return intake.add_bytes(packet.data, "test")

    assert offer(0, 10, 10)
    for first, count in ((5, 6), (19, 1), (10, 9), (0, 50), (45, 6), (50, 1), (12, 3)):
        assert offer(0, first, count) is None
    assert offer(3, 0, 1) is None
    assert offer(2, 19, 2) is None
    assert offer(1, 0, 1, size=113) is None
    assert intake.report().num_corrupt == 10
    assert offer(0, 10, 10) is None
    assert intake.report().num_duplicate == 1
    assert offer(0, 0, 10)
    assert offer(0, 20, 30)
    assert len(intake.packets) == 3


def test_intake_keeps_no_more_packets_than_announced():
    stream = hashed_stream(120, np.random.default_rng(3))
    intake = PacketIntake(stream.manifest)
    for rank in range(120):
        packet = make_packet(PacketId(rank // 50, rank % 50), 1, b"x", stream.manifest.stream_id)
        intake.add_bytes(packet.data, "test")
    assert len(intake.packets) == stream.manifest.num_packets


@pytest.mark.parametrize(
    "changes",
    [
        {"packet_bytes": 0},
        {"packet_bytes": 65_508},
        {"lanes": 2},
        {"block_size": (1 << 14) + 1},
        {"packaging": "separated"},
        {"grouping": "stratified"},
    ],
)
def test_contradictions_are_refused(changes):
    with pytest.raises((InvalidValueError, UnknownNameError)):
        Packetization(**{"block_size": 50, "lanes": 1, "grouping": "hashed", "packet_bytes": 128, **changes})


def test_packets_grouped_by_hash_are_not_listed_without_side_information():
    plan = PacketPlan(PRESETS["datagram"], 5000)
    for question in (lambda: plan.ids, plan.packet_index_of, lambda: plan.members(PacketId(0, 0))):
        with pytest.raises(InvalidValueError):
            question()


@pytest.mark.parametrize(
    ("packet_bytes", "unit"), [(1150, "datagram"), (1200, "datagram"), (1201, "pak"), (9000, "pak")]
)
def test_losses_are_of_datagrams_if_no_packet_can_exceed_one(packet_bytes: int, unit: str) -> None:
    packetization = replace(PRESETS["datagram"], packet_bytes=packet_bytes)
    assert packetization.loss_unit == unit
    assert (datagrams_of(np.array([packet_bytes])).item() == 1) == (unit == "datagram")
    assert PRESETS["paper"].loss_unit == "pak"
