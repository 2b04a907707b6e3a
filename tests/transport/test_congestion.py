"""Laws of the rate control on virtual time: what a TCP beside it gets, what random loss takes, what silence does."""

import itertools
import random

import pytest

from splatwire.transport import ServerLimits
from splatwire.transport.cubic import INITIAL, LEAST, SEGMENT, CubicWindow
from splatwire.transport.delivered import DeliveredWindow
from splatwire.transport.pacing import SLOWEST
from splatwire.transport.path import LossMeter, QueueMeter, Tally
from transport.bottleneck import GROUP_S, LiveSplatwire, Network, Splatwire, throughput
from transport.network import bernoulli, bursts
from transport.tcp_models import Bbr, Cubic

MBIT = 1e6 / 8


@pytest.mark.parametrize(
    ("other", "mbit", "round_trip", "products"),
    [
        (Cubic, 2, 0.02, 1),
        (Cubic, 2, 0.1, 4),
        (Cubic, 2, 0.1, 1),
        (Cubic, 4, 0.02, 4),
        (Bbr, 2, 0.1, 1),
        (Bbr, 2, 0.02, 4),
    ],
)
def test_a_tcp_flow_has_between_half_and_twice_its_share(other, mbit, round_trip, products):
    rate = mbit * MBIT
    network = Network(rate, products * rate * round_trip, round_trip)
    ours, theirs = Splatwire(network), other(network, 0.1)
    network.run(45.0)
    share = throughput(theirs, 15.0, 45.0) / (rate / 2)
    assert 0.5 <= share <= 2.0
    assert throughput(ours, 15.0, 45.0) + throughput(theirs, 15.0, 45.0) > 0.9 * rate


@pytest.mark.parametrize(("other", "mbit", "products", "seed"), [(Cubic, 10, 1, 3), (Bbr, 10, 4, 3), (Bbr, 10, 4, 4)])
def test_a_receiver_that_is_held_up_now_and_then_takes_nothing_from_tcp(other, mbit, products, seed):
    """A busy host, or Wi-Fi: one report in a hundred says that a datagram was 50 ms late, which is no queue."""
    rate, rng = mbit * MBIT, random.Random(seed)
    network = Network(rate, products * rate * 0.02, 0.02)
    ours = Splatwire(network, late=lambda: 0.05 * rng.random() if rng.random() < 0.01 else 0.0)
    theirs = other(network, 0.1)
    network.run(45.0)
    assert 0.5 <= throughput(theirs, 15.0, 45.0) / (rate / 2) <= 2.0
    assert throughput(ours, 15.0, 45.0) + throughput(theirs, 15.0, 45.0) > 0.9 * rate


@pytest.mark.parametrize(("other", "products"), [(Cubic, 1), (Bbr, 4)])
def test_a_live_clip_that_wants_twice_the_link_leaves_tcp_its_share_and_drops_what_is_seen_least(other, products):
    rate, round_trip = 4 * MBIT, 0.04
    network = Network(rate, products * rate * round_trip, round_trip)
    ours, theirs = LiveSplatwire(network), other(network, 0.1)
    network.run(40.0)
    assert ours.motion * 1000 / GROUP_S > 1.5 * rate
    assert 0.5 <= throughput(theirs, 15.0, 40.0) / (rate / 2) <= 2.0
    assert throughput(ours, 15.0, 40.0) + throughput(theirs, 15.0, 40.0) > 0.85 * rate
    for first in ours.firsts[1:-1]:
        bases, motion = range(first, first + ours.bases), range(first + ours.bases, first + ours.bases + ours.motion)
        assert set(bases) <= ours.left
        sent = [place in ours.left for place in motion]
        assert 0 < sum(sent) < len(sent)
        assert sent == sorted(sent, reverse=True)


def test_two_transfers_share_a_link_and_leave_its_queue_short():
    network = Network(4 * MBIT, 4 * 0.1 * 4 * MBIT, 0.1)
    flows = [Splatwire(network), Splatwire(network, 1.0)]
    network.run(40.0)
    for flow in flows:
        assert 0.5 <= throughput(flow, 15.0, 40.0) / (2 * MBIT) <= 1.5
    assert sum(network.queues[150:]) / len(network.queues[150:]) < 0.05


@pytest.mark.parametrize("products", [1, 4])
def test_alone_it_uses_the_link(products):
    network = Network(4 * MBIT, products * 0.02 * 4 * MBIT, 0.02)
    flow = Splatwire(network)
    network.run(20.0)
    assert throughput(flow, 5.0, 20.0) > 0.9 * 4 * MBIT
    assert sum(flow.sent) < 1.05 * 20 * 4 * MBIT


@pytest.mark.parametrize("queue", [True, False])
@pytest.mark.parametrize(("loss", "burst"), [(0.05, 1), (0.2, 1), (0.2, 20)])
def test_random_loss_is_no_congestion(queue, loss, burst):
    """What CUBIC gets there, for comparison, is in the next test."""
    rate, rng = 4 * MBIT, random.Random(burst)
    lost = bernoulli(loss, rng) if burst == 1 else bursts(loss, burst, rng)
    network = Network(rate if queue else None, 0.2 * rate, 0.05, lost)
    flow = Splatwire(network) if queue else limited(network, rate)
    network.run(30.0)
    assert throughput(flow, 10.0, 30.0) > 0.85 * (1 - loss) * rate


def limited(network, rate):
    return Splatwire(network, limits=ServerLimits(passes=1e9, rate=rate))


def test_random_loss_stops_the_model_of_cubic():
    """Else it would be no model of it: RFC 9438 allows some five segments a round trip at 5 % loss."""
    network = Network(2 * MBIT, 0.2 * 2 * MBIT, 0.05, bernoulli(0.05, random.Random(1)))
    flow = Cubic(network)
    network.run(30.0)
    assert 0.1 < throughput(flow, 10.0, 30.0) / (2 * MBIT) < 0.6


@pytest.mark.parametrize("model", [Cubic, Bbr])
def test_the_models_use_a_link_alone(model):
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.05)
    flow = model(network)
    network.run(20.0)
    assert throughput(flow, 5.0, 20.0) > 0.93 * 2 * MBIT


def test_two_models_of_cubic_share():
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.05)
    flows = [Cubic(network), Cubic(network, 1.0)]
    network.run(60.0)
    for flow in flows:
        assert 0.6 < throughput(flow, 20.0, 60.0) / MBIT < 1.4


def test_where_reports_stop_the_rate_falls_and_then_nothing_is_sent_until_they_come_again():
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.05)
    flow = Splatwire(network, deaf=(10.0, 15.0))
    network.run(30.0)
    assert throughput(flow, 5.0, 10.0) > 0.9 * 2 * MBIT
    quiet = [sum(flow.sent[first : first + 2]) / 0.2 for first in range(102, 112, 2)]
    assert all(after <= before * 1.05 for before, after in itertools.pairwise(quiet))
    assert quiet[-1] < 0.3 * 2 * MBIT
    assert sum(flow.sent[112:149]) == 0
    assert throughput(flow, 20.0, 30.0) > 0.85 * 2 * MBIT


def test_where_nothing_arrives_although_reports_come_almost_nothing_is_sent():
    dark = [False]
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.05, lambda: dark[0])
    flow = Splatwire(network)
    network.run(10.0)
    dark[0] = True
    network.run(20.0)
    assert sum(flow.sent[150:200]) < 5.0 * 2 * SLOWEST
    dark[0] = False
    network.run(40.0)
    assert throughput(flow, 30.0, 40.0) > 0.85 * 2 * MBIT


def test_a_path_that_loses_most_of_everything_is_left_alone():
    """What no path loses at random is congestion whatever the queue says (RFC 8084)."""
    network = Network(None, 0.0, 0.05, bernoulli(0.7, random.Random(1)))
    flow = Splatwire(network)
    network.run(20.0)
    assert sum(flow.sent[100:200]) / 10.0 < 4 * LEAST / 0.05


def test_the_first_flight_is_tens_of_kilobytes():
    """RFC 6928: ten segments before anything is known; a slow link beside it is not flooded."""
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.1)
    flow = Splatwire(network)
    network.run(0.3)
    assert sum(flow.sent) < 3 * 10 * SEGMENT


def test_the_window_grows_as_rfc_9438_says():
    """W_cubic(t) = C (t - K)^3 + W_max, K = cbrt(W_max (1 - beta) / C): it is at W_max again after K."""
    window = CubicWindow()
    window.set(1000 * SEGMENT)
    window.reduce()
    assert window.bytes == pytest.approx(700 * SEGMENT)
    k, step = (1000 * 0.3 / 0.4) ** (1 / 3), 0.1
    for n in range(round(k / step)):
        window.grow((n + 1) * step, step, 0.1)
    assert window.bytes == pytest.approx(1000 * SEGMENT, rel=0.01)
    for n in range(round(k / step), round(2 * k / step)):
        window.grow((n + 1) * step, step, 0.1)
    assert window.bytes == pytest.approx(1300 * SEGMENT, rel=0.02)
    window.undo()
    assert window.bytes >= 1300 * SEGMENT


def test_an_empty_queue_is_the_shortest_transit_by_any_clock():
    meter = QueueMeter()
    waits = [meter.add(0.1 * n, -500.0 + wait) for n, wait in enumerate([0.02, 0.0, 0.03, 0.04, 0.03, 0.01, 0.3])]
    assert waits == pytest.approx([0.0, 0.0, 0.03, 0.04, 0.03, 0.01, 0.3])
    assert meter.top == pytest.approx(0.03), "a queue that stood for three reports"
    assert meter.high(0.02)
    assert not meter.high(0.014)
    assert meter.low(0.005)
    assert meter.add(100.0, -499.0) == 0.0


def test_loss_is_usual_once_it_stays_at_a_smaller_rate():
    before = Tally(200, 40, 10)
    for during, congestion in ((Tally(200, 38, 10), False), (Tally(200, 2, 1), True)):
        meter = LossMeter()
        assert meter.judge(before, during, 0.6) is congestion
        assert (meter.usual > 0.15) is not congestion
        assert meter.congested(Tally(20, 5, 1)) is congestion


def test_what_is_under_way_over_quic_follows_what_is_delivered():
    """Twice the bandwidth-delay product of the path: it doubles each round trip up to there, and no loss shrinks it."""
    window = DeliveredWindow()
    sizes, now = [window.bytes], 0.0
    for _ in range(12):
        flight = min(window.bytes, 50_000.0)  # of 1 MB/s and 50 ms
        for _part in range(10):
            now += 0.005
            window.arrived(now, flight / 10, 0.05)
        sizes.append(window.bytes)
    assert sizes[0] == INITIAL
    assert all(after >= before for before, after in itertools.pairwise(sizes))
    assert sizes[-1] == pytest.approx(100_000, rel=0.1)
    for _ in range(400):
        now += 0.005
        window.arrived(now, 500.0, 0.15)  # a tenth of that, and a queue of 100 ms
    assert window.bytes < 25_000
