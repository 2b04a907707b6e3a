"""Trains explicit Gaussians on the photos of a recorded official run, and prints as JSON how the streams compare.

    python benchmarks/train_gaussians.py --gaussians 54000 --degree 1 --iterations 2400 -o train_gaussians.json

Goal: at the PSNR of the official HAC++ run, at most 0.28 of its bytes. The stream is decoded, and its pictures are
compared with the test photos, which the training does not use. Seconds are processor time of all threads. Results of
other settings in the output file are kept.
"""

import argparse
import json
import os
import time
from pathlib import Path

from figures import publish
from train import RUNS, TOTAL

from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.quality import quality_of
from splatwire.data import open_dataset
from splatwire.io import save_scene
from splatwire.neural.training import Listener, Progress, RunOptions
from splatwire.neural.training.gaussians import GaussianConfig, train_gaussians
from splatwire.neural.training.gaussians.config import GaussianRates, fine_tuning_iterations_for
from splatwire.neural.training.quality import assess_scene


def trained(options: argparse.Namespace) -> dict[str, object]:
    """Result of one training."""
    official = json.loads((options.data / "hacpp" / options.run / "metrics.json").read_text())
    folder = options.data / "scenes" / RUNS[options.run][0]
    train, test = open_dataset(folder, split="train"), open_dataset(folder, split="test")
    config = GaussianConfig(
        gaussians=options.gaussians,
        degree=options.degree,
        iterations=options.iterations,
        fine_tuning_iterations=fine_tuning_iterations_for(options.iterations),
        quality=quality_of(options.quality),
        packet_loss=options.loss,
        dropout=options.dropout,
        rates=GaussianRates().for_length(options.iterations),
        seed=options.seed,
    )
    started = time.process_time()

    def report(now: Progress) -> None:
        if now.iteration % 500 == 0:
            print(f"{now.iteration}: L1 {now.l1:.4f}, {time.process_time() - started:.0f} s", flush=True)

    result = train_gaussians(train, test, config, listener=Listener(report), options=RunOptions(test_interval=0))
    seconds = time.process_time() - started
    if options.scene:
        save_scene(result.scene, options.scene)
    stream = encode_scene(result.scene)
    decoded = assess_scene(decode_stream(stream).scene, test, test.num_views, 0)
    before = result.state.scene(config.degree, config.background)
    return {
        "run": options.run,
        "gaussians": result.scene.num_gaussians,
        "degree": config.degree,
        "iterations": config.iterations,
        "tuning": config.fine_tuning_iterations,
        "dropout": config.dropout,
        "quality": options.quality,
        "loss": options.loss,
        "seed": config.seed,
        "psnr_before_tuning": assess_scene(before, test, test.num_views, 0).psnr,
        "psnr": decoded.psnr,
        "ssim": decoded.ssim,
        "train_psnr": assess_scene(result.scene, train, train.num_views, 0).psnr,
        "official_psnr": official["test_after_psnr"],
        "bytes": stream.num_bytes,
        "bytes_ratio": stream.num_bytes / official[TOTAL],
        "seconds": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("SPLATWIRE_DATA", "../shared/data")))
    parser.add_argument("--run", choices=RUNS, default="snowmiku_small_2400")
    parser.add_argument("--gaussians", type=int, default=54_000)
    parser.add_argument("--degree", type=int, default=1)
    parser.add_argument("--dropout", type=float, default=GaussianConfig.dropout)
    parser.add_argument("--iterations", type=int, default=2400)
    parser.add_argument("--quality", default="small")
    parser.add_argument("--loss")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scene", type=Path, help="PLY to write as well")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    known = options.output is not None and options.output.exists()
    results = json.loads(options.output.read_text()) if known else []
    publish([*results, trained(options)], options.output)


if __name__ == "__main__":
    main()
