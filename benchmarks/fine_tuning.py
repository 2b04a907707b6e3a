"""Bytes at a PSNR of `encode --effort best` and `default` against all Gaussians, as JSON.

    python benchmarks/fine_tuning.py luigi.ply guitar.compressed.ply --psnr 40 -o fine_tuning.json
    python benchmarks/fine_tuning.py guitar.compressed.ply --psnr 40 --loss bernoulli:0.2 -o fine_tuning_loss.json

Pictures are compared with the file's own in 15 views that no encoder uses (`splatwire.evaluation.views`). `fast` keeps
all Gaussians; its bytes at the PSNR of another stream are interpolated between several levels of quantisation, as
logarithms of bytes over PSNR. `near` is the mean PSNR in 15 views close to surfaces that no encoder uses. Seconds are
processor time of all threads. Results of other files in the output file are kept. With `--loss`, the streams have
datagrams, and are also measured at 20 % lost datagrams, without and with redundant copies of different total sizes.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from figures import publish

from splatwire.bitstream import PRESETS, SceneStream, write_stream
from splatwire.calibration.sketch import sketch_of
from splatwire.calibration.sketch_config import QUICK
from splatwire.calibration.views import CalibrationViews
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene, with_section
from splatwire.codec.gaussians.quality import Quality
from splatwire.concealment import conceal
from splatwire.concealment.sketch import SECTION
from splatwire.evaluation.views import held_out_closeups
from splatwire.io import open_scene
from splatwire.rate_control import EncodedScene, Target, Tuning, encode_controlled
from splatwire.rate_control.encoding import Effort, decoded_finest
from splatwire.rate_control.views import SourcePictures
from splatwire.render.importance import surrounding_cameras
from splatwire.types import SplatScene

LEVELS = (5.0, 6.0, 7.0, 8.0, 9.0, 10.0)
"""Levels of quantisation of `fast`."""
LOSSES = 4
"""Number of draws of lost datagrams."""
COPIES = (0.01, 0.05, 0.15, 0.3, 0.5)
"""Sizes of the redundant copies, relative to the stream without copies; the first is that of `encode`."""


def bytes_at(points: list[dict], wanted: float) -> float:
    """Bytes at a PSNR, interpolated; NaN outside of the measured range."""
    points = sorted(points, key=lambda point: point["psnr"])
    logs = np.log([point["bytes"] for point in points])
    return float(np.exp(np.interp(wanted, [point["psnr"] for point in points], logs, np.nan, np.nan)))


def lossy(stream: SceneStream, pictures: SourcePictures) -> dict[str, dict[str, float]]:
    """Bytes and PSNR of each concealer at 20 % lost datagrams, mean of `LOSSES` seeds."""
    streams = {"drop": stream, "grow": stream}
    complete = decode_stream(stream)
    cameras = surrounding_cameras(complete.scene, QUICK.views, QUICK.width)
    for share in COPIES:
        copies = sketch_of(stream, complete, CalibrationViews(cameras), replace(QUICK, share=share))
        streams[f"sketch {share:g}"] = with_section(stream, SECTION, copies.section)
    return {name: {"bytes": each.num_bytes, "psnr": received(each, name.split()[0], pictures)}
            for name, each in streams.items()}  # fmt: skip


def received(stream: SceneStream, concealer: str, pictures: SourcePictures) -> float:
    """Mean PSNR at 20 % lost datagrams."""
    losses = (transmit(stream, parse_loss("bernoulli:0.2", "datagram"), seed=seed)[0] for seed in range(LOSSES))
    return float(np.mean([pictures.mean_psnr(conceal(decode_stream(each), concealer)) for each in losses]))


def measured(path: Path, options: argparse.Namespace) -> dict[str, object]:
    """Measures one file."""
    scene = open_scene(path)
    if not isinstance(scene, SplatScene):
        raise SystemExit(f"{path} holds no explicit Gaussians")
    packetization = PRESETS["datagram" if options.loss else "paper"]
    loss = parse_loss(options.loss, "datagram") if options.loss else None
    tuning = Tuning(options.iterations, options.views, packet_loss=loss, seed=options.seed)

    def encode(some: SplatScene, classes: np.ndarray, quality: Quality) -> SceneStream:
        return encode_scene(some, packetization, class_offsets=classes, quality=quality)

    def controlled(target: Target, effort: Effort) -> tuple[EncodedScene, dict[str, float]]:
        started = time.process_time()
        found = encode_controlled(scene, target, encode, effort=effort, tuning=tuning)
        seconds = time.process_time() - started
        decoded, level = decoded_finest(found.stream), found.quality.level
        return found, {
            "bytes": found.stream.num_bytes, "psnr": pictures.mean_psnr(decoded), "near": closeups.mean_psnr(decoded),
            "kept": found.kept, "level": level, "seconds": seconds,
        }  # fmt: skip

    first = encode_controlled(scene, Target(quality=Quality(LEVELS[0])), encode, effort="fast")
    pictures = first.held_out
    closeups = SourcePictures(pictures.scene, held_out_closeups(pictures.scene))
    fast = [controlled(Target(quality=Quality(level)), "fast")[1] for level in LEVELS]
    result: dict[str, object] = {
        "gaussians": scene.num_elements, "degree": scene.splats.degree, "iterations": options.iterations,
        "views": options.views, "fast": fast,
    }  # fmt: skip
    for effort in ("default", "best"):
        found, row = controlled(Target(psnr=options.psnr), effort)
        if options.streams:
            write_stream(found.stream, options.streams / f"{path.stem}.{effort}.swz")
        near = float(np.interp(row["psnr"], [each["psnr"] for each in fast], [each["near"] for each in fast]))
        result[effort] = {
            **row, "share_of_fast_at_equal_psnr": row["bytes"] / bytes_at(fast, row["psnr"]),
            "near_of_fast_at_equal_psnr": near,
        }  # fmt: skip
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
