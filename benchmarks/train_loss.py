"""Trains a scene for packet loss, or continues a finished one, and prints the result as one line of JSON.

Figures are of the decoded stream on the test photos: PSNR without loss, and means over masks of `.pak` packets for each
concealer; `--cuts` adds the first share of the bytes alone, most important anchors first, and anchors from everywhere.
A run is added to the table with `--output`; `--init` continues a scene file for 720 iterations.

    python benchmarks/train_loss.py lego_small                                              # as without --loss
    python benchmarks/train_loss.py lego_small --model causal --lmbda 0.006 --loss bernoulli:0.2
    python benchmarks/train_loss.py lego_small --loss bernoulli:0.2 --share 1
    python benchmarks/train_loss.py snowmiku_small --init official.scene --loss bernoulli:0.2
    python benchmarks/train_loss.py --plot pictures/train_loss.svg                          # of the table's rows
"""

import argparse
import dataclasses
import json
import os
import time
from pathlib import Path
from typing import Any

import numba

from splatwire.anchors.scene_file import load_scene, save_scene
from splatwire.bitstream import packetization_named, send_sequence
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_config import SketchConfig
from splatwire.calibration.views import CalibrationViews
from splatwire.channel import draw_mask, parse_loss
from splatwire.codec import decode_stream, encode_scene, schema_of, with_section
from splatwire.concealment import conceal
from splatwire.data import Dataset, open_dataset
from splatwire.neural.training import Listener, RunOptions, TrainConfig, create_config, load_checkpoint, train_scene
from splatwire.neural.training.checkpoint import record_to_json
from splatwire.neural.training.finetune import fine_tuning_config, state_of_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.presets import MODELS
from splatwire.neural.training.quality import assess_scene
from splatwire.ops.threads import use_single_thread
from splatwire.render.importance import footprint_importance
from splatwire.types import AnchorScene

SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "lego_small": ("nerf_synthetic_lego_small", {"preset": "synthetic_nerf"}),
    "snowmiku_small": ("snowmiku_small", {"voxel_size": 0.01}),
    "snowmiku": ("snowmiku", {}),
    "bonsai_small": ("bonsai_small", {}),
    "llff_flower_small": ("llff_flower_small", {}),
}
CONCEALERS = ("drop", "grow", "idw", "scene_free")
TABLE = Path(__file__).parent / "results" / "train_loss.json"
TIERS = (0.05, 0.08, 0.12, 0.12, 0.13, 0.15, 0.15)
"""Shares of the anchors, most important first; the last tier has the rest."""


def under_loss(scene: AnchorScene, photos: tuple[Dataset, Dataset], options: argparse.Namespace) -> dict[str, Any]:
    """PSNR without loss and under each loss with each concealer, means over masks; a sketch of a share of the bytes."""
    packetization = packetization_named(options.packets, schema_of(scene).name, int(scene.drawable.sum()))
    stream, (train, test), views = encode_scene(scene, packetization), photos, options.views
    complete, concealers = decode_stream(stream), CONCEALERS
    found: dict[str, Any] = {"tested_with": options.packets, "bytes": stream.num_bytes}
    found |= {"anchors": stream.manifest.num_elements, "test_views": min(views, test.num_views), "masks": options.seeds}
    found["clean"] = round(assess_scene(complete.scene, test, views, 0).psnr, 3)
    if options.sketch:
        made = sketch_of(stream, complete, CalibrationViews.of_photos(train), SketchConfig(share=options.sketch))
        stream, concealers = with_section(stream, "sketch", made.section), (*CONCEALERS, "sketch")
        found["bytes with sketch"] = stream.num_bytes
    for loss in options.losses:
        each, lost, model = {name: [] for name in concealers}, 0.0, parse_loss(loss, packetization.loss_unit)
        for seed in range(options.seeds):
            received = decode_stream(draw_mask(stream, model, seed=seed).apply(stream))
            lost += 1 - float(received.loss_mask.fully_received.mean())
            for name in concealers:
                each[name].append(assess_scene(conceal(received, name), test, views, 0).psnr)
        found[loss] = {name: round(sum(values) / len(values), 3) for name, values in each.items()}
        found[f"{loss}, least"] = {name: round(min(values), 3) for name, values in each.items()}
        found[f"{loss}, lost"] = round(lost / options.seeds, 4)
    return found


def cut_off(scene: AnchorScene, train: Dataset, test: Dataset, cuts: list[float], views: int) -> dict[str, Any]:
    """PSNR of the first share of the bytes, side information included, with each concealer, by order of sending.

    `tiers` sends important anchors first, `interleaved` an even sample of all anchors.
    """
    importance = footprint_importance(scene, train.cameras)
    tiers = importance.tiers(TIERS, scene.anchors.mask.any(axis=1))
    streams = {"tiers": encode_scene(scene, tiers=tiers), "interleaved": encode_scene(scene)}
    found: dict[str, Any] = {}
    for order, stream in streams.items():
        parts = stream.part_sizes()
        for cut in cuts:
            left, kept = cut * stream.num_bytes - parts["manifest"] - parts["side_info"], set()
            for packet in send_sequence(stream, order):
                left -= packet.num_bytes
                if left < 0:
                    break
                kept.add(packet.id)
            received = decode_stream(stream.with_packets([packet for packet in stream.packets if packet.id in kept]))
            found.setdefault(order, {})[f"{cut:g}"] = {
                name: round(assess_scene(conceal(received, name), test, views, 0).psnr, 3) for name in CONCEALERS
            }
    return found


def trained(arguments: argparse.Namespace, train: Dataset, config: TrainConfig) -> tuple[AnchorScene, TrainConfig]:
    """The scene, trained from the photos, from a scene or from a checkpoint (of a run after growth)."""
    if arguments.init:
        start = load_scene(arguments.init)
        config = dataclasses.replace(fine_tuning_config(config, start), background=start.background)
        state = state_of_scene(start, train, config)
    elif arguments.checkpoint and arguments.checkpoint.exists():
        state, _ = load_checkpoint(arguments.checkpoint)
    else:
        state = initial_state(train, config)
        with_growth = dataclasses.replace(config, packet_loss=create_config().packet_loss)
        now = [0]
        listener = Listener(
            lambda progress: now.__setitem__(0, progress.iteration),
            should_stop=lambda: now[0] >= config.milestones.growth_end,
        )
        options = RunOptions(arguments.checkpoint, test_interval=0)
        state = train_scene(train, None, with_growth, state=state, options=options, listener=listener).state
    result = train_scene(train, None, config, state=state, options=RunOptions(test_interval=0))
    return result.scene, config


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Draws the picture without loss against the one at 20 % loss (`scene_free`), by share of lossy iterations."""
    from matplotlib import pyplot

    curves: dict[tuple[str, str, int, int], list[tuple[float, float, float]]] = {}
    for row in rows:
        if row.get("model") == "causal":
            point = (row["share"] if row["models"] else 0.0, row["clean"], row["bernoulli:0.2"]["scene_free"])
            key = row["scene"], row.get("start", ""), row["seed"], row.get("losses_seed", 0)
            curves.setdefault(key, []).append(point)
    names = sorted({scene for scene, *_ in curves})
    _, axes = pyplot.subplots(1, len(names), figsize=(4 * len(names), 4.8), squeeze=False)
    for (name, start, seed, again), points in sorted(curves.items()):
        shares, clean, lossy = zip(*sorted(points), strict=True)
        axis = axes[0][names.index(name)]
        label = f"{start}, then 720 more" if start else f"seed {seed}" + (", second half once more" if again else "")
        axis.plot(clean, lossy, ":" if start else "-", marker="o", label=label)
        for place in zip(shares, clean, lossy, strict=True):
            axis.annotate(f"{place[0]:g}", place[1:], textcoords="offset points", xytext=(4, 4), fontsize=8)
    for axis, name in zip(axes[0], names, strict=True):
        axis.set(title=name, xlabel="PSNR without loss, dB", ylabel="PSNR at 20 % loss, dB")
        axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2))
    pyplot.tight_layout()
    pyplot.savefig(path)


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=SCENES, nargs="?", default="lego_small")
    parser.add_argument("--model", choices=MODELS, default="hacpp")
    parser.add_argument("--plot", type=Path, help="draw the rows of --output (the table where absent), train nothing")
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("SPLATWIRE_DATA", "../shared/data")))
    parser.add_argument("--name", default="", help="name of the row")
    parser.add_argument("--init", type=Path, help="a scene to go on with")
    parser.add_argument("--checkpoint", type=Path, help="where the grown half is kept: variants share it")
    parser.add_argument("--iterations", type=int)
    parser.add_argument("--refine", type=int, default=0)
    parser.add_argument("--lmbda", type=float)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--loss", nargs="*", default=[])
    parser.add_argument("--share", type=float)
    parser.add_argument("--losses", nargs="*", default=["bernoulli:0.2"], help="what the result is tested under")
    parser.add_argument("--sketch", type=float, default=0.0, help="share of the bytes, 0 for none")
    parser.add_argument("--cuts", nargs="*", type=float, default=[])
    parser.add_argument("--packets", default="spread", help="preset that the result is tested with")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--views", type=int, default=1000)
    parser.add_argument("--only-test", action="store_true", help="of --init, without training")
    parser.add_argument("--save", type=Path)
    parser.add_argument("--output", type=Path)
    return parser.parse_args()


def main() -> None:
    arguments = parse()
    if arguments.plot:
        plot(json.loads((arguments.output or TABLE).read_text()), arguments.plot)
        return
    use_single_thread()
    numba.set_num_threads(1)
    folder, recipe = SCENES[arguments.scene]
    iterations = arguments.iterations or (720 if arguments.init else 2400)
    config = create_config(
        **recipe, model=arguments.model, iterations=iterations, refine_steps=arguments.refine, lmbda=arguments.lmbda,
        packet_losses=tuple(arguments.loss), seed=arguments.seed,
    )  # fmt: skip
    packet_loss = config.packet_loss
    if arguments.share is not None:
        packet_loss = dataclasses.replace(packet_loss, lossy_share=arguments.share)
    config = dataclasses.replace(config, packet_loss=packet_loss)
    train, test = (
        open_dataset(arguments.data / "scenes" / folder, split=split, test_views=config.test_views)
        for split in ("train", "test")
    )
    started = time.process_time()
    scene = load_scene(arguments.init) if arguments.only_test else trained(arguments, train, config)[0]
    row: dict[str, Any] = {"name": arguments.name, "scene": arguments.scene, "init": bool(arguments.init)}
    if not arguments.only_test:
        row |= {
            "model": arguments.model,
            "iterations": iterations,
            "seed": arguments.seed,
            "lambda": config.weights.rate,
        }
        row |= record_to_json(packet_loss) | {"seconds": round(time.process_time() - started, 1)}
    if arguments.save:
        save_scene(scene, arguments.save)
    row |= under_loss(scene, (train, test), arguments)
    if arguments.cuts:
        row["cuts"] = cut_off(scene, train, test, arguments.cuts, arguments.views)
    print(json.dumps(row), flush=True)
    if arguments.output:
        rows = json.loads(arguments.output.read_text()) if arguments.output.exists() else []
        arguments.output.write_text("[\n" + ",\n".join(json.dumps(r) for r in [*rows, row]) + "\n]\n")


if __name__ == "__main__":
    main()
