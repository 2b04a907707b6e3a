"""The frontier: picture quality over bytes sent, for several channels, without a way back.

(a) everything delivered reliably (the ceiling; at the bytes of HAC++'s own files where they are given), (b) parity over
the whole stream alike, (c) no parity on packets, lost ones concealed, (d) our planner: importance tiers, parity where
it pays, the rest concealed. All are cut at the same budget of bytes, conceal, and meet the same losses; whoever does
not get the side information sees black.

    python benchmarks/frontier.py SCENE --data PHOTOS [--views 4] [--seeds 3] [--plot frontier.png] > frontier.json
"""

import argparse
import itertools
import json
import math
import sys
from pathlib import Path

import numpy as np
import torch

from splatwire.channel import parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.sections import split_sections
from splatwire.codec.tiers import arrange_stream, read_tiers
from splatwire.conceal import conceal
from splatwire.data import open_dataset
from splatwire.evaluate.damage import measure_damage, without
from splatwire.evaluate.views import spread
from splatwire.model.scene_file import load_scene
from splatwire.packets import PRESETS, SceneStream, read_stream
from splatwire.render import iterate_views
from splatwire.render.importance import footprint_importance
from splatwire.transport.outline import StreamLoad, draw_losses, outline_transfer
from splatwire.transport.planner import BLANK_MSE, arrival_within, plan_protection
from splatwire.transport.program import Protection, interleaved

LOSSES = [f"bernoulli:{rate}" for rate in (0.01, 0.05, 0.1, 0.2, 0.3)] + [
    f"gilbert:{rate},20" for rate in (0.01, 0.05, 0.1, 0.2, 0.3)
]
BUDGETS = (1.0, 1.1, 1.2, 1.3, 1.45, 1.6)
TIERS = (0.05, 0.15, 0.3)
SIDE_STEPS = np.concatenate([np.arange(0.0, 1.0, 0.05), [1.2, 1.5, 2.0]])


class Bench:
    """One scene: its stream, views, and scores of deliveries seen before."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        scene = load_or_decode(arguments.scene)
        train, test = (open_dataset(arguments.data, split=split) for split in ("train", "test"))
        self.cameras = train.cameras.select(spread(train.cameras.num_views, 6))
        tiers = footprint_importance(scene, self.cameras).tiers(tuple(arguments.tiers))
        self.stream = encode_scene(scene, PRESETS["datagram"], tiers=tiers)
        flat = encode_scene(scene, PRESETS["datagram"])
        self.plain_bytes = int(bare(StreamLoad.of_stream(flat)))
        self.load, self.complete = StreamLoad.of_stream(self.stream), decode_stream(self.stream)
        self.importance = footprint_importance(self.complete.scene, self.cameras)
        self.test = test.select(spread(test.num_views, arguments.views))
        self.photos = [self.test.image(view) for view in range(self.test.num_views)]
        self.concealer, self.cache = arguments.conceal, {}
        self.members = members_of(self.stream)
        print(f"stream {self.stream.num_bytes} bytes, {len(self.load.anchors)} packets", file=sys.stderr)

    def tiers_by_rank(self) -> torch.Tensor:
        return torch.from_numpy(read_tiers(split_sections(self.stream.side_info)[1], self.stream.manifest))

    def psnr(self, head: bool, packets: np.ndarray) -> float:
        """Mean PSNR of the views for what arrived."""
        if not head:
            return -10 * math.log10(BLANK_MSE)
        key = packets.tobytes()
        if key not in self.cache:
            known = torch.zeros(self.complete.scene.anchors.num_anchors, dtype=torch.bool)
            for place in np.flatnonzero(packets):
                known[self.members[place]] = True
            scene = conceal(without(self.complete, known), self.concealer)
            pairs = zip(iterate_views(scene, self.test.cameras), self.photos, strict=True)
            errors = [float((image - photo).double().square().mean()) for image, photo in pairs]
            self.cache[key] = float(np.mean(-10 * np.log10(errors)))
        return self.cache[key]

    def base_mse(self) -> float:
        return 10 ** (-self.psnr(True, np.ones(len(self.load.anchors), dtype=np.bool_)) / 10)


def load_or_decode(path: Path):
    return decode_stream(read_stream(path)[0]).scene if path.suffix == ".swz" else load_scene(path)


def bare(load: StreamLoad) -> float:
    return float(outline_transfer(load, Protection(side_repair=0.0)).num_bytes.sum())


def members_of(stream: SceneStream) -> list[torch.Tensor]:
    """Anchors of each packet in sending order."""
    plan = stream.manifest.plan
    groups, packets = arrange_stream(stream)
    cuts = [groups.ranks[a:b].copy() for a, b in itertools.pairwise(groups.starts)]
    ranks = {packet.id: torch.from_numpy(cut) for packet, cut in zip(packets, cuts, strict=True)}
    tier_of = [plan.tier_of(block) for block in range(plan.num_blocks)]
    return [ranks[packet.id] for packet in interleaved(stream.packets, tier_of)]


def whole_stream(bench: Bench, budget: float) -> Protection:
    """The same parity over everything, as much as the budget holds; tiers do not count, order is the stream's."""
    tiers = bench.load.num_tiers
    best = Protection(side_repair=0.0, side_lead=1.0)
    for repair in np.arange(0.02, 1.5, 0.02):
        protection = Protection(side_repair=float(repair), side_lead=1.0, tier_repair=(float(repair),) * tiers)
        if outline_transfer(bench.load, protection).num_bytes.sum() > budget:
            break
        best = protection
    return best


def concealment_only(bench: Bench, traces: np.ndarray, budget: float) -> Protection:
    """Side information protected just enough, nothing else."""
    best = Protection(side_repair=0.0, side_lead=0.7)
    for repair in SIDE_STEPS:
        best = Protection(side_repair=float(repair), side_lead=0.7)
        if arrival_within(outline_transfer(bench.load, best), traces, budget).head.mean() >= 0.999:
            break
    return best


def frontier(bench: Bench, arguments: argparse.Namespace) -> list[dict]:
    damage = measure_damage(
        bench.complete, bench.tiers_by_rank(), bench.cameras.select(spread(bench.cameras.num_views, 3)),
        concealer=bench.concealer, base_mse=bench.base_mse(), seed=7,
    )  # fmt: skip
    rows = []
    for name in arguments.losses:
        loss = parse_loss(name)
        for factor in arguments.budgets:
            budget = factor * bench.plain_bytes
            planning = draw_losses(loss, 1000, 4 * len(bench.load.anchors), 99)
            plan = plan_protection(bench.load, damage, loss, budget_bytes=budget, trials=60, seed=99)
            ways = {"whole": whole_stream(bench, budget), "conceal": concealment_only(bench, planning, budget),
                    "planner": plan.protection}  # fmt: skip
            row = {"loss": name, "budget": factor, "expected": plan.psnr, "repair": plan.protection.tier_repair,
                   "side_repair": plan.protection.side_repair, "protection_share": plan.protection_share}  # fmt: skip
            for way, protection in ways.items():
                outline = outline_transfer(bench.load, protection)
                traces = draw_losses(loss, arguments.seeds, len(outline.kind), 1)
                arrival = arrival_within(outline, traces, budget)
                scores = [bench.psnr(bool(h), p) for h, p in zip(arrival.head, arrival.packets, strict=True)]
                row[way] = {"psnr": float(np.mean(scores)), "worst": min(scores), "all": scores}
            rows.append(row)
            text = " ".join(f"{way} {row[way]['psnr']:.2f}" for way in ways)
            print(f"{name} {factor}: {text} (expected {plan.psnr:.2f})", file=sys.stderr, flush=True)
    return rows


def draw(rows: list[dict], ceiling: float, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(row["loss"] for row in rows))
    columns = min(5, len(names))
    figure, axes = plt.subplots(
        -(-len(names) // columns), columns, figsize=(3 * columns, 5), sharey=True, squeeze=False
    )
    labels = {"whole": "parity over everything", "conceal": "concealment only", "planner": "planner"}
    for axis, name in zip(axes.flat, names, strict=False):
        here = [row for row in rows if row["loss"] == name]
        axis.axhline(ceiling, color="0.6", linewidth=1, label="everything delivered")
        for way, label in labels.items():
            axis.plot([row["budget"] for row in here], [row[way]["psnr"] for row in here], marker=".", label=label)
        axis.set_title(name, fontsize=9)
        axis.set_ylim(ceiling - 4, ceiling + 0.3)  # who lacks the side information, and sees black, is off the picture
    axes[0, 0].set_ylabel("PSNR, dB")
    axes[-1, 0].set_xlabel("bytes sent / bytes of the stream")
    axes[0, -1].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path, help="stream (.swz) or scene file")
    parser.add_argument("--data", type=Path, required=True, help="photos; training cameras say what is important")
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--losses", nargs="+", default=LOSSES)
    parser.add_argument("--budgets", nargs="+", type=float, default=BUDGETS)
    parser.add_argument("--conceal", default="grow")
    parser.add_argument("--tiers", nargs="+", type=float, default=TIERS)
    parser.add_argument("--native-bytes", type=int, help="bytes of HAC++'s own files, for the ceiling")
    parser.add_argument("--plot", type=Path)
    arguments = parser.parse_args()
    bench = Bench(arguments)
    ceiling = -10 * math.log10(bench.base_mse())
    rows = frontier(bench, arguments)
    if arguments.plot:
        draw(rows, ceiling, arguments.plot)
    native = arguments.native_bytes / bench.plain_bytes if arguments.native_bytes else None
    margins = [row["planner"]["psnr"] - max(row["whole"]["psnr"], row["conceal"]["psnr"]) for row in rows]
    print(json.dumps({
        "scene": arguments.scene.name, "views": arguments.views, "seeds": arguments.seeds, "concealer": bench.concealer,
        "plain_bytes": bench.plain_bytes, "ceiling_psnr": ceiling, "native_budget": native, "rows": rows,
        "planner_minus_best_other_db": {"least": min(margins), "mean": float(np.mean(margins)), "most": max(margins)},
    }, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
