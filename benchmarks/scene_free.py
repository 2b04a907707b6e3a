"""The scene-free concealers of anchors and Gaussians: trains one, or compares it with others. Prints one JSON object.

    python benchmarks/scene_free.py anchors train A=data/a B=data/b -o scene_free.safetensors
    python benchmarks/scene_free.py anchors score C=data/c --weights scene_free.safetensors
    python benchmarks/scene_free.py gaussians train a.spz b.ply -o scene_free_gaussians.safetensors
    python benchmarks/scene_free.py gaussians score c.ply --seeds 0 1 2

A scene of anchors is SOURCE=DATASET: a stream, a scene file or a folder of an official HAC++ model, and the folder of
its photos. Training uses the views of training photos, scoring uses test photos (losses of 20 % of `.pak` units, the
same for all methods). A scene of Gaussians is a file without photos. Pictures from orbit views are compared with those
of the complete stream (training) or of the file (scoring). For an honest figure leave the scored scene, and other
models of the same photos, out of the training.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gain_training import LossyStream, SceneFreeConfig, train_for_gaussians, train_scene_free

from splatwire.anchors.scene_file import load_scene
from splatwire.bitstream import PRESETS, SceneStream, read_stream
from splatwire.calibration.pseudo_loss import CalibrationData, calibration_data
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment import Concealer, conceal, create_concealer
from splatwire.concealment.scene_free import save_network
from splatwire.data import open_dataset
from splatwire.evaluation.views import photo_views, spread
from splatwire.io import open_scene
from splatwire.metrics import psnr
from splatwire.neural.importers.hacpp import import_hacpp
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets

RATES = (0.2, 0.1, 0.3)
FLOOR = 1e-5


def step_printer(every: int) -> Callable[[int, float], None]:
    """Returns a function that prints the mean loss of the last steps on standard error."""
    losses: list[float] = []

    def on_step(step: int, loss: float) -> None:
        losses.append(loss)
        if step % every == 0:
            print(f"step {step}: {sum(losses[-every:]) / len(losses[-every:]):.4f}", file=sys.stderr, flush=True)

    return on_step


def saved(network: Any, sources: Sequence[Path], options: argparse.Namespace, started: float) -> dict[str, object]:
    """Saves a trained network with its record, which is returned with the seconds and bytes."""
    record = {
        "scenes": " ".join(source.name for source in sources),
        "settings": f"views {options.views}, width {options.width}, steps {options.steps}, seed {options.seed}",
    }
    save_network(network, options.output, record=record)
    return {**record, "seconds": time.perf_counter() - started, "num_bytes": options.output.stat().st_size}


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


def train_anchors(options: argparse.Namespace) -> dict[str, object]:
    started = time.perf_counter()
    scenes = [to_learn_from(source, photos, options.views, options.width) for source, photos in options.scenes]
    config = SceneFreeConfig(steps=options.steps, seed=options.seed)
    network = train_scene_free(scenes, config, progress=step_printer(25))
    return saved(network, [source for source, _ in options.scenes], options, started)


def score_anchors(options: argparse.Namespace) -> dict[str, object]:
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
        received = decode_stream(transmit(stream, loss, seed=seed)[0])
        for name, method in methods.items():
            figures[name].append(mean_psnr(conceal(received, method)))
        print(source.name, seed, {n: round(v[-1], 3) for n, v in figures.items()}, file=sys.stderr, flush=True)
    return {
        "num_anchors": stream.manifest.num_elements,
        "views": views.cameras.num_views,
        "no loss": mean_psnr(decode_stream(stream).scene) if options.lossless else None,
        "psnr": figures,
        "mean": {name: sum(values) / len(values) for name, values in figures.items()},
    }


def train_gaussians(options: argparse.Namespace) -> dict[str, object]:
    started, streams = time.perf_counter(), []
    for path in options.scenes:
        scene = open_scene(path)
        stream = encode_scene(scene, PRESETS["datagram"], class_offsets=scene_class_offsets(scene))
        streams.append(LossyStream(stream, surrounding_cameras(scene, options.views, options.width)))
        print(f"{path.name}: {stream.manifest.num_elements} Gaussians", file=sys.stderr, flush=True)
    config = SceneFreeConfig(steps=options.steps, drop_rates=RATES, floor=FLOOR, seed=options.seed)
    network = train_for_gaussians(streams, config, progress=step_printer(40))
    return saved(network, options.scenes, options, started)


def score_gaussians(options: argparse.Namespace) -> dict[str, object]:
    loss, found = parse_loss(f"bernoulli:{options.rate}", "datagram"), dict[str, dict[str, Any]]()
    given = {} if options.weights is None else {"gaussian_weights": options.weights}
    names = {name: create_concealer(name, **(given if name == "scene_free" else {})) for name in options.conceal}
    for path in options.scenes:
        scene = open_scene(path)
        stream = encode_scene(scene, PRESETS["datagram"], class_offsets=scene_class_offsets(scene))
        cameras = surrounding_cameras(scene, options.views, options.width)
        truth = list(iterate_views(scene, cameras))

        def quality(shown, truth=truth, cameras=cameras) -> float:  # type: ignore[no-untyped-def]
            pairs = zip(iterate_views(shown, cameras), truth, strict=True)
            return sum(float(psnr(a[None], b[None])[0]) for a, b in pairs) / len(truth)

        figures: dict[str, list[float]] = {name: [] for name in names}
        for seed in options.seeds:
            received = decode_stream(transmit(stream, loss, seed=seed)[0])
            for name, method in names.items():
                figures[name].append(quality(conceal(received, method)))
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


def photographed(text: str) -> tuple[Path, Path]:
    source, equals, photos = text.partition("=")
    if not equals:
        raise argparse.ArgumentTypeError(f"'{text}' is not SOURCE=DATASET")
    return Path(source), Path(photos)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(required=True)
    anchors, gaussians = (kinds.add_parser(name).add_subparsers(required=True) for name in ("anchors", "gaussians"))
    for verbs, scene, work, views, width, steps in (
        (anchors, photographed, train_anchors, 6, 400, SceneFreeConfig.steps),
        (gaussians, Path, train_gaussians, 8, 200, 320),
    ):
        learn = verbs.add_parser("train")
        learn.set_defaults(verb=work)
        learn.add_argument("scenes", nargs="+", type=scene)
        learn.add_argument("-o", "--output", type=Path, required=True)
        learn.add_argument("--views", type=int, default=views, help="training views of a scene")
        learn.add_argument("--width", type=int, default=width, help="width of their pictures")
        learn.add_argument("--steps", type=int, default=steps)
        learn.add_argument("--seed", type=int, default=0)
    for verbs, scene, work, most, seeds in (
        (anchors, photographed, score_anchors, None, [0, 1, 2, 3, 4]),
        (gaussians, Path, score_gaussians, 8, [0, 1, 2]),
    ):
        judge = verbs.add_parser("score")
        judge.set_defaults(verb=work)
        judge.add_argument("scenes", nargs="+", type=scene)
        judge.add_argument("--conceal", nargs="*", default=["drop", "grow", "scene_free"])
        judge.add_argument("--weights", type=Path, help="instead of those of the package")
        judge.add_argument("--views", type=int, default=most, help="most views; all test views where absent")
        judge.add_argument("--width", type=int, default=256, help="width of orbit views")
        judge.add_argument("--rate", type=float, default=0.2)
        judge.add_argument("--seeds", type=int, nargs="*", default=seeds)
        judge.add_argument("--lossless", action="store_true", help="score scenes of anchors without losses, too")
    options = parser.parse_args()
    print(json.dumps(options.verb(options), indent=1))


if __name__ == "__main__":
    main()
