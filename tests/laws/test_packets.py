"""Laws of packets: what holds for every packetization, stream and loss."""

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from splatwire.channel import parse_loss, transmit
from splatwire.packets import (
    Packet,
    Packetization,
    PacketPlan,
    SceneStream,
    make_stream,
    manifest_from_bytes,
    manifest_to_bytes,
    read_stream,
    stream_from_bytes,
    stream_to_bytes,
    write_stream,
)
from splatwire.packets.splitmix64 import splitmix64_reference

laws = settings(max_examples=60, deadline=None)
packetizations = st.builds(
    Packetization,
    block_size=st.integers(1, 300),
    lanes=st.integers(1, 20),
    seed=st.integers(0, (1 << 64) - 1),
    order=st.sampled_from(["morton", "raster"]),
    grouping=st.sampled_from(["stratified", "contiguous"]),
    packaging=st.sampled_from(["atomic", "separated"]),
)
plans = st.builds(PacketPlan, packetizations, st.integers(0, 1500))


@laws
@given(plans)
def test_each_rank_is_in_exactly_one_group(plan):
    num_parts = len(plan.packetization.parts)
    firsts = plan.ids[::num_parts]
    members = [plan.members(packet_id) for packet_id in firsts]
    assert sorted(np.concatenate([np.empty(0, np.int64), *members]).tolist()) == list(range(plan.num_anchors))
    ranks, starts = plan.groups()
    assert len(starts) == len(firsts) + 1
    for g, ours in enumerate(members):
        assert ours.dtype == np.int64
        assert len(ours) == plan.count(firsts[g]) > 0
        assert (np.diff(ours) > 0).all()
        assert ranks[starts[g] : starts[g + 1]].tolist() == ours.tolist()


@laws
@given(plans)
def test_all_views_of_a_plan_agree(plan):
    p, index = plan.packetization, plan.packet_index_of()
    assert index.dtype == np.int32
    assert list(plan.ids) == sorted(set(plan.ids))
    assert {i.block * p.lanes + i.lane for i in plan.ids} == set(index.tolist())
    for packet_id in plan.ids:
        assert (
            plan.members(packet_id).tolist()
            == np.flatnonzero(index == packet_id.block * p.lanes + packet_id.lane).tolist()
        )


@laws
@given(plans)
def test_the_papers_equations(plan):
    p = plan.packetization
    for rank, j in enumerate(plan.packet_index_of().tolist()):
        block, lane = divmod(j, p.lanes)
        assert block == rank // p.block_size
        if p.grouping == "stratified":
            assert lane == splitmix64_reference(rank ^ p.seed) % p.lanes


@laws
@given(plans)
def test_contiguous_runs(plan):
    p = plan.packetization
    plan = PacketPlan(Packetization(p.block_size, p.lanes, grouping="contiguous"), plan.num_anchors)
    index = plan.packet_index_of()
    assert (np.diff(index) >= 0).all()
    for block in range(plan.num_blocks):
        size = min(p.block_size, plan.num_anchors - block * p.block_size)
        counts = np.bincount(index, minlength=plan.num_blocks * p.lanes)[block * p.lanes : (block + 1) * p.lanes]
        assert counts.sum() == size
        assert counts.max() - counts.min() <= 1


def build(packetization: Packetization, num_anchors: int, seed: int) -> SceneStream:
    """A stream of random bytes; built inside the tests because the type checks draw from `random`."""
    plan, rng = PacketPlan(packetization, num_anchors), np.random.default_rng(seed)
    return make_stream(
        packetization=plan.packetization,
        num_anchors=plan.num_anchors,
        feature_dim=7,
        num_offsets=3,
        feature_groups=(2, 5),
        side_info=rng.bytes(int(rng.integers(30))),
        packets=[Packet(i, plan.count(i), rng.bytes(int(rng.integers(9)))) for i in plan.ids],
        symbols_digest="ab" * 32,
        writer="law",
    )


sizes, seeds = st.integers(0, 200), st.integers(0, 99)
losses = st.sampled_from(["none", "bernoulli:0", "bernoulli:0.2", "bernoulli:1", "gilbert:0.2,3", "gilbert:20/20"])


@laws
@given(packetizations, sizes)
def test_a_manifest_reads_back(packetization, num_anchors):
    stream = build(packetization, num_anchors, 0)
    assert manifest_from_bytes(manifest_to_bytes(stream.manifest)) == stream.manifest
    assert stream.manifest.plan.ids == tuple(packet.id for packet in stream.packets)


@laws
@given(packetizations, sizes, losses, seeds)
def test_a_channel_only_removes_packets(packetization, num_anchors, loss, seed):
    stream = build(packetization, num_anchors, seed)
    arrived, record = transmit(stream, parse_loss(loss), seed=seed)
    assert (arrived.manifest, arrived.side_info) == (stream.manifest, stream.side_info)
    assert set(arrived.packets) <= set(stream.packets)
    assert len(arrived.packets) + record.num_lost == len(stream.packets)
    data = stream_to_bytes(arrived)
    assert len(data) == arrived.num_bytes
    again, report = stream_from_bytes(data)
    assert again == arrived
    assert (report.num_missing, report.problems) == (record.num_lost, ())


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(packetizations, sizes, losses, seeds)
def test_directory_and_file_hold_the_same(tmp_path, packetization, num_anchors, loss, seed):
    """Directory, file, and back again; losing packets by the channel or by deleting files is the same."""
    stream = build(packetization, num_anchors, seed)
    arrived, record = transmit(stream, parse_loss(loss), seed=seed)
    write_stream(stream, tmp_path / "stream")
    for name in record.lost:
        (tmp_path / "stream" / name).unlink()
    from_directory = read_stream(tmp_path / "stream")
    write_stream(from_directory[0], tmp_path / "stream.swz")
    assert (tmp_path / "stream.swz").read_bytes() == stream_to_bytes(arrived)
    from_file = read_stream(tmp_path / "stream.swz")
    assert from_directory == from_file
    assert from_file[0] == arrived
