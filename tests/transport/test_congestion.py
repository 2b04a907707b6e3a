"""Rate control in virtual time: fairness to TCP, random loss and missing feedback."""

import itertools
import random

import pytest

from splatwire.transport import ServerLimits
from splatwire.transport.congestion.cubic import INITIAL_WINDOW, MIN_WINDOW, SEGMENT, CubicWindow
from splatwire.transport.congestion.delivery_rate import DeliveryRateWindow
from splatwire.transport.congestion.pacing import MIN_RATE
from splatwire.transport.congestion.path import LossCounter, LossMeter, QueueMeter
from transport.bottleneck import GROUP_S, LiveSplatwire, Network, Splatwire, throughput
from transport.network import bernoulli, bursts
from transport.tcp_models import Bbr, Cubic

pytestmark = pytest.mark.slow

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
def test_tcp_flow_keeps_between_half_and_twice_its_share(other, mbit, round_trip, products):
    rate = mbit * MBIT
    network = Network(rate, products * rate * round_trip, round_trip)
    ours, theirs = Splatwire(network), other(network, 0.1)
    network.run(45.0)
    share = throughput(theirs, 15.0, 45.0) / (rate / 2)
    assert 0.5 <= share <= 2.0
    assert throughput(ours, 15.0, 45.0) + throughput(theirs, 15.0, 45.0) > 0.9 * rate


@pytest.mark.parametrize(("other", "mbit", "products", "seed"), [(Cubic, 10, 1, 3), (Bbr, 10, 4, 4)])
def test_receiver_with_delay_jitter_does_not_starve_tcp(other, mbit, products, seed):
    """A busy host or Wi-Fi: 1 % of the reports show a datagram 50 ms late without any queue."""
    rate, rng = mbit * MBIT, random.Random(seed)
    network = Network(rate, products * rate * 0.02, 0.02)
    ours = Splatwire(network, late=lambda: 0.05 * rng.random() if rng.random() < 0.01 else 0.0)
    theirs = other(network, 0.1)
    network.run(45.0)
    assert 0.5 <= throughput(theirs, 15.0, 45.0) / (rate / 2) <= 2.0
    assert throughput(ours, 15.0, 45.0) + throughput(theirs, 15.0, 45.0) > 0.9 * rate


@pytest.mark.parametrize(
    ("other", "products", "least", "starts"), [(Cubic, 1, 0.5, (0.1,)), (Bbr, 4, 0.35, (0.1, 0.106, 0.112, 0.118))]
)
def test_oversized_live_clip_leaves_tcp_its_share_and_drops_least_important_motion(other, products, least, starts):
    """The share of the flow similar to BBR is a mean over starts: single runs of 40 s have 0.28 to 0.64."""
    rate, shares = 4 * MBIT, list[float]()
    for start in starts:
        network = Network(rate, products * rate * 0.04, 0.04)
        ours, theirs = LiveSplatwire(network), other(network, start)
        network.run(40.0)
        shares.append(throughput(theirs, 15.0, 40.0) / (rate / 2))
        assert throughput(ours, 15.0, 40.0) + throughput(theirs, 15.0, 40.0) > 0.85 * rate
    assert ours.motion * 1000 / GROUP_S > 1.5 * rate
    assert least <= sum(shares) / len(shares) <= 2.0
    for first in ours.firsts[1:-1]:
        bases, motion = range(first, first + ours.bases), range(first + ours.bases, first + ours.bases + ours.motion)
        assert set(bases) <= ours.left
        sent = [place in ours.left for place in motion]
        assert 0 < sum(sent) < len(sent)
        assert sent == sorted(sent, reverse=True)


def test_two_transfers_share_a_link_with_a_short_queue():
    network = Network(4 * MBIT, 4 * 0.1 * 4 * MBIT, 0.1)
    flows = [Splatwire(network), Splatwire(network, 1.0)]
    network.run(40.0)
    for flow in flows:
        assert 0.5 <= throughput(flow, 15.0, 40.0) / (2 * MBIT) <= 1.5
    assert sum(network.queues[150:]) / len(network.queues[150:]) < 0.05


@pytest.mark.parametrize("products", [1, 4])
def test_single_transfer_uses_the_link(products):
    network = Network(4 * MBIT, products * 0.02 * 4 * MBIT, 0.02)
    flow = Splatwire(network)
    network.run(20.0)
    assert throughput(flow, 5.0, 20.0) > 0.9 * 4 * MBIT
    assert sum(flow.sent) < 1.05 * 20 * 4 * MBIT


@pytest.mark.parametrize("queue", [True, False])
@pytest.mark.parametrize(("loss", "burst"), [(0.05, 1), (0.2, 1), (0.2, 20)])
def test_random_loss_does_not_reduce_the_rate(queue, loss, burst):
    """The next test has CUBIC's throughput for comparison."""
    rate, rng = 4 * MBIT, random.Random(burst)
    lost = bernoulli(loss, rng) if burst == 1 else bursts(loss, burst, rng)
    network = Network(rate if queue else None, 0.2 * rate, 0.05, lost)
    flow = Splatwire(network) if queue else limited(network, rate)
    network.run(30.0)
    assert throughput(flow, 10.0, 30.0) > 0.85 * (1 - loss) * rate


def limited(network, rate):
    return Splatwire(network, limits=ServerLimits(max_sent_ratio=1e9, rate=rate))


def test_random_loss_stalls_the_cubic_model():
    """RFC 9438 allows about five segments per round trip at 5 % loss, which a valid model must show."""
    network = Network(2 * MBIT, 0.2 * 2 * MBIT, 0.05, bernoulli(0.05, random.Random(1)))
    flow = Cubic(network)
    network.run(30.0)
    assert 0.1 < throughput(flow, 10.0, 30.0) / (2 * MBIT) < 0.6


@pytest.mark.parametrize("model", [Cubic, Bbr])
def test_tcp_models_use_an_idle_link(model):
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.05)
    flow = model(network)
    network.run(20.0)
    assert throughput(flow, 5.0, 20.0) > 0.93 * 2 * MBIT


def test_two_cubic_models_share_a_link():
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.05)
    flows = [Cubic(network), Cubic(network, 1.0)]
    network.run(60.0)
    for flow in flows:
        assert 0.6 < throughput(flow, 20.0, 60.0) / MBIT < 1.4


def test_missing_feedback_reduces_the_rate_and_then_stops_sending():
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.05)
    flow = Splatwire(network, deaf=(10.0, 15.0))
    network.run(30.0)
    assert throughput(flow, 5.0, 10.0) > 0.9 * 2 * MBIT
    quiet = [sum(flow.sent[first : first + 2]) / 0.2 for first in range(102, 112, 2)]
    assert all(after <= before * 1.05 for before, after in itertools.pairwise(quiet))
    assert quiet[-1] < 0.3 * 2 * MBIT
    assert sum(flow.sent[112:149]) == 0
    assert throughput(flow, 20.0, 30.0) > 0.85 * 2 * MBIT


def test_total_loss_with_feedback_nearly_stops_sending():
    dark = [False]
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.05, lambda: dark[0])
    flow = Splatwire(network)
    network.run(10.0)
    dark[0] = True
    network.run(20.0)
    assert sum(flow.sent[150:200]) < 5.0 * 2 * MIN_RATE
    dark[0] = False
    network.run(40.0)
    assert throughput(flow, 30.0, 40.0) > 0.85 * 2 * MBIT


def test_extreme_loss_nearly_stops_sending():
    """Loss above any random level is congestion, independent of the queue (RFC 8084)."""
    network = Network(None, 0.0, 0.05, bernoulli(0.7, random.Random(1)))
    flow = Splatwire(network)
    network.run(20.0)
    assert sum(flow.sent[100:200]) / 10.0 < 4 * MIN_WINDOW / 0.05


def test_initial_window_is_tens_of_kilobytes():
    """RFC 6928: ten segments at the start; a slow link is not flooded."""
    network = Network(2 * MBIT, 0.1 * 2 * MBIT, 0.1)
    flow = Splatwire(network)
    network.run(0.3)
    assert sum(flow.sent) < 3 * 10 * SEGMENT


def test_cubic_window_grows_as_in_rfc_9438():
    """W_cubic(t) = C (t - K)^3 + W_max, K = cbrt(W_max (1 - beta) / C): it reaches W_max again after K."""
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


def test_queue_delay_is_relative_to_the_shortest_transit():
    meter = QueueMeter()
    waits = [meter.add(0.1 * n, -500.0 + wait) for n, wait in enumerate([0.02, 0.0, 0.03, 0.04, 0.03, 0.01, 0.3])]
    assert waits == pytest.approx([0.0, 0.0, 0.03, 0.04, 0.03, 0.01, 0.3])
    assert meter.max_delay == pytest.approx(0.03), "a queue that stood for three reports"
    assert meter.is_high(0.02)
    assert not meter.is_high(0.014)
    assert meter.is_low(0.005)
    assert meter.add(100.0, -499.0) == 0.0


def test_loss_that_persists_at_a_lower_rate_is_not_congestion():
    before = LossCounter(200, 40, 10)
    for during, congestion in ((LossCounter(200, 38, 10), False), (LossCounter(200, 2, 1), True)):
        meter = LossMeter()
        assert meter.finish_test(before, during, 0.6) is congestion
        assert (meter.baseline > 0.15) is not congestion
        assert meter.is_congested(LossCounter(20, 5, 1)) is congestion


def test_quic_bytes_in_flight_follow_the_delivery_rate():
    """The window doubles each round trip up to twice the bandwidth-delay product, and losses do not reduce it."""
    window = DeliveryRateWindow()
    sizes, now = [window.bytes], 0.0
    for _ in range(12):
        flight = min(window.bytes, 50_000.0)  # of 1 MB/s and 50 ms
        for _part in range(10):
            now += 0.005
            window.on_acked(now, flight / 10, 0.05)
        sizes.append(window.bytes)
    assert sizes[0] == INITIAL_WINDOW
    assert all(after >= before for before, after in itertools.pairwise(sizes))
    assert sizes[-1] == pytest.approx(100_000, rel=0.1)
    for _ in range(400):
        now += 0.005
        window.on_acked(now, 500.0, 0.15)  # a tenth of that, and a queue of 100 ms
    assert window.bytes < 25_000
