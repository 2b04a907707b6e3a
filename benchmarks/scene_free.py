"""The scene-free concealer: trains it on scenes, and scores it beside others; prints one JSON object.

A scene is SOURCE=DATASET: a stream, a scene file or a folder of an official HAC++ model, and the folder of its photos.
Training looks at the views of training photos, scoring at test photos (losses of 20 % of `.pak` units, the same for
all methods). For an honest figure leave the scored scene, and other models of the same photos, out of the training.

    python benchmarks/scene_free.py train A=data/a B=data/b -o scene_free.safetensors
    python benchmarks/scene_free.py score C=data/c --weights scene_free.safetensors
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from gain_training import SceneFreeConfig, train_scene_free

from splatwire.calibrate.pseudo_loss import CalibrationData, calibration_data
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import Concealer, conceal, create_concealer
from splatwire.conceal.scene_free import save_gain_network
from splatwire.data import open_dataset
from splatwire.evaluate.views import photo_views, spread
from splatwire.importers.hacpp import import_hacpp
from splatwire.metrics import psnr
from splatwire.model.scene_file import load_scene
from splatwire.packets import PRESETS, SceneStream, read_stream
from splatwire.render import iterate_views


def open_stream(source: Path) -> SceneStream:
    if source.suffix == ".swz":
        return read_stream(source)[0]
    scene = import_hacpp(source) if source.is_dir() else load_scene(source)
    return encode_scene(scene, PRESETS["paper"])


def to_learn_from(source: Path, photos: Path, views: int, width: int) -> CalibrationData:
    stream = open_stream(source)
    dataset = open_dataset(photos, split="train")
    cameras = dataset.cameras.select(spread(dataset.num_views, views))
    cameras = cameras.scaled(min(1.0, width / cameras.width))
    complete = decode_stream(stream)
    scene = replace(complete.scene, background=dataset.background)
    return calibration_data(stream, replace(complete, scene=scene), cameras)


def train(options: argparse.Namespace) -> dict[str, object]:
    started = time.perf_counter()
    scenes = [to_learn_from(source, photos, options.views, options.width) for source, photos in options.scenes]
    losses: list[float] = []

    def told(step: int, loss: float) -> None:
        losses.append(loss)
        if step % 25 == 0:
            print(f"step {step}: {sum(losses[-25:]) / len(losses[-25:]):.4f}", file=sys.stderr, flush=True)

    config = SceneFreeConfig(steps=options.steps, seed=options.seed)
    network = train_scene_free(scenes, config, progress=told)
    names = " ".join(source.name for source, _ in options.scenes)
    settings = f"views {options.views}, width {options.width}, steps {options.steps}, seed {options.seed}"
    save_gain_network(network, options.output, record={"scenes": names, "settings": settings})
    size = options.output.stat().st_size
    return {"scenes": names, "settings": settings, "seconds": time.perf_counter() - started, "num_bytes": size}


def score(options: argparse.Namespace) -> dict[str, object]:
    given = {} if options.weights is None else {"weights": options.weights}
    methods: dict[str, Concealer] = {
        name: create_concealer(name, **(given if name == "scene_free" else {})) for name in options.conceal
    }
    return {source.name: score_scene(source, photos, methods, options) for source, photos in options.scenes}


def score_scene(
    source: Path, photos: Path, methods: dict[str, Concealer], options: argparse.Namespace
) -> dict[str, object]:
    stream, loss = open_stream(source), parse_loss(f"bernoulli:{options.rate}")
    dataset = open_dataset(photos, split="test")
    views = photo_views(dataset.select(spread(dataset.num_views, options.views)))
    background = np.float32(views.background)

    def mean_psnr(scene) -> float:  # type: ignore[no-untyped-def]
        images = iterate_views(scene, views.cameras, background=background)
        values = [float(psnr(image[None], views.reference(view)[None])[0]) for view, image in enumerate(images)]
        return sum(values) / len(values)

    figures: dict[str, list[float]] = {name: [] for name in methods}
    for seed in options.seeds:
        partial = decode_stream(transmit(stream, loss, seed=seed)[0])
        for name, method in methods.items():
            figures[name].append(mean_psnr(conceal(partial, method)))
        print(source.name, seed, {n: round(v[-1], 3) for n, v in figures.items()}, file=sys.stderr, flush=True)
    return {
        "num_anchors": stream.manifest.num_elements,
        "views": views.cameras.num_views,
        "no loss": mean_psnr(decode_stream(stream).scene) if options.lossless else None,
        "psnr": figures,
        "mean": {name: sum(values) / len(values) for name, values in figures.items()},
    }


def scene(text: str) -> tuple[Path, Path]:
    source, equals, photos = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"'{text}' is not SOURCE=DATASET")
    return Path(source), Path(photos)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True)
    learn = verbs.add_parser("train")
    learn.set_defaults(verb=train)
    learn.add_argument("scenes", nargs="+", type=scene)
    learn.add_argument("-o", "--output", type=Path, required=True)
    learn.add_argument("--views", type=int, default=6, help="training views of a scene")
    learn.add_argument("--width", type=int, default=400, help="width of their pictures")
    learn.add_argument("--steps", type=int, default=SceneFreeConfig.steps)
    learn.add_argument("--seed", type=int, default=0)
    judge = verbs.add_parser("score")
    judge.set_defaults(verb=score)
    judge.add_argument("scenes", nargs="+", type=scene)
    judge.add_argument("--conceal", nargs="*", default=["drop", "grow", "scene_free"])
    judge.add_argument("--weights", type=Path, help="instead of those of the package")
    judge.add_argument("--views", type=int, help="most test views; all where absent")
    judge.add_argument("--rate", type=float, default=0.2)
    judge.add_argument("--seeds", type=int, nargs="*", default=[0, 1, 2, 3, 4])
    judge.add_argument("--lossless", action="store_true", help="score the scene without losses, too")
    options = parser.parse_args()
    print(json.dumps(options.verb(options), indent=1))


if __name__ == "__main__":
    main()
