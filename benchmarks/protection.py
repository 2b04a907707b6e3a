"""Quality at 20 % loss with 8 % of the bytes for protection: PSNR against photos, and the drop from no loss.

Datagrams: the planner chooses, side information included. `.pak` packets: side information is always received (the
paper's assumption), and parity covers a top tier (any K of K + R packets restore it). In both, a sketch of important
anchors in the side information may take a part of the 8 %. The use of a sketch, the size of the tier and the parity are
chosen on training photos with other losses than the reported ones. The mean over datagrams is defined as in
`rate_distortion.py`. Transfers without side information show the preview of the welcome. Its bytes are part of the 8 %.

    python benchmarks/protection.py SCENE --data PHOTOS [--limit 0.08] [--views 4] [--pictures 8] [--sketch 0.01 0.025]
        [--units datagram pak]
"""

import argparse
import itertools
import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rate_distortion import PLANNING_SEED, REPORTED_SEED, Bench, Variant

from splatwire.bitstream import PRESETS, SceneStream
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.channel import parse_loss
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.codec.tiers import assign_stream_packets
from splatwire.concealment.sketch import SECTION
from splatwire.planning.measure import LossyPictures
from splatwire.planning.planner import plan_protection
from splatwire.planning.transfer_model import draw_losses

PAK_TIERS = (0.02, 0.05, 0.1, 0.2)
PLANNED = 12
CHANNELS = ("bernoulli:0.2", "gilbert:0.2,20")


def sketches(bench: Bench, stream: SceneStream, shares: list[float]) -> list[bytes]:
    """Sketch sections of several sizes, given as shares of the stream's bytes; valid for every stream of the scene."""
    complete = decode_stream(stream)
    return [sketch_of(stream, complete, bench.train, SketchConfig(share=s)).section for s in shares]


def over_datagrams(variants: list[Variant], loss_name: str, arguments: argparse.Namespace) -> dict:
    """Results with datagram losses: the planner chooses within the byte limit."""
    loss = parse_loss(loss_name)
    plan = plan_protection([variant.planned for variant in variants], loss, budget_bytes=1e12, trials=60,
                           rendered_trials=4, seed=PLANNING_SEED, max_protection=arguments.limit)  # fmt: skip
    found = variants[plan.variant].expected(plan.protection, loss_name, 1e12, arguments.pictures)
    return {"unit": "datagram", "loss": loss_name, **found,
            "protection_share": plan.protection_share, "head_share": plan.protection.bundled_share,
            "repair": plan.protection.tier_repair, "side_repair": plan.protection.init_repair,
            "tier_spread": plan.protection.tier_spread, "concealment_bytes": plan.concealment_bytes}  # fmt: skip


class Pak(NamedTuple):
    """A way to spend the byte limit on a stream of `.pak` packets.

    Attributes:
        share: Share of the anchors in the tier that parity protects.
        repair: Number of parity packets.
        num_bytes: Size of a parity packet in bytes.
        sketch: Index of the pictures with this sketch; 0 without a sketch.
        spent: Bytes of sketch and parity.
        total: Bytes of the stream with sketch and parity.
        top: Mask of the packets of the protected tier, bool (P).
        slots: Position of each packet, then of each parity packet, in the sending order, int64 (P + repair). The
            tier, the other packets and parity are each spread evenly, lane by lane, so that a burst hits few of each.
        cuts: Anchors of each packet.
    """

    share: float
    repair: int
    num_bytes: int
    sketch: int
    spent: int
    total: int
    top: np.ndarray
    slots: np.ndarray
    cuts: list[np.ndarray]


def pak_ways(bench: Bench, sections: list[bytes], limit: float) -> list[Pak]:
    """Possible uses of the byte limit: sizes of the protected tier and sketches; parity gets the rest."""
    ways, importance = [], bench.importance
    for share in PAK_TIERS:
        stream = encode_scene(bench.scene, PRESETS["paper"], tiers=importance.tiers((share,)))
        members, packets = assign_stream_packets(stream)
        top = np.array([stream.manifest.plan.tier_of(packet.id.block) == 0 for packet in packets])
        largest = int(np.array([packet.num_bytes for packet in packets])[top].max())
        cuts = [members.indices[a:b] for a, b in itertools.pairwise(members.starts)]
        lane_by_lane = np.lexsort(np.array([(p.id.block, p.id.index_in_block) for p in packets]).T)
        for number, section in enumerate([b"", *sections]):
            room = limit / (1 - limit) * stream.num_bytes - len(section)
            repair = min(int(max(room, 0) / largest), 2 * int(top.sum()))
            spent = repair * largest + len(section)
            if room >= 0:
                slots = spread_out(top, lane_by_lane, repair)
                ways.append(Pak(share, repair, largest, number, spent, stream.num_bytes + spent, top, slots, cuts))
    return ways


def spread_out(top: np.ndarray, order: np.ndarray, repair: int) -> np.ndarray:
    """Positions of packets and parity in the sending order, see `Pak.slots`; `order` lists the packets lane by lane."""
    due = np.empty(len(top) + repair)
    for members in (order[top[order]], order[~top[order]], len(top) + np.arange(repair)):
        due[members] = (np.arange(len(members)) + 0.5) / max(len(members), 1)
    slots = np.empty(len(due), dtype=np.int64)
    slots[np.argsort(due, kind="stable")] = np.arange(len(due))
    return slots


def pak_scores(way: Pak, pictures: LossyPictures, loss_name: str, seeds: int, seed: int) -> list[float]:
    scores = []
    for row in draw_losses(parse_loss(loss_name), seeds, len(way.cuts) + way.repair, seed):
        arrived = row[way.slots]
        there = arrived[: len(way.cuts)].copy()
        if arrived[len(way.cuts) :].sum() + there[way.top].sum() >= way.top.sum():
            there[way.top] = True
        known = np.zeros(pictures.num_elements, np.bool_)
        for index in np.flatnonzero(there).tolist():
            known[way.cuts[index]] = True
        scores.append(pictures.psnr(known))
    return scores


def over_paks(
    ways: list[Pak], pictures: list[tuple[LossyPictures, LossyPictures]], loss_name: str, arguments: argparse.Namespace
) -> dict:
    """The use of the byte limit that is best in the planning views, scored in the reported views."""
    planned = [pak_scores(way, pictures[way.sketch][1], loss_name, PLANNED, PLANNING_SEED) for way in ways]
    way = ways[int(np.argmax([np.mean(scores) for scores in planned]))]
    scores = pak_scores(way, pictures[way.sketch][0], loss_name, arguments.pictures, REPORTED_SEED)
    return {"unit": "pak", "loss": loss_name, "tier": way.share, "psnr": float(np.mean(scores)), "all": scores,
            "packets_of_tier": int(way.top.sum()), "parity_packets": way.repair,
            "sketch_bytes": way.spent - way.repair * way.num_bytes,
            "protection_share": way.spent / way.total}  # fmt: skip


def scene_parser(description: str) -> argparse.ArgumentParser:
    """Command-line options of scripts that spend a byte limit on one scene."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--limit", type=float, default=0.08)
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--pictures", type=int, default=8)
    parser.add_argument("--planning-views", type=int, default=3, help="training photos for choices")
    parser.add_argument("--conceal", default="scene_free")
    parser.add_argument("--tiers", nargs="+", type=float, default=[0.02, 0.03, 0.05])
    parser.add_argument("--sketch", nargs="*", type=float, default=[0.01, 0.025], help="shares of the stream's bytes")
    return parser


def main() -> None:
    parser = scene_parser(__doc__.splitlines()[0])
    parser.add_argument("--units", nargs="+", choices=("datagram", "pak"), default=["datagram", "pak"])
    arguments = parser.parse_args()
    bench = Bench(arguments)
    flat, tiered = (
        bench.with_preview(encode_scene(bench.scene, PRESETS["datagram"], tiers=tiers)) for tiers in (None, bench.tiers)
    )
    sections = sketches(bench, flat, arguments.sketch)
    print("sketches of", [len(section) for section in sections], "bytes", file=sys.stderr, flush=True)
    variants = [bench.variant(stream, bench.concealer) for stream in (flat, tiered)]
    variants += [bench.variant(with_section(tiered, SECTION, s), SECTION, len(s)) for s in sections]
    whole = variants[0].psnr(True, np.ones(len(variants[0].members), dtype=np.bool_))
    rows = []
    if "datagram" in arguments.units:
        rows += [over_datagrams(variants, name, arguments) for name in CHANNELS]
        print([round(whole - row["psnr"], 2) for row in rows], "dB, datagrams", file=sys.stderr, flush=True)
    if "pak" in arguments.units:
        ways = pak_ways(bench, sections, arguments.limit)
        pictures = [(variant.pictures, variant.planning) for variant in [variants[1], *variants[2:]]]
        rows += [over_paks(ways, pictures, name, arguments) for name in CHANNELS]
    for row in rows:
        row["drop_db"] = whole - row["psnr"]
    print([round(row["drop_db"], 2) for row in rows], file=sys.stderr, flush=True)
    print(json.dumps({"scene": arguments.scene.name, "concealer": bench.concealer, "whole_psnr": whole,
                      "limit": arguments.limit, "tiers": arguments.tiers, "rows": rows}, indent=1))  # fmt: skip


if __name__ == "__main__":
    main()
