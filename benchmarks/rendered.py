"""What a sketch in the stream brings to the picture, by its bytes: PSNR against photos at 20 % lost packets, as JSON.

    python benchmarks/rendered.py MODEL PHOTOS --shares 0.008 0.025 0.04

MODEL is a folder of the official HAC++ code, a scene file or a stream. The sketch is made with training views; it is
scored on test views, every method on the same losses.
"""

import argparse
import dataclasses
import json
import os
import statistics
import sys
import time
from pathlib import Path

import torch

from splatwire.calibrate.sketch import SketchConfig, sketch_of
from splatwire.calibrate.views import CalibrationViews
from splatwire.channel import parse_loss, transmit
from splatwire.codec import add_concealment, decode_stream, encode_scene, without_concealment
from splatwire.conceal import conceal
from splatwire.conceal.sketch import SECTION
from splatwire.data import Dataset, open_dataset
from splatwire.evaluate.views import photo_views, spread
from splatwire.importers.hacpp import import_hacpp
from splatwire.metrics import psnr
from splatwire.model import AnchorScene
from splatwire.model.scene_file import load_scene
from splatwire.packets import PRESETS, SceneStream, read_stream
from splatwire.render import iterate_views


def stream_of(path: Path) -> SceneStream:
    if path.is_dir() and (path / "point_cloud").exists():
        return encode_scene(import_hacpp(path), PRESETS["paper"])
    if path.suffix == ".swz":
        return without_concealment(read_stream(path)[0], SECTION)
    return encode_scene(load_scene(path), PRESETS["paper"])


def calibrated(stream: SceneStream, photos: Dataset, shares: list[float], told: str) -> list[dict]:
    complete = decode_stream(stream)
    views = CalibrationViews.of_photos(photos)
    rows = []
    for share in shares:
        cpu, started = time.process_time(), time.perf_counter()
        made = sketch_of(stream, complete, views, SketchConfig(share=share))
        richer = add_concealment(stream, SECTION, made.section)
        row = {
            "share_asked": share,
            "section": made.section,
            "bytes_added": richer.num_bytes - stream.num_bytes,
            "percent_of_stream": 100 * (richer.num_bytes / stream.num_bytes - 1),
            "anchors_sketched": made.num_sketched,
            "growth_exponent": made.exponent,
            "growth_trust": made.trust,
            "calibration_cpu_seconds": time.process_time() - cpu,
            "calibration_seconds": time.perf_counter() - started,
            "training_views_held_out_losses": made.psnr,
        }
        print(told, {name: value for name, value in row.items() if name != "section"}, file=sys.stderr, flush=True)
        rows.append(row)
    return rows


def quality(scene: AnchorScene, photos: Dataset) -> float:
    views = photo_views(photos)
    images = iterate_views(scene, photos.cameras, background=torch.tensor(photos.background))
    return statistics.mean(float(psnr(i[None], views.reference(v)[None])[0]) for v, i in enumerate(images))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--shares", type=float, nargs="*", default=[0.008, 0.025, 0.04])
    parser.add_argument("--views", type=int, default=13)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--background", type=float, default=0.0, help="grey level where photos are transparent")
    options = parser.parse_args()
    name, grey = options.model.stem, (options.background,) * 3
    stream = stream_of(options.model)
    train = open_dataset(options.photos, split="train", background=grey)
    test = open_dataset(options.photos, split="test", background=grey)
    test = test.select(spread(test.num_views, options.views))
    sketches = calibrated(stream, train, options.shares, name)
    scores: dict[str, list[float]] = {"drop": [], "grow": [], **{f"sketch {s['share_asked']}": [] for s in sketches}}
    for seed in range(options.seeds):
        partial = decode_stream(transmit(stream, parse_loss("bernoulli:0.2"), seed=seed)[0])
        sections = {f"sketch {s['share_asked']}": s["section"] for s in sketches}
        for method, each in scores.items():
            carried = {SECTION: sections[method]} if method in sections else {}
            drawn = conceal(dataclasses.replace(partial, sections=carried), method.split()[0])
            each.append(quality(drawn, test))
        print(name, seed, {m: round(e[-1], 3) for m, e in scores.items()}, file=sys.stderr, flush=True)
    report = {
        "model": name,
        "stream_bytes": stream.num_bytes,
        "anchors": stream.manifest.num_elements,
        "test_views": test.num_views,
        "width": test.cameras.width,
        "load": os.getloadavg()[0],
        "sketches": [{k: v for k, v in s.items() if k != "section"} for s in sketches],
        "psnr_no_loss": quality(decode_stream(stream).scene, test),
        "psnr": scores,
        "mean_psnr": {method: statistics.mean(each) for method, each in scores.items()},
    }
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
