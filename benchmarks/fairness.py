"""What a TCP flow gets beside a splatwire transfer on a full link, and what a transfer gets where loss is random.

    python benchmarks/fairness.py [--seconds 60] [--rates 2 10 50] > benchmarks/results/fairness.json

Simulated on virtual time (tests/transport/bottleneck.py): the real sender and rate control beside models of TCP (CUBIC
of RFC 9438, one of BBR's kind), one drop-tail queue, 1 or 4 bandwidth-delay products long. Shares are of what each flow
would have if both had the same, over the last two thirds of the time. Deterministic. Prints one JSON object.
"""

import argparse
import json
import os
import random
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parent.parent / "tests")  # `transport` is the tests', not the benchmark

from splatwire.transport import ServerLimits  # noqa: E402
from transport.bottleneck import Network, Splatwire, throughput  # noqa: E402
from transport.network import bernoulli, bursts  # noqa: E402
from transport.tcp_models import Bbr, Cubic  # noqa: E402

FLOWS = {"splatwire": Splatwire, "cubic": Cubic, "bbr": Bbr}
PAIRS = [("splatwire", "cubic"), ("splatwire", "bbr"), ("splatwire", "splatwire"), ("cubic", "cubic"), ("cubic", "bbr")]
ROUND_TRIPS, QUEUES = (0.02, 0.1), (1, 4)
JOINS_S = 0.1
MBIT = 1e6 / 8


def flow(kind: str, network: Network, begin: float):
    if kind == "splatwire":
        # nobody's link is slower than a 20th of what is allowed; the control of before would never stop growing
        return Splatwire(network, begin, limits=ServerLimits(passes=1e9, rate=20 * (network.rate or 1e9)))
    return FLOWS[kind](network, begin)


def share(kinds: tuple[str, ...], rate: float, round_trip: float, products: float, seconds: float) -> dict:
    network = Network(rate, products * rate * round_trip, round_trip)
    flows = [flow(kind, network, n * JOINS_S) for n, kind in enumerate(kinds)]
    network.run(seconds)
    late = network.queues[len(network.queues) // 3 :]
    return {
        "flows": " beside ".join(kinds),
        "mbit_s": rate / MBIT,
        "round_trip_ms": 1e3 * round_trip,
        "queue_products": products,
        "shares": [round(throughput(f, seconds / 3, seconds) / rate * len(kinds), 2) for f in flows],
        "mean_queue_ms": round(1e3 * sum(late) / len(late), 1),
    }


def random_loss(rate: float, round_trip: float, loss: float, burst: int, queue: bool, seconds: float) -> dict:
    """One transfer over a link that loses at random; without a queue, the sender's own limit is the link's rate."""
    rng = random.Random(1)
    lost = bernoulli(loss, rng) if burst == 1 else bursts(loss, burst, rng)
    network = Network(rate if queue else None, 4 * rate * round_trip, round_trip, lost)
    limits = ServerLimits(passes=1e9, rate=20 * rate if queue else rate)
    transfer = Splatwire(network, limits=limits)
    network.run(seconds)
    return {
        "mbit_s": rate / MBIT,
        "round_trip_ms": 1e3 * round_trip,
        "loss": loss,
        "burst": burst,
        "queue": "4 products" if queue else "none",
        "first_5_s": round(throughput(transfer, 0, 5) / rate / (1 - loss), 2),
        "afterwards": round(throughput(transfer, 10, seconds) / rate / (1 - loss), 2),
        "mean_queue_ms": round(1e3 * sum(network.queues) / len(network.queues), 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rates", type=float, nargs="+", default=[2.0, 10.0, 50.0], help="Mbit/s")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    with ProcessPoolExecutor(arguments.processes) as pool:
        shares = [
            pool.submit(share, kinds, mbit * MBIT, round_trip, products, arguments.seconds)
            for kinds in PAIRS
            for mbit in arguments.rates
            for round_trip in ROUND_TRIPS
            for products in QUEUES
        ]
        lossy = [
            pool.submit(random_loss, mbit * MBIT, round_trip, loss, burst, queue, arguments.seconds)
            for mbit in arguments.rates
            for queue in (True, False)
            for round_trip in ROUND_TRIPS
            for loss in (0.05, 0.1, 0.2)
            for burst in (1, 20)
        ]
        result = {
            "seconds": arguments.seconds,
            "shares": [row.result() for row in shares],
            "random_loss": [row.result() for row in lossy],
        }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
