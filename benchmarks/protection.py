"""What 8 % of the bytes, spent on protection, leave of 20 % loss: PSNR against photos, and the drop from no loss.

Datagrams: the planner chooses, side information included. `.pak` packets: side information is delivered (the paper's
assumption), and as much parity as 8 % hold goes over the packets of the top tier (any K of K + R packets restore it).

    python benchmarks/protection.py SCENE --data PHOTOS [--limit 0.08] [--views 4] [--seeds 5] [--conceal grow]
"""

import argparse
import json
import math
from pathlib import Path

import numpy as np
import torch
from frontier import Bench

from splatwire.channel import parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.tiers import arrange_stream
from splatwire.conceal import conceal
from splatwire.evaluate.damage import measure_damage, without
from splatwire.evaluate.views import spread
from splatwire.packets import PRESETS
from splatwire.render import iterate_views
from splatwire.transport.outline import draw_losses, outline_transfer
from splatwire.transport.planner import arrival_within, plan_protection

PAK_TIERS = (0.02, 0.05, 0.1, 0.2)


def over_datagrams(bench: Bench, loss_name: str, arguments: argparse.Namespace) -> dict:
    """The planner's choice within the limit."""
    loss, views = parse_loss(loss_name), spread(bench.cameras.num_views, 3)
    damage = measure_damage(bench.complete, bench.tiers_by_rank(), bench.cameras.select(views),
                            concealer=bench.concealer, base_mse=bench.base_mse(), seed=7)  # fmt: skip
    plan = plan_protection(bench.load, damage, loss, budget_bytes=1e12, trials=60, seed=99,
                           most_protection=arguments.limit, head_target=0.99)  # fmt: skip
    outline = outline_transfer(bench.load, plan.protection)
    arrival = arrival_within(outline, draw_losses(loss, arguments.seeds, len(outline.kind), 1), 1e12)
    scores = [bench.psnr(bool(head), packets) for head, packets in zip(arrival.head, arrival.packets, strict=True)]
    return {"unit": "datagram", "loss": loss_name, "psnr": float(np.mean(scores)), "all": scores,
            "protection_share": plan.protection_share, "side_information_arrives": plan.head_arrives,
            "repair": plan.protection.tier_repair, "side_repair": plan.protection.side_repair}  # fmt: skip


def over_paks(bench: Bench, loss_name: str, share: float, arguments: argparse.Namespace) -> dict:
    """Parity over the `.pak` packets of the top `share` of the anchors."""
    stream = encode_scene(bench.complete.scene, PRESETS["paper"], tiers=bench.importance.tiers((share,)))
    complete, plan = decode_stream(stream), stream.manifest.plan
    groups, packets = arrange_stream(stream)
    sizes = np.array([packet.num_bytes for packet in packets])
    top = np.array([plan.tier_of(packet.id.block) == 0 for packet in packets])
    repair = int(arguments.limit / (1 - arguments.limit) * stream.num_bytes / sizes[top].max())
    repair = min(repair, 2 * int(top.sum()))
    scores, known = [], torch.zeros(complete.scene.anchors.num_anchors, dtype=torch.bool)
    for row in draw_losses(parse_loss(loss_name), arguments.seeds, len(packets) + repair, 1):
        there = row[: len(packets)].copy()
        if row[len(packets) :].sum() + there[top].sum() >= top.sum():
            there[top] = True
        known[:] = False
        for index in np.flatnonzero(there):
            known[torch.from_numpy(groups.ranks[groups.starts[index] : groups.starts[index + 1]].copy())] = True
        scene = conceal(without(complete, known), bench.concealer)
        pairs = zip(iterate_views(scene, bench.test.cameras), bench.photos, strict=True)
        errors = [float((image - photo).double().square().mean()) for image, photo in pairs]
        scores.append(float(np.mean(-10 * np.log10(errors))))
    spent = repair * int(sizes[top].max())
    return {"unit": "pak", "loss": loss_name, "tier": share, "psnr": float(np.mean(scores)), "all": scores,
            "packets_of_tier": int(top.sum()), "parity_packets": repair,
            "protection_share": spent / (spent + stream.num_bytes)}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--limit", type=float, default=0.08)
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--conceal", default="grow")
    parser.add_argument("--tiers", nargs="+", type=float, default=[0.02, 0.05, 0.13])
    arguments = parser.parse_args()
    bench = Bench(arguments)
    whole = -10 * math.log10(bench.base_mse())
    rows = [over_datagrams(bench, name, arguments) for name in ("bernoulli:0.2", "gilbert:0.2,20")]
    for name in ("bernoulli:0.2", "gilbert:0.2,20"):
        rows.append(max((over_paks(bench, name, share, arguments) for share in PAK_TIERS), key=lambda row: row["psnr"]))
    for row in rows:
        row["drop_db"] = whole - row["psnr"]
    print(json.dumps({"scene": arguments.scene.name, "concealer": bench.concealer, "whole_psnr": whole,
                      "limit": arguments.limit, "tiers": arguments.tiers, "rows": rows}, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
