"""Bytes at a PSNR of `encode --effort best` and `default` against all Gaussians, as JSON.

    python benchmarks/fine_tuning.py luigi.ply guitar.compressed.ply --psnr 40 -o fine_tuning.json
    python benchmarks/fine_tuning.py guitar.compressed.ply --psnr 40 --loss bernoulli:0.2 -o fine_tuning_loss.json

Pictures are compared with the file's own in 15 views that no encoder uses (`splatwire.evaluation.views`). `fast` keeps
all Gaussians; its bytes at the PSNR of another stream are interpolated between several levels of quantisation, as
logarithms of bytes over PSNR. Seconds are processor time of all threads. Results of other files in the output file are
kept. With `--loss`, the streams have datagrams and redundant copies, and are also measured at 20 % lost datagrams.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from figures import publish

from splatwire.bitstream import PRESETS, SceneStream, write_stream
from splatwire.channel import parse_loss, transmit
from splatwire.cli._calibration import with_quick_sketch
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.concealment import conceal
from splatwire.io import open_scene
from splatwire.rate_control import EncodedScene, Target, Tuning, encode_controlled
from splatwire.rate_control.encoding import Effort, decoded_finest
from splatwire.rate_control.views import SourcePictures
from splatwire.types import SplatScene

LEVELS = (5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
"""Levels of quantisation of `fast`."""
LOSSES = 4
"""Number of draws of lost datagrams."""


def bytes_at(points: list[dict], wanted: float) -> float:
    """Bytes at a PSNR; not a number outside of the measured range."""
    points = sorted(points, key=lambda point: point["psnr"])
    logs = np.log([point["bytes"] for point in points])
    return float(np.exp(np.interp(wanted, [point["psnr"] for point in points], logs, np.nan, np.nan)))


def lossy(stream: SceneStream, pictures: SourcePictures) -> dict[str, float]:
    """PSNR by concealer at 20 % lost datagrams, mean of `LOSSES` seeds."""
    found: dict[str, list[float]] = {"drop": [], "grow": [], "sketch": []}
    for seed in range(LOSSES):
        received, _ = transmit(stream, parse_loss("bernoulli:0.2", "datagram"), seed=seed)
        partial = decode_stream(received)
        for name, values in found.items():
            values.append(pictures.mean_psnr(conceal(partial, name)))
    return {name: float(np.mean(values)) for name, values in found.items()}


def measured(path: Path, options: argparse.Namespace) -> dict[str, object]:
    """Results of one file."""
    scene = open_scene(path)
    if not isinstance(scene, SplatScene):
        raise SystemExit(f"{path} holds no explicit Gaussians")
    packetization = PRESETS["datagram" if options.loss else "paper"]
    loss = parse_loss(options.loss, "datagram") if options.loss else None
    tuning = Tuning(options.iterations, options.views, loss=loss, seed=options.seed)

    def encode(some: SplatScene, classes: np.ndarray, quality: Quality) -> SceneStream:
        stream = encode_scene(some, packetization, classes=classes, quality=quality)
        return with_quick_sketch(stream, None, lambda task, share: None) if options.loss else stream

    def controlled(target: Target, effort: Effort) -> tuple[EncodedScene, dict[str, float]]:
        started = time.process_time()
        found = encode_controlled(scene, target, encode, effort=effort, tuning=tuning)
        seconds = time.process_time() - started
        psnr, size = pictures.mean_psnr(decoded_finest(found.stream)), found.stream.num_bytes
        level = found.quality.level
        return found, {"bytes": size, "psnr": psnr, "kept": found.kept, "level": level, "seconds": seconds}

    first = encode_controlled(scene, Target(quality=Quality(LEVELS[0])), encode, effort="fast")
    pictures = first.held_out
    fast = [controlled(Target(quality=Quality(level)), "fast")[1] for level in LEVELS]
    result: dict[str, object] = {
        "gaussians": scene.num_elements, "degree": scene.splats.degree, "iterations": options.iterations,
        "views": options.views, "fast": fast,
    }  # fmt: skip
    for effort in ("default", "best"):
        found, row = controlled(Target(psnr=options.psnr), effort)
        if options.streams:
            write_stream(found.stream, options.streams / f"{path.stem}.{effort}.swz")
        result[effort] = {**row, "share_of_fast_at_equal_psnr": row["bytes"] / bytes_at(fast, row["psnr"])}
        if options.loss:
            result[f"{effort}, 20 % lost"] = lossy(found.stream, pictures)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--psnr", type=float, default=40.0)
    parser.add_argument("--iterations", type=int, default=Tuning().iterations)
    parser.add_argument("--views", type=int, default=Tuning().num_views)
    parser.add_argument("--loss")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--streams", type=Path, help="existing folder for the streams of default and best")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    known = options.output is not None and options.output.exists()
    results = json.loads(options.output.read_text()) if known else {}
    for path in options.files:
        results[path.name] = measured(path, options)
        publish(results, options.output)


if __name__ == "__main__":
    main()
