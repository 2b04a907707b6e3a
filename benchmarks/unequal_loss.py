"""Losses that tiers of importance leave behind: what growing does where everything that matters is there.

Patterns of lost datagrams: all alike; a share of the least important tier; the end of the transfer cut off; all but the
first tiers. `heads` is `grow` with neighbours counted by number instead of by expected size.

    python benchmarks/unequal_loss.py SCENE --data PHOTOS [--views 3] [--seeds 2] > unequal_loss.json
"""

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from frontier import TIERS, Bench

from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import AnchorContext, Concealed, Concealer, Drop, Grow, conceal, create_concealer
from splatwire.conceal.grow import lost_share
from splatwire.metrics import decibels
from splatwire.packets import PRESETS
from splatwire.plan.measure import known_anchors, packet_members, without
from splatwire.plan.outline import StreamLoad
from splatwire.render import iterate_views


@dataclass(frozen=True)
class Heads:
    """`Grow` as it was: every neighbour counts alike."""

    name: str = "heads"

    def __call__(self, context: AnchorContext) -> Concealed:
        rule, known, dropped = Grow(), context.erasures.known, Drop()(context)
        gain = rule.gain(1 - lost_share(context.anchors.positions, known, rule.neighbors), known)
        return Concealed(dropped.anchors, torch.where(known, gain, torch.ones_like(gain)), dropped.left_out)


def patterns(load: StreamLoad, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Packets that are there, in sending order (tier by tier), by what happened to the others."""
    num, last = len(load.tiers), load.num_tiers - 1
    lost = {share: rng.random(num) < share for share in (0.2, 0.3)}
    place = np.arange(num)
    return {
        "all tiers 20 %": ~lost[0.2],
        "last tier 30 %": ~(lost[0.3] & (load.tiers == last)),
        "all but tier 0, 20 %": ~(lost[0.2] & (load.tiers > 0)),
        "last eighth of the packets": place < 7 * num // 8,
        "last 45 % of the packets": place < 55 * num // 100,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="stream (.swz) or scene file")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--tiers", nargs="+", type=float, default=TIERS)
    parser.set_defaults(conceal="grow", planning_views=1)  # the planner is not asked here
    arguments = parser.parse_args()
    bench = Bench(arguments)
    stream = encode_scene(bench.scene, PRESETS["datagram"], tiers=bench.tiers)
    complete, members, load = decode_stream(stream), packet_members(stream), StreamLoad.of_stream(stream)
    num_anchors = complete.scene.anchors.num_anchors
    methods: list[Concealer] = [create_concealer("drop"), Heads(), create_concealer("grow"),
                                create_concealer("scene_free")]  # fmt: skip
    found: dict[str, dict[str, list[float]]] = {}
    for seed in range(arguments.seeds):
        for name, packets in patterns(load, np.random.default_rng(seed)).items():
            partial = without(complete, known_anchors(members, packets, num_anchors))
            for method in methods:
                pictures = iterate_views(conceal(partial, method), bench.test.cameras)
                errors = [(a - b).double().square().mean() for a, b in zip(pictures, bench.photos, strict=True)]
                score = float(decibels(torch.stack(errors)).mean())
                found.setdefault(name, {}).setdefault(method.name, []).append(score)
        print(f"loss {seed + 1} of {arguments.seeds}", file=sys.stderr, flush=True)
    mean = {name: {way: float(np.mean(scores)) for way, scores in ways.items()} for name, ways in found.items()}
    print(json.dumps({"scene": arguments.scene.name, "views": arguments.views, "seeds": arguments.seeds,
                      "tiers": arguments.tiers, "psnr": mean}, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
