import time

import numpy as np
import pytest

from splatwire.bitstream import (
    PRESETS,
    PacketId,
    Packetization,
    PacketPlan,
    TierCounts,
    packetization_named,
    spread_packetization,
)
from splatwire.bitstream.grouping import contiguous_bounds
from splatwire.errors import InvalidValueError, UnknownNameError


def test_paper_preset_follows_the_paper():
    assert PRESETS["paper"] == Packetization(3000, 8, 1337, "morton", "stratified", "atomic")


def test_hollywood_scene_has_124_blocks_as_in_the_paper():
    plan = PacketPlan(PRESETS["paper"], 369_941)
    assert plan.num_blocks == 124
    assert len(plan.ids) == 124 * 8


def test_millions_of_anchors_take_seconds_not_minutes():
    start = time.process_time()
    plan = PacketPlan(PRESETS["paper"], 2_000_000)
    groups = plan.all_members()
    assert len(groups.starts) == len(plan.ids) + 1
    assert time.process_time() - start < 5


def test_contiguous_runs_are_as_equal_as_possible():
    assert contiguous_bounds(10, 4).tolist() == [0, 3, 6, 8, 10]
    plan = PacketPlan(Packetization(block_size=10, lanes=4, grouping="contiguous"), 13)
    found = {i.filename: plan.members(i).tolist() for i in plan.ids}
    assert found == {
        "pak_lane0_s0.pak": [0, 1, 2],
        "pak_lane1_s0.pak": [3, 4, 5],
        "pak_lane2_s0.pak": [6, 7],
        "pak_lane3_s0.pak": [8, 9],
        "pak_lane0_s1.pak": [10],
        "pak_lane1_s1.pak": [11],
        "pak_lane2_s1.pak": [12],
    }


def test_separated_packaging_has_a_packet_for_each_file_of_hacpp():
    plan = PacketPlan(Packetization(block_size=10, lanes=1, packaging="separated"), 11, num_feature_groups=2)
    assert [i.filename for i in plan.ids] == [
        f"pak_lane0_s{block}_{part}.pak" for block in (0, 1) for part in ("scaling", "offset", "feature0", "feature1")
    ]
    assert plan.all_members().starts.tolist() == [0, 10, 11]


def test_empty_scene_has_an_empty_plan():
    plan = PacketPlan(Packetization(), 0)
    assert (plan.num_blocks, plan.ids, plan.packet_index_of().size) == (0, (), 0)
    assert plan.all_members().starts.tolist() == [0]


@pytest.mark.parametrize(
    "packet_id", [PacketId(0, 0), PacketId(16_777_215, 255), PacketId(7, 3, 2), PacketId(7, 3, 66)]
)
def test_packet_file_names_round_trip(packet_id):
    assert PacketId.from_filename(packet_id.filename) == packet_id


@pytest.mark.parametrize(
    "name",
    [
        "",
        "x.pak",
        "pak_lane01_s0.pak",
        "pak_lane0_s0.pak\n",
        "pak_lane-1_s0.pak",
        "pak_lane0_s0_anchor.pak",
        "pak_lane0_s0_feature64.pak",
        "pak_lane0_s0_feature01.pak",
        "pak_lane٣_s0.pak",
    ],
)
def test_other_names_are_refused(name):
    with pytest.raises(InvalidValueError, match="packet name"):
        PacketId.from_filename(name)


@pytest.mark.parametrize(
    "change",
    [
        {"block_size": 0},
        {"block_size": 65536},
        {"lanes": 0},
        {"lanes": 257},
        {"seed": -1},
        {"seed": 1 << 64},
    ],
)
def test_plan_numbers_out_of_range_are_refused(change):
    with pytest.raises(InvalidValueError, match=str(next(iter(change.values())))):
        Packetization(**change)


@pytest.mark.parametrize("field", ["order", "grouping", "packaging"])
def test_unknown_preset_names_are_refused(field):
    with pytest.raises(UnknownNameError, match=f"unknown {field} 'hilbert'"):
        Packetization(**{field: "hilbert"})


def test_plan_refuses_values_outside_the_format():
    with pytest.raises(InvalidValueError, match="number of elements"):
        PacketPlan(Packetization(), (1 << 28) + 1)
    with pytest.raises(InvalidValueError, match="number of blocks"):
        PacketPlan(Packetization(block_size=1), 1 << 28)
    with pytest.raises(InvalidValueError, match="feature groups"):
        PacketPlan(PRESETS["hacpp"], 10)
    with pytest.raises(InvalidValueError, match="feature groups"):
        PacketPlan(Packetization(), 10, num_feature_groups=5)
    with pytest.raises(InvalidValueError, match="block"):
        PacketPlan(Packetization(), 10).members(PacketId(1, 0))


def test_lanes_are_balanced():
    counts = np.bincount(PacketPlan(PRESETS["paper"], 400_000).packet_index_of() % 8)
    assert np.abs(counts / 50_000 - 1).max() < 0.02


@pytest.mark.parametrize(
    "packetization",
    [
        PRESETS["paper"],
        PRESETS["datagram"],
        Packetization(block_size=7, lanes=3, grouping="contiguous"),
        Packetization(block_size=1, lanes=200),
        Packetization(block_size=50_000, lanes=5),
    ],
)
@pytest.mark.parametrize("tiers", [(), (TierCounts(20_001, 2), TierCounts(179_999, 1))])
def test_blockwise_ranks_and_counts_equal_the_global_ones(packetization: Packetization, tiers: tuple[TierCounts, ...]):
    if tiers:
        lanes = min(2, packetization.lanes)
        tiers = tuple(TierCounts(tier.num_elements, lanes) for tier in tiers)
    plan = PacketPlan(packetization, 200_000, tiers)
    some = range(0, plan.num_blocks, max(plan.num_blocks // 50, 1))
    edges = np.cumsum([0, *(plan.block_elements(block) for block in range(plan.num_blocks))])
    ranks, starts = plan.all_members()
    for block in [*some, plan.num_blocks - 1]:
        assert plan.block_indices(block).tolist() == ranks[edges[block] : edges[block + 1]].tolist()
    if not packetization.hashed:
        index = plan.packet_index_of()
        assert plan.member_counts().tolist() == np.unique(index, return_counts=True)[1].tolist()
        assert starts.tolist() == [0, *np.cumsum(plan.member_counts())]


@pytest.mark.parametrize("num_elements", [0, 1, 375, 376, 3000, 24_018, 65_535, 65_536, 369_941, 9_000_000])
def test_scene_wide_lanes_hold_as_many_anchors_as_paper_lanes(num_elements: int) -> None:
    packetization = spread_packetization(num_elements)
    plan = PacketPlan(packetization, num_elements)
    assert plan.num_blocks == -(-num_elements // ((1 << 16) - 1))  # the maximum of the packet name
    sizes = [plan.block_elements(block) for block in range(plan.num_blocks)]
    assert sum(sizes) == num_elements
    assert max(sizes, default=0) - min(sizes, default=0) < max(plan.num_blocks, 1)  # no small packet is left at the end
    assert packetization.lanes == 8 or 333 < packetization.block_size / packetization.lanes <= 375


def test_packetizations_have_names_and_a_default_for_each_kind_of_element() -> None:
    assert packetization_named("spread", "gaussians", 10_000) == spread_packetization(10_000)
    assert packetization_named(None, "causal", 10_000) == spread_packetization(10_000)
    assert packetization_named(None, "gaussians", 10_000) == PRESETS["paper"]
    assert all(packetization_named(name, "hacpp", 5) == preset for name, preset in PRESETS.items())
    with pytest.raises(UnknownNameError, match="wide"):
        packetization_named("wide", "causal", 5)
