"""Losses in both units: received packets, conversion between units, and saved masks."""

import io

import numpy as np
import pytest

from scenes import tiny_scene
from splatwire.bitstream import Packetization, send_sequence
from splatwire.channel import UNITS, Bernoulli, GilbertElliott, draw_mask, parse_loss, transmit
from splatwire.channel.transmit import datagrams_of, draw_in_order
from splatwire.codec import decode_stream, encode_scene
from splatwire.errors import UnknownNameError
from splatwire.evaluation.study.definition import Loss
from splatwire.evaluation.study.masks import anchor_bytes, mask_bytes, measure_packet_loss

LOSSES = ["bernoulli:0.3", "gilbert:0.2,3", "none"]


@pytest.fixture(scope="module")
def stream():
    return encode_scene(tiny_scene(seed=5, num_anchors=180), Packetization(block_size=60))


@pytest.mark.parametrize("model", LOSSES)
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("order", ["interleaved", "block"])
def test_mask_equals_the_losses_of_the_channel(stream, model, unit, order):
    loss = parse_loss(model, unit)
    mask = draw_mask(stream, loss, seed=7, send_order=order)
    received, record = transmit(stream, loss, seed=7, send_order=order)
    assert mask.apply(stream) == received
    assert mask.num_lost == record.num_lost
    assert record.unit == unit


@pytest.mark.parametrize("order", ["interleaved", "block"])
def test_single_datagram_packets_get_equal_losses_in_both_units(stream, order):
    assert max(packet.num_bytes for packet in stream.packets) <= 1200
    one, two = (draw_mask(stream, parse_loss("gilbert:0.3,2", unit), seed=1, send_order=order) for unit in UNITS)
    assert np.array_equal(one.received, two.received)
    assert one.num_lost_datagrams == two.num_lost_datagrams


@pytest.mark.parametrize("model", [Bernoulli(0.2, unit="datagram"), GilbertElliott(0.2, 3, unit="datagram")])
def test_packet_arrives_only_if_all_its_datagrams_arrive(model):
    sizes = np.array([1, 3, 2, 1, 7, 4])
    received, num_lost = draw_in_order(sizes, model, 5)
    arrived = model.received(int(sizes.sum()), np.random.Generator(np.random.PCG64(5)))
    expected, at = [], 0
    for size in sizes:
        expected.append(bool(arrived[at : at + size].all()))
        at += size
    assert received.tolist() == expected
    assert num_lost == (~arrived).sum() > 0


def test_unknown_loss_unit_is_refused():
    with pytest.raises(UnknownNameError, match="loss unit"):
        parse_loss("bernoulli:0.1", "packet")


def test_packets_are_split_into_datagrams():
    assert datagrams_of(np.array([1, 1200, 1201, 2400, 2401])).tolist() == [1, 1, 2, 2, 3]


def test_loss_rate_converted_between_units_equals_theory():
    stream = encode_scene(tiny_scene(seed=2, num_anchors=600), Packetization(block_size=600, lanes=2))
    sizes = datagrams_of(np.array([packet.num_bytes for packet in stream.packets]))
    assert sizes.min() > 2
    found = measure_packet_loss(stream, "bernoulli:0.1", tuple(range(1000)), "interleaved")
    assert found.datagram_rate == pytest.approx(0.1, abs=0.01)
    assert found.packet_rate == pytest.approx((1 - 0.9**sizes).mean(), abs=0.03)


def test_saved_masks_hold_order_model_and_seed(stream):
    loss, complete = Loss("bernoulli:0.3"), decode_stream(stream)
    mask = draw_mask(stream, loss.process, seed=3)
    saved = np.load(io.BytesIO(mask_bytes(stream, mask, loss, 3)), allow_pickle=False)
    order = [stream.packets[i].id for i in np.argsort(saved["send_index"])]
    assert order == [packet.id for packet in send_sequence(stream, "interleaved")]
    assert (str(saved["loss"]), str(saved["unit"]), int(saved["seed"])) == ("bernoulli:0.3", "pak", 3)
    positions = complete.scene.anchors.positions
    anchors = np.load(io.BytesIO(anchor_bytes(stream, positions)), allow_pickle=False)
    assert sorted(anchors["ranks"].tolist()) == list(range(180))
    known = np.zeros(180, bool)
    for i in np.flatnonzero(saved["received"]):
        known[anchors["ranks"][anchors["starts"][i] : anchors["starts"][i + 1]]] = True
    loss_mask = decode_stream(mask.apply(stream)).loss_mask
    assert np.array_equal(known, loss_mask.fully_received)
    assert np.array_equal(anchors["positions"], positions)
