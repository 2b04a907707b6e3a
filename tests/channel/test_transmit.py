import json

import numpy as np
import pytest

from splatwire.bitstream import (
    Packetization,
    PacketPlan,
    SceneStream,
    TierCounts,
    make_packet,
    make_stream,
    send_sequence,
)
from splatwire.channel import Bernoulli, GilbertElliott, NoLoss, parse_loss, transmit
from splatwire.errors import InvalidValueError, UnknownNameError


def build(num_elements: int = 2400, seed: int = 0, tiers: tuple[TierCounts, ...] = (), **packetization) -> SceneStream:
    p = Packetization(**{"block_size": 100, "lanes": 8, **packetization})
    plan, rng = (
        PacketPlan(p, num_elements, tiers, num_feature_groups=1 if p.separated else 0),
        np.random.default_rng(seed),
    )
    return make_stream(
        packetization=p,
        num_elements=num_elements,
        feature_dim=4,
        num_offsets=2,
        feature_groups=(4,),
        side_info=rng.bytes(50),
        packets=[make_packet(i, plan.count(i), rng.bytes(9)) for i in plan.ids],
        symbols_digest="0" * 64,
        writer="test",
        tiers=tiers,
    )


@pytest.fixture(scope="module")
def stream() -> SceneStream:
    return build()


def test_lossless_channel_returns_the_same_stream(stream):
    arrived, record = transmit(stream, NoLoss(), seed=0)
    assert arrived == stream
    assert (record.num_lost, record.lost, record.bytes_received) == (0, (), record.bytes_sent)


def test_losing_every_packet_keeps_the_side_information(stream):
    arrived, record = transmit(stream, Bernoulli(1.0), seed=0)
    assert (arrived.manifest, arrived.side_info, arrived.packets) == (stream.manifest, stream.side_info, ())
    assert (record.num_lost, record.num_lost_elements) == (len(stream.packets), 2400)


def test_counts_of_the_record_add_up(stream):
    arrived, record = transmit(stream, Bernoulli(0.2), seed=3)
    lost = set(stream.packets) - set(arrived.packets)
    assert 0 < len(lost) == record.num_lost == record.num_sent - len(arrived.packets)
    assert record.lost == tuple(p.id.filename for p in stream.packets if p in lost)
    assert record.num_lost_elements == sum(p.num_elements for p in lost)
    assert record.num_sent_elements == 2400
    assert record.bytes_sent == sum(p.num_bytes for p in stream.packets)
    assert record.bytes_received == sum(p.num_bytes for p in arrived.packets)
    assert record.bytes_protected + record.bytes_sent + stream.part_sizes()["container"] == stream.num_bytes
    content = json.loads(json.dumps(record.to_json()))
    assert (content["unit"], content["loss"], content["seed"], content["send_order"]) == (
        "pak",
        "bernoulli:0.2",
        3,
        "interleaved",
    )
    assert content["lost"] == list(record.lost)


@pytest.mark.parametrize("loss", ["bernoulli:0.2", "gilbert:webrtc-20/3"])
def test_streams_with_equal_packet_counts_get_the_same_mask(stream, loss):
    other = build(seed=9, grouping="contiguous")
    assert len(other.packets) == len(stream.packets)
    masks = [transmit(s, parse_loss(loss), seed=4)[1].lost for s in (stream, other, stream)]
    assert masks[0] == masks[1] == masks[2]
    assert transmit(stream, parse_loss(loss), seed=5)[1].lost != masks[0]


def test_send_orders_follow_their_definition():
    stream = build(300, block_size=100, lanes=2)
    names = [p.id.filename for p in send_sequence(stream, "interleaved")]
    assert names == [f"pak_lane{lane}_s{block}.pak" for lane in range(2) for block in range(3)]
    names = [p.id.filename for p in send_sequence(stream, "block")]
    assert names == [f"pak_lane{lane}_s{block}.pak" for block in range(3) for lane in range(2)]


def empty_blocks(send_order: str) -> int:
    """Number of blocks that lose every packet, summed over 20 loss masks."""
    stream, total = build(12_400), 0
    for seed in range(20):
        arrived, _ = transmit(stream, GilbertElliott(0.2, 20), seed=seed, send_order=send_order)
        total += 124 - len({packet.id.block for packet in arrived.packets})
    return total


def test_interleaving_protects_against_bursts():
    """Lanes protect only if the send order interleaves them.

    In block order, 8 consecutive losses remove a block: a share of 0.2 (1 - 1/20)^7 = 14 % of the blocks.
    """
    assert empty_blocks("interleaved") == 0
    assert empty_blocks("block") / (20 * 124) == pytest.approx(0.2 * 0.95**7, abs=0.02)


def test_anchors_of_separated_packets_are_counted_once():
    stream = build(packaging="separated")
    _, record = transmit(stream, Bernoulli(1.0), seed=0)
    assert (record.num_sent, record.num_lost_elements) == (3 * 24 * 8, 2400)  # scalings, offsets and one feature group


def test_tiers_are_sent_one_after_another():
    tiers = (TierCounts(300, 4), TierCounts(2100, 8))
    stream = build(tiers=tiers)
    tier_of = stream.manifest.plan.tier_of
    sent = send_sequence(stream, "tiers")
    assert set(sent) == set(stream.packets)
    assert [tier_of(packet.id.block) for packet in sent] == [0] * 12 + [1] * 168
    assert [packet.id.block for packet in sent[:4]] == [0, 1, 2, 0]
    assert [tier_of(packet.id.block) for packet in send_sequence(stream, "interleaved")[:24]] == [0] * 3 + [1] * 21
    assert send_sequence(build(), "tiers") == send_sequence(build(), "interleaved")


def test_second_transmission_loses_more_packets(stream):
    once, _ = transmit(stream, Bernoulli(0.2), seed=0)
    twice, record = transmit(once, Bernoulli(0.2), seed=1)
    assert record.num_sent == len(once.packets)
    assert set(twice.packets) < set(once.packets)


def test_invalid_arguments_are_refused(stream):
    with pytest.raises(UnknownNameError, match="send order 'random'"):
        transmit(stream, NoLoss(), seed=0, send_order="random")
    with pytest.raises(InvalidValueError, match="seed"):
        transmit(stream, NoLoss(), seed=-1)


@pytest.mark.parametrize("unit", ["pak", "datagram"])
@pytest.mark.parametrize(
    "mask", [lambda n: np.ones(1, np.bool_), lambda n: np.ones(n, np.int64), lambda n: np.ones(n + 1, np.bool_)]
)
def test_masks_of_loss_models_that_do_not_fit_are_refused(stream, mask, unit):
    """One boolean would count for all packets, and integers would give negative numbers of losses."""

    class Odd:
        name = "odd"

        def __init__(self) -> None:
            self.unit = unit

        def received(self, n: int, rng: np.random.Generator) -> np.ndarray:
            return mask(n)

    with pytest.raises(InvalidValueError, match=r"loss model 'odd' returned .*, not \d+ booleans"):
        transmit(stream, Odd())
