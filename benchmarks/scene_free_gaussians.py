"""The scene-free concealer for explicit Gaussians: trains its network, and scores it; prints one JSON object.

A scene is a file of explicit Gaussians, without photos: pictures are compared with those of the complete stream
(training) or of the file itself (scoring), from views around it. Leave scored scenes out of the training.

    python benchmarks/scene_free_gaussians.py train a.spz b.ply -o scene_free_gaussians.safetensors
    python benchmarks/scene_free_gaussians.py score c.ply --seeds 0 1 2
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from gain_training import LossyStream, SceneFreeConfig, train_for_gaussians

from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal, create_concealer
from splatwire.conceal.scene_free import save_gain_network
from splatwire.metrics import psnr
from splatwire.packets import PRESETS
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import classes_of
from splatwire.scene_io import open_scene

RATES = (0.2, 0.1, 0.3)
FLOOR = 1e-5


def train(options: argparse.Namespace) -> dict[str, object]:
    started, streams = time.perf_counter(), []
    for path in options.scenes:
        scene = open_scene(path)
        stream = encode_scene(scene, PRESETS["datagram"], classes=classes_of(scene))
        streams.append(LossyStream(stream, surrounding_cameras(scene, options.views, options.width)))
        print(f"{path.name}: {stream.manifest.num_elements} Gaussians", file=sys.stderr, flush=True)
    losses: list[float] = []

    def told(step: int, loss: float) -> None:
        losses.append(loss)
        if step % 40 == 0:
            print(f"step {step}: {sum(losses[-40:]) / 40:.4f}", file=sys.stderr, flush=True)

    config = SceneFreeConfig(steps=options.steps, drop_rates=RATES, floor=FLOOR, seed=options.seed)
    network = train_for_gaussians(streams, config, progress=told)
    record = {
        "scenes": " ".join(path.name for path in options.scenes),
        "settings": f"views {options.views}, width {options.width}, steps {options.steps}, seed {options.seed}",
    }
    save_gain_network(network, options.output, record=record)
    return {**record, "seconds": time.perf_counter() - started, "num_bytes": options.output.stat().st_size}


def score(options: argparse.Namespace) -> dict[str, object]:
    loss, found = parse_loss(f"bernoulli:{options.rate}", "datagram"), dict[str, dict[str, Any]]()
    given = {} if options.weights is None else {"gaussian_weights": options.weights}
    names = {name: create_concealer(name, **(given if name == "scene_free" else {})) for name in options.conceal}
    for path in options.scenes:
        scene = open_scene(path)
        stream = encode_scene(scene, PRESETS["datagram"], classes=classes_of(scene))
        cameras = surrounding_cameras(scene, options.views, options.width)
        truth = list(iterate_views(scene, cameras))

        def quality(shown, truth=truth, cameras=cameras) -> float:  # type: ignore[no-untyped-def]
            pairs = zip(iterate_views(shown, cameras), truth, strict=True)
            return sum(float(psnr(a[None], b[None])[0]) for a, b in pairs) / len(truth)

        figures: dict[str, list[float]] = {name: [] for name in names}
        for seed in options.seeds:
            partial = decode_stream(transmit(stream, loss, seed=seed)[0])
            for name, method in names.items():
                figures[name].append(quality(conceal(partial, method)))
        found[path.name] = {
            "num_gaussians": scene.num_elements, "num_bytes": stream.num_bytes,
            "no loss": quality(decode_stream(stream).scene), "psnr": figures,
            "mean": {name: sum(values) / len(values) for name, values in figures.items()},
        }  # fmt: skip
        print(path.name, found[path.name]["mean"], file=sys.stderr, flush=True)
    gains = {name: [f["mean"][name] - f["mean"]["drop"] for f in found.values()] for name in names}
    return {
        "loss": loss.name, "views": options.views, "width": options.width, "scenes": found,
        "gain over drop, mean of scenes": {name: sum(values) / len(values) for name, values in gains.items()},
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    learn = verbs.add_parser("train")
    learn.set_defaults(verb=train)
    learn.add_argument("-o", "--output", type=Path, required=True)
    learn.add_argument("--steps", type=int, default=320)
    learn.add_argument("--seed", type=int, default=0)
    judge = verbs.add_parser("score")
    judge.set_defaults(verb=score)
    judge.add_argument("--conceal", nargs="*", default=["drop", "grow", "scene_free"])
    judge.add_argument("--weights", type=Path, help="instead of those of the package")
    judge.add_argument("--rate", type=float, default=0.2)
    judge.add_argument("--seeds", type=int, nargs="*", default=[0, 1, 2])
    for verb, views, width in ((learn, 8, 200), (judge, 8, 256)):
        verb.add_argument("scenes", nargs="+", type=Path)
        verb.add_argument("--views", type=int, default=views)
        verb.add_argument("--width", type=int, default=width)
    options = parser.parse_args()
    print(json.dumps(options.verb(options), indent=1))


if __name__ == "__main__":
    main()
