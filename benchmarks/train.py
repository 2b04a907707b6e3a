"""Trains on the photos of a recorded official run, with its settings, and prints as JSON how the two compare.

Goals: decoded test PSNR at least official - 0.10 dB, total bytes at most official x 1.02, an iteration at most half the
official time at equal anchors. Seconds are processor time with one thread, beside wall time, so that the figures can
be compared on a busy machine; the official figures are wall time of two idle cores.

    python benchmarks/train.py [--data DIR] [--run snowmiku_small_2400] [--iterations N] [--threads 2] [--output SCENE]
"""

import argparse
import json
import os
import resource
import time
from pathlib import Path
from typing import Any

import numba
import torch

from splatwire.codec import decode_stream, encode_scene
from splatwire.data import open_dataset
from splatwire.model.scene_file import save_scene
from splatwire.train import Listener, Progress, RunOptions, create_config, train_scene
from splatwire.train.trainer import assess_scene

RUNS = {"snowmiku_small_2400": ("snowmiku_small", 2400, 0.01), "snowmiku_15k": ("snowmiku", 15_000, 0.001),
        "bonsai_30k": ("bonsai", 30_000, 0.001)}  # fmt: skip
MARK = 200


class Marks:
    """Iterations per second and anchors every `MARK` iterations, as the official marks."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def __call__(self, now: Progress) -> None:
        if now.iteration % MARK:
            return
        wall, cpu = time.perf_counter(), time.process_time()
        self.rows.append({"it": now.iteration, "anchors": now.num_anchors, "l1": now.l1, "loss": now.loss,
                          "its_per_s": MARK / (wall - self._wall), "cpu_s_per_it": (cpu - self._cpu) / MARK,
                          "estimated_bytes": now.estimated_bytes})  # fmt: skip
        self._wall, self._cpu = wall, cpu
        print(json.dumps(self.rows[-1]), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("SPLATWIRE_DATA", "../shared/data")))
    parser.add_argument("--run", choices=RUNS, default="snowmiku_small_2400")
    parser.add_argument("--iterations", type=int, help="length of the run; the official run's if absent")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    numba.set_num_threads(arguments.threads)

    scene_name, iterations, voxel_size = RUNS[arguments.run]
    official = json.loads((arguments.data / "hacpp" / arguments.run / "metrics.json").read_text())
    config = create_config(iterations=arguments.iterations or iterations, lmbda=0.004, voxel_size=voxel_size)
    folder = arguments.data / "scenes" / scene_name
    train, test = open_dataset(folder, split="train"), open_dataset(folder, split="test")
    marks = Marks()
    options = RunOptions(test_interval=0)
    result = train_scene(train, test, config, options=options, listener=Listener(progress=marks))
    if arguments.output:
        save_scene(result.scene, arguments.output)
    stream = encode_scene(result.scene)
    decoded = assess_scene(decode_stream(stream).scene, test, test.num_views, iterations)
    assert result.test is not None
    summary = {
        "run": arguments.run,
        "iterations": config.marks.iterations,
        "threads": arguments.threads,
        "seconds": result.seconds,
        "test_psnr": result.test.psnr,
        "decoded_psnr": decoded.psnr,
        "decoded_ssim": decoded.ssim,
        "official_psnr": official["test_after_psnr"],
        "psnr_gain_db": decoded.psnr - official["test_after_psnr"],
        "bytes": stream.num_bytes,
        "official_bytes": official["total_bytes_files_plus_mlps"],
        "bytes_ratio": stream.num_bytes / official["total_bytes_files_plus_mlps"],
        "anchors": result.scene.anchors.num_anchors,
        "official_anchors": official["anchors_kept"],
        "peak_memory_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20),
        "marks": marks.rows,
        "official_marks": official["marks"],
    }
    print(json.dumps(summary, indent=1))


if __name__ == "__main__":
    main()
