"""Quality of clips under loss at equal bytes: parity alone, concealment alone, and the plan of both.

    python benchmarks/clip_parity.py monkey=FRAMES/ guitar=FRAMES/ > benchmarks/results/clip_parity.json
    python benchmarks/clip_parity.py --draw docs/images/clip_parity.png

Each clip is encoded in several qualities. The size of one of them is the budget. Bases are retransmitted until
received, motion never. `parity`: the planner, for a receiver that omits or freezes tracks with lost motion (the better
one). `concealment`: all bytes into quality. `planner`: quality and parity, for a receiver that conceals. `expected`
is the mean of 500 transfers by the damage curves, with losses that the planner did not use. The damage curves are
measured in pictures of three frames per group. `--drawn` transfers are rendered, for `--pictured` losses.
"""

import argparse
import json
import sys
import time
from fractions import Fraction
from pathlib import Path

import numpy as np

from splatwire.bitstream import SceneStream
from splatwire.channel import LossModel, parse_loss
from splatwire.codec import decode_stream
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.sequence.encoder import TracksEncoder
from splatwire.concealment.temporal.concealers import temporal_concealer
from splatwire.planning.sequence.delivery import SequenceLoad, delivered, model_motion_transfer
from splatwire.planning.sequence.distortion import measure_sequence_distortion, render_sampled_frames, smoothed
from splatwire.planning.sequence.planner import SequenceVariant, plan_sequence
from splatwire.planning.sequence.variants import frames_of
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import measure_class_offsets
from splatwire.sequence import frame_files, read_frames
from splatwire.sequence.group_builder import group_of
from splatwire.sequence.importance import stream_importance
from splatwire.sequence.tracking import SECTION as TRACKING
from splatwire.sequence.tracking import Tracker
from splatwire.transport import Protection

RESULTS = Path(__file__).parent / "results" / "clip_parity.json"
GROUP, RATE = 15, Fraction(30)
LOSSES = [f"{kind}{rate}{rest}" for kind, rest in (("bernoulli:", ""), ("gilbert:", ",20"))
          for rate in (0.01, 0.02, 0.05, 0.1, 0.2)]  # fmt: skip
TRANSFERS = 500
WAYS = {"parity": ("drop", "hold"), "concealment": ("motion",), "planner": ("motion",)}


def encoded(files: list[Path], levels: list[float]) -> dict[float, SceneStream]:
    """A clip in several qualities; frames are matched once."""
    tracker = Tracker("auto")
    named = [tracker.add(frame) for frame in read_frames(files)]
    groups = [group_of(named[begin : begin + GROUP]) for begin in range(0, len(named), GROUP)]
    everyone = np.arange(len(groups[0].keys))
    classes, found = measure_class_offsets(groups[0].keyframe_gaussians(everyone)), {}
    for level in levels:
        writer = TracksEncoder(RATE, GROUP, Quality(level=level))
        for number, group in enumerate(groups):
            writer.add(group, None if number else classes)
        found[level] = writer.finish({TRACKING: tracker.report.section()})
    return found


class Clip:
    """A clip in several qualities, with the damage of losses for each, and pictures of received frames."""

    def __init__(self, folder: Path, arguments: argparse.Namespace) -> None:
        files = frame_files(folder)[: arguments.frames]
        self.streams = encoded(files, arguments.levels)
        finest = decode_stream(self.streams[max(self.streams)]).scene
        self._cameras = surrounding_cameras(finest.keyframes(), arguments.views, 256)
        self._references = frames_of(files, finest.timeline, self._cameras)
        self.loads, self.variants = {}, {}
        for level, stream in self.streams.items():
            self.loads[level] = SequenceLoad.of(stream, stream_importance(stream))
        for name in ("motion", "drop", "hold"):
            self._measure(name)
        self._known: dict = {}

    def _measure(self, name: str) -> None:
        """Measures how losses degrade each quality of the clip with a concealer."""
        damages = [
            measure_sequence_distortion(
                stream, self.loads[level], temporal_concealer(name), self._cameras, self._references, 0.0, seed=1
            )
            for level, stream in self.streams.items()
        ]
        for level, damage in zip(self.streams, smoothed(damages), strict=True):
            self.variants[level, name] = SequenceVariant(self.loads[level], damage)

    def shown(self, level: float, protection: Protection, name: str, loss: str, seed: int) -> float:
        """PSNR of one simulated transfer, mean over frames and views, decibels."""
        load, stream = self.loads[level], self.streams[level]
        there = delivered(load, protection, parse_loss(loss, "datagram"), seed)
        is_keyframe = stream.manifest.plan.is_keyframe
        came = [p for p in stream.packets if p.id in there or is_keyframe(p.id.block)]
        key = (level, name, frozenset(p.id for p in came))
        if key not in self._known:
            clip = decode_stream(stream.with_packets(came)).scene
            pairs = zip(
                render_sampled_frames(clip, temporal_concealer(name), self._cameras), self._references, strict=True
            )
            errors = [((a - b).astype(np.float64) ** 2).mean(axis=(1, 2, 3)) for a, b in pairs]
            self._known[key] = float((-10 * np.log10(np.array(errors))).mean())
        return self._known[key]

    def row(self, way: str, budget: float, loss: str, drawn: int) -> dict:
        """Computes one point of a curve."""
        channel, best = parse_loss(loss, "datagram"), None
        for name in WAYS[way]:
            fit = [level for level, load in self.loads.items() if load.num_bytes <= budget]
            levels = [max(fit)] if way == "concealment" else fit
            room = self.loads[max(fit)].num_bytes if way == "concealment" else budget
            variants = [self.variants[level, name] for level in levels]
            plan = plan_sequence(variants, channel, budget_bytes=room, seed=7)
            if best is None or plan.psnr > best[0].psnr:
                best = plan, levels[plan.variant], name
        plan, level, name = best
        found = [self.shown(level, plan.protection, name, loss, 1000 + seed) for seed in range(drawn)]
        return {
            "way": way, "loss": loss, "level": level, "concealer": name, "parity_bytes": plan.parity_bytes,
            "bytes": plan.sent_bytes, "expected": expected(self.variants[level, name], plan.protection, channel),
            "drawn": float(np.mean(found)) if found else None, "motion": plan.protection.motion,
        }  # fmt: skip


def expected(variant: SequenceVariant, protection: Protection, loss: LossModel) -> float:
    """PSNR that the distortion model predicts for other random transfers, decibels, mean over groups."""
    found, rng = [], np.random.Generator(np.random.PCG64(99))
    for group in range(len(variant.load.groups)):
        way = model_motion_transfer(variant.load, protection, group)
        received = np.stack([loss.received(len(way.model.kind), rng) for _ in range(TRANSFERS)])
        importance = variant.load.importance[way.order]
        lost = ~way.received_packets(received) @ importance / max(importance.sum(), 1e-30)
        found.append(float(variant.distortion.psnr(group, lost).mean()))
    return float(np.average(found, weights=variant.distortion.frames))


def measure(name: str, folder: Path, arguments: argparse.Namespace) -> dict:
    """Computes all curves of a clip."""
    clip, rows = Clip(folder, arguments), []
    for budget in arguments.budgets:
        limit = clip.loads[budget].num_bytes
        whole = expected(clip.variants[budget, "motion"], Protection(), parse_loss("bernoulli:0", "datagram"))
        for loss in LOSSES:
            for way in WAYS:
                began = time.perf_counter()
                drawn = arguments.drawn if loss in arguments.pictured else 0
                row = {"budget_level": budget, "budget_bytes": limit, "whole": whole,
                       **clip.row(way, float(limit), loss, drawn)}  # fmt: skip
                rows.append(row)
                line = f"{way} {loss} {row['expected']:.2f} dB, level {row['level']}, parity {row['parity_bytes']:,}"
                print(f"{name} {budget}: {line}, {time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
    sizes = {str(level): load.num_bytes for level, load in clip.loads.items()}
    return {"name": name, "frames": arguments.frames, "bytes": sizes, "rows": rows}


def plot(target: Path) -> None:
    """Draws the curves."""
    import matplotlib.pyplot as plt

    clips = json.loads(RESULTS.read_text())
    budgets = list(dict.fromkeys(row["budget_level"] for row in clips[0]["rows"]))
    shape = (len(budgets), 2 * len(clips))
    figure, axes = plt.subplots(*shape, figsize=(3.1 * shape[1], 2.7 * shape[0]), sharex=True, squeeze=False)
    for column, clip in enumerate(clips):
        for row, budget in enumerate(budgets):
            for burst, kind in enumerate(("bernoulli:", "gilbert:")):
                axis = axes[row][2 * column + burst]
                for way, style in (("parity", "C1s--"), ("concealment", "C0o-"), ("planner", "C2^-")):
                    own = [r for r in clip["rows"] if (r["budget_level"], r["way"]) == (budget, way)]
                    own = [r for r in own if r["loss"].startswith(kind)]
                    rates = [100 * float(r["loss"].split(":")[1].split(",")[0]) for r in own]
                    axis.plot(rates, [r["expected"] for r in own], style, label=way, markersize=4)
                size = next(r["budget_bytes"] for r in clip["rows"] if r["budget_level"] == budget) / 1e6
                axis.set_title(f"{clip['name']}, {size:.2f} MB, {'bursts of 20' if burst else 'random'}", fontsize=9)
                axis.set_xscale("log")
                axis.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
                axis.minorticks_off()
                axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("% of the datagrams lost")
    for line in axes:
        line[0].set_ylabel("PSNR, dB")
    axes[0][0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(target, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", help="NAME=FOLDER")
    parser.add_argument("--frames", type=int, default=45)
    parser.add_argument("--levels", type=float, nargs="+", default=[6.5, 7.25, 7.75, 8.0, 8.75, 9.125, 9.5])
    parser.add_argument("--budgets", type=float, nargs="+", default=[8.0, 9.5], help="levels whose bytes may be spent")
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--drawn", type=int, default=3)
    parser.add_argument("--pictured", nargs="*", default=["bernoulli:0.05", "bernoulli:0.2", "gilbert:0.1,20"])
    parser.add_argument("--draw", type=Path)
    arguments = parser.parse_args()
    if arguments.draw:
        plot(arguments.draw)
        return
    named = [clip.partition("=")[::2] for clip in arguments.clips]
    print(json.dumps([measure(name, Path(folder), arguments) for name, folder in named], indent=1))


if __name__ == "__main__":
    main()
