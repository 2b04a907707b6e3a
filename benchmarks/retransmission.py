"""Quality at 20 % datagram loss with limited retransmission of side information and important packets.

No repair symbols are sent ahead: the head object leaves first, then the tiers. The head object is always retransmitted,
and the first packets (`Protection.retransmit_until`) equally in every transfer. Their share is chosen such that the
mean over other losses, plus one standard error, keeps `--limit` of all bytes, sketches included. So a transfer that
loses more spends more. There is no preview: the side information always arrives. Both ends and a network of 40 ms and 8
Mbit/s are simulated datagram by datagram. The server's greetings arrive; a fifth of the receiver's datagrams is lost at
random. The use of a sketch is chosen on training photos. The mean PSNR against test photos includes all `--transfers`;
of the lossy ones, `--pictures` are rendered.

    python benchmarks/retransmission.py SCENE --data PHOTOS [--limit 0.08] [--transfers 100] [--pictures 10]
"""

import importlib.util
import itertools
import json
import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from protection import scene_parser, sketches
from rate_distortion import REPORTED_SEED, Bench, Variant

from splatwire.bitstream import PRESETS, SceneStream
from splatwire.channel import parse_loss
from splatwire.codec import encode_scene, with_section
from splatwire.concealment.sketch import SECTION
from splatwire.planning.measure import LossyPictures, received_elements
from splatwire.transport import Protection, ServerLimits, make_served_stream
from splatwire.transport.protocol.served_stream import ServedStream

NETWORK = Path(__file__).parents[1] / "tests" / "transport" / "network.py"
CHANNELS = ("bernoulli:0.2", "gilbert:0.2,20")
RATE = 1e6
MAX_SEQUENCE = 20_000
RETRY_HANDSHAKES = 2
"""Datagrams from the server before the transfer: challenge and welcome."""
ROUNDS = 6
NEAR = 0.003
"""Largest unused share of all bytes below the limit."""
FIRST_PLANNED = 100_000
"""First seed of the transfers of the planning; seeds of reported transfers start at 0."""


def network():
    """The network in memory that the tests have."""
    spec = importlib.util.spec_from_file_location("network", NETWORK)
    module = importlib.util.module_from_spec(spec)
    sys.modules["network"] = module
    spec.loader.exec_module(module)
    return module


class Outcome(NamedTuple):
    """Result of one transfer.

    Attributes:
        head: True if the side information arrived.
        packets: Mask of received packets in sending order, bool (P).
        spent: Bytes that the server sent beyond one pass without protection, as a share of all bytes.
    """

    head: bool
    packets: np.ndarray
    spent: float


def loss_pattern(loss_name: str, seed: int):
    """Returns a function that returns True if the next datagram is lost."""
    rng = np.random.Generator(np.random.PCG64([REPORTED_SEED, seed]))
    received = parse_loss(loss_name).received(MAX_SEQUENCE, rng)
    return itertools.cycle((~received).tolist()).__next__


def simulate_transfer(served: ServedStream, plain_bytes: int, loss_name: str, seed: int) -> Outcome:
    """Simulates a transfer to its end."""
    net = network()
    # Reports and handshakes are few, so a burst of twenty losses among them would last for seconds.
    losses = itertools.chain((False,) * RETRY_HANDSHAKES, iter(loss_pattern(loss_name, 2 * seed), None))
    down, up = net.Link(losses.__next__), net.Link(loss_pattern("bernoulli:0.2", 2 * seed + 1))
    limits = ServerLimits(fixed_rate=RATE)
    result = net.transfer(served, down=down, up=up, seed=seed, limits=limits, most_s=120)
    collector, stream = result.receiver.collector, result.receiver.stream()
    packets = np.zeros(len(served.packets), dtype=np.bool_)
    if collector is not None and stream is not None:
        packets[:] = True
        packets[list(collector.missing(0, len(packets)))] = False
    return Outcome(stream is not None, packets, 1 - plain_bytes / max(result.bytes_down, plain_bytes))


def score(variant: Variant, outcomes: list[Outcome], pictures: int, planning: bool) -> dict:
    """Mean PSNR over transfers; complete and empty transfers are counted, some of the others rendered."""
    views = variant.planning if planning else variant.pictures
    parts = [o for o in outcomes if o.head and not o.packets.all()]
    parts.sort(key=lambda o: int((~o.packets) @ variant.planned.load.elements))
    count = min(pictures, len(parts))
    chosen = [parts[int((n + 0.5) / count * len(parts))] for n in range(count)]
    drawn = [views.psnr(received_elements(variant.members, o.packets, views.num_elements)) for o in chosen]
    nothing = sum(not o.head for o in outcomes) / len(outcomes)
    everything = sum(o.head and bool(o.packets.all()) for o in outcomes) / len(outcomes)
    blank = variant.planned.blank_psnr if planning else variant.blank
    psnr = nothing * blank + everything * whole_psnr(views)
    psnr += (1 - nothing - everything) * float(np.mean(drawn)) if drawn else 0.0
    return {"psnr": psnr, "nothing": nothing, "everything": everything, "drawn": drawn}


def whole_psnr(views: LossyPictures) -> float:
    return views.psnr(np.ones(views.num_elements, np.bool_))


class RetransmissionPlan(NamedTuple):
    """A use of the byte limit: for a sketch, if any, and for retransmission."""

    variant: Variant
    sketch_bytes: int
    served: ServedStream
    plain_bytes: int
    score: float


def planned(
    variant: Variant, stream: SceneStream, sketch_bytes: int, loss_name: str, options
) -> RetransmissionPlan | None:
    """Finds the largest number of packets that may be retransmitted within the byte limit."""
    sizes = make_served_stream(stream, Protection(init_repair=0.0)).sizes()
    plain = sum(sizes.values()) - sketch_bytes
    lost = 1 - parse_loss(loss_name).received(200_000, np.random.Generator(np.random.PCG64(FIRST_PLANNED))).mean()
    per_packets = lost / (1 - lost) * sizes["packets"] / plain  # spent where all packets may be sent again
    share, best = float(np.clip((options.limit - sizes["init_segment"] / plain * lost) / per_packets, 0, 1)), None
    for _ in range(ROUNDS):
        protection = Protection(init_repair=0.0, retransmit_until=share)
        served = make_served_stream(stream, protection)
        seeds = range(FIRST_PLANNED, FIRST_PLANNED + options.planned)
        outcomes = [simulate_transfer(served, plain, loss_name, seed) for seed in seeds]
        spent = np.array([outcome.spent for outcome in outcomes])
        room = options.limit - float(spent.mean() + spent.std() / math.sqrt(len(spent)))
        print(f"sketch {sketch_bytes}: until {share:.3f} spends {spent.mean():.2%}", file=sys.stderr, flush=True)
        if room >= 0 and (best is None or share > best[1].num_retransmittable / len(served.packets)):
            best = (outcomes, served)
        if 0 <= room < NEAR or (share == 0 and room < 0) or (share == 1 and room >= 0):
            break
        share = float(np.clip(share + (room - NEAR / 2) / per_packets, 0, 1))
    if best is None:
        return None
    return RetransmissionPlan(variant, sketch_bytes, best[1], plain, score(variant, best[0], 6, True)["psnr"])


def row_of(found: list[tuple[Variant, SceneStream, int]], loss_name: str, options) -> dict:
    """The use of the byte limit that is best on training photos, scored on test photos."""
    ways = [planned(variant, stream, size, loss_name, options) for variant, stream, size in found]
    plan = max((plan for plan in ways if plan is not None), key=lambda plan: plan.score)
    outcomes = [simulate_transfer(plan.served, plan.plain_bytes, loss_name, seed) for seed in range(options.transfers)]
    row = {"loss": loss_name, **score(plan.variant, outcomes, options.pictures, False)}
    spent = [outcome.spent for outcome in outcomes]
    return row | {
        "drop_db": whole_psnr(plan.variant.pictures) - row["psnr"], "spent_mean": float(np.mean(spent)),
        "spent_most": max(spent), "retransmit_until": plan.served.num_retransmittable / len(plan.served.packets),
        "sketch_bytes": plan.sketch_bytes,
    }  # fmt: skip


def main() -> None:
    parser = scene_parser(__doc__.splitlines()[0])
    parser.set_defaults(views=3, pictures=10, tiers=[0.03, 0.05, 0.1, 0.2], sketch=[0.015, 0.03])
    parser.add_argument("--transfers", type=int, default=100)
    parser.add_argument("--planned", type=int, default=40, help="transfers simulated for each choice of the planning")
    arguments = parser.parse_args()
    bench = Bench(arguments)
    stream = encode_scene(bench.scene, PRESETS["datagram"], tiers=bench.tiers)
    found = [(bench.variant(stream, bench.concealer), stream, 0)]
    for section in sketches(bench, stream, arguments.sketch):
        richer = with_section(stream, SECTION, section)
        found.append((bench.variant(richer, SECTION, len(section)), richer, len(section)))
    rows = [row_of(found, loss_name, arguments) for loss_name in CHANNELS]
    for row in rows:
        text = f"{row['loss']}: -{row['drop_db']:.2f} dB, {row['spent_mean']:.2%} spent, sketch {row['sketch_bytes']}"
        print(text, file=sys.stderr, flush=True)
    whole = whole_psnr(found[0][0].pictures)
    print(json.dumps({"scene": arguments.scene.name, "concealer": bench.concealer, "whole_psnr": whole,
                      "limit": arguments.limit, "tiers": arguments.tiers, "transfers": arguments.transfers,
                      "rows": rows}, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
