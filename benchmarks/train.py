"""Trains on the photos of a recorded official run, with its settings, and prints as JSON how the two compare.

Goals: decoded test PSNR at least official - 0.10 dB, total bytes at most official x 1.02. An iteration takes at most
half the official time at equal anchors. Seconds are processor time with one thread, for comparison on a busy machine,
and wall time. The official figures are wall times of two idle cores or of an H200 (`official_gpu`).

    python benchmarks/train.py [--data DIR] [--run snowmiku_small_2400] [--iterations N] [--threads 2] [--output SCENE]

On a GPU, iterations per second and anchors are compared every 1,000 iterations. The first command stops early; the
others include quality and size. The causal model aims at half of the official bytes. `gpu.sh` runs all commands, and
`--table` shows their results:

    python benchmarks/train.py --run bonsai_30k --device cuda --until 12000
    python benchmarks/train.py --run bonsai_30k --device cuda --model causal --minutes 16
    python benchmarks/train.py --run bonsai_30k --device cuda --model causal --fit 7 --speed speed.json
    python benchmarks/train.py --table FOLDER/*.json
"""

import argparse
import json
import math
import os
import resource
import time
from pathlib import Path
from typing import Any

import numba
import torch

from splatwire.anchors.scene_file import save_scene
from splatwire.bitstream import SceneStream, stream_to_bytes
from splatwire.cli._run_train import check_device
from splatwire.codec import decode_stream, encode_scene
from splatwire.data import Dataset, open_dataset
from splatwire.neural.training import Listener, Progress, RunOptions, TrainResult, create_config, train_scene
from splatwire.neural.training.presets import HACPP, MIN_ITERATIONS, MODELS
from splatwire.neural.training.quality import assess_scene

RUNS = {"snowmiku_small_2400": ("snowmiku_small", 2400, 0.01), "snowmiku_15k": ("snowmiku", 15_000, 0.001),
        "bonsai_30k": ("bonsai", 30_000, 0.001)}  # fmt: skip
MARK = 200
TOTAL = "total_bytes_files_plus_mlps"
"""Keys of bytes in the official metrics."""


class Marks:
    """Iterations per second and number of anchors every `MARK` iterations, like the official record."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self._start = time.perf_counter()
        self._wall, self._cpu = self._start, time.process_time()

    def __call__(self, now: Progress) -> None:
        if now.iteration % MARK:
            return
        wall, cpu = time.perf_counter(), time.process_time()
        self.rows.append({"it": now.iteration, "s": wall - self._start, "anchors": now.num_elements,
                          "l1": now.l1, "loss": now.loss, "its_per_s": MARK / (wall - self._wall),
                          "cpu_s_per_it": (cpu - self._cpu) / MARK,
                          "estimated_bytes": now.estimated_bytes})  # fmt: skip
        self._wall, self._cpu = wall, cpu
        print(json.dumps(self.rows[-1]), flush=True)


def speed(rows: list[dict[str, Any]], official: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Our iterations per second and the official ones, over the same iterations.

    `ratio_at_equal_anchors` takes the time of an iteration as proportional to its anchors.
    """
    seconds, compared = {0: 0.0, **{row["it"]: row["s"] for row in rows}}, []
    anchors = {row["it"]: row["anchors"] for row in rows}
    for before, mark in zip([{"it": 0}, *official[:-1]], official, strict=True):
        if before["it"] not in seconds or mark["it"] not in anchors:
            continue
        ours = (mark["it"] - before["it"]) / (seconds[mark["it"]] - seconds[before["it"]])
        ratio = ours / mark["its_per_s"]
        compared.append({"it": mark["it"], "its_per_s": ours, "official_its_per_s": mark["its_per_s"],
                         "anchors": anchors[mark["it"]], "official_anchors": mark["anchors"], "ratio": ratio,
                         "ratio_at_equal_anchors": ratio * anchors[mark["it"]] / mark["anchors"]})  # fmt: skip
    return compared


def machine(device: str) -> dict[str, Any]:
    """Properties of the machine."""
    memory = {"peak_memory_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1 << 20)}
    if device == "cpu":
        return memory
    return {
        **memory,
        "gpu": torch.cuda.get_device_name(),
        "peak_gpu_gib": torch.cuda.max_memory_allocated() / (1 << 30),
    }


COLUMNS = ("run", "model", "device", "iterations done", "its/s", "official its/s", "ratio at equal anchors", "PSNR, dB",
           "official", "bytes", "of the official", "GPU memory, GiB")  # fmt: skip


def table(summaries: list[dict[str, Any]]) -> str:
    """Runs as rows of a Markdown table; a dash marks a value unknown for a stopped run.

    Iterations a second are means over all marks that both runs have.
    """
    rows = [COLUMNS, ("---",) * len(COLUMNS)]
    for found in summaries:
        done, compared = found["marks"][-1] if found["marks"] else {"it": 0, "s": 0.0}, found["speed"]
        mean = {key: sum(row[key] for row in compared) / len(compared) if compared else None
                for key in ("official_its_per_s", "ratio_at_equal_anchors")}  # fmt: skip
        cells = (
            found["run"], found["model"], found.get("gpu", found["device"]), done["it"],
            done["it"] / done["s"] if done["s"] else None, *mean.values(), found.get("decoded_psnr"),
            found.get("official_psnr"), found.get("bytes"), found.get("bytes_ratio"), found.get("peak_gpu_gib"),
        )  # fmt: skip
        rows.append(tuple("-" if c is None else f"{c:.2f}" if isinstance(c, float) else str(c) for c in cells))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("SPLATWIRE_DATA", "../shared/data")))
    parser.add_argument("--run", choices=RUNS, default="snowmiku_small_2400")
    parser.add_argument("--iterations", type=int, help="length of the run; the official run's if absent")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--until", type=int, help="stop after so many iterations of the schedule: the speed alone")
    parser.add_argument("--model", choices=MODELS, default="hacpp")
    parser.add_argument("--minutes", type=float, help="stop after so many minutes, however far the schedule is")
    parser.add_argument("--fit", type=float, help="shorten the run so that it takes about so many minutes")
    parser.add_argument("--speed", type=Path, help="result of gpu_speed.py, which --fit is computed from")
    parser.add_argument("--output", type=Path, help="scene file or stream (.swz), written even if the run is stopped")
    parser.add_argument("--json", type=Path, help="file for the summary as well")
    parser.add_argument("--table", type=Path, nargs="+", help="such files: print them as a table, train nothing")
    return parser.parse_args()


def main() -> None:
    arguments = parse()
    if arguments.table:
        print(table([json.loads(path.read_text()) for path in arguments.table]))
        return
    torch.set_num_threads(arguments.threads)
    numba.set_num_threads(arguments.threads)

    scene_name, iterations, voxel_size = RUNS[arguments.run]
    official = json.loads((arguments.data / "hacpp" / arguments.run / "metrics.json").read_text())
    length = arguments.iterations or iterations
    if arguments.fit:
        length = min(length, fitting(json.loads(arguments.speed.read_text())["its_per_s"], arguments.fit))
    aim: dict[str, Any] = {"lmbda": 0.004} if arguments.model == HACPP else {"size": official[TOTAL] // 2}
    config = create_config(model=arguments.model, iterations=length, voxel_size=voxel_size, **aim)
    folder = arguments.data / "scenes" / scene_name
    train, test = open_dataset(folder, split="train"), open_dataset(folder, split="test")
    marks = Marks()
    options = RunOptions(test_interval=0)
    stop = arguments.until or config.milestones.iterations
    end = time.perf_counter() + 60 * (arguments.minutes or math.inf)
    listener = Listener(
        marks, should_stop=lambda: (bool(marks.rows) and marks.rows[-1]["it"] >= stop) or time.perf_counter() > end
    )
    result = train_scene(train, test, config, options=options, listener=listener, device=check_device(arguments.device))
    summary: dict[str, Any] = {
        "run": arguments.run, "model": arguments.model, "device": arguments.device,
        "iterations": config.milestones.iterations, "until": stop, "threads": arguments.threads,
        "seconds": result.seconds, **machine(arguments.device),
        "official_gpu": official.get("gpu"), "speed": speed(marks.rows, official["marks"]), "marks": marks.rows,
        "official_marks": official["marks"],
    }  # fmt: skip
    summary |= {"stopped": result.stopped, "iterations_done": result.state.iteration}
    write(summary, arguments.json)
    if arguments.output or not result.stopped:
        stream = encode_scene(result.scene)
        if arguments.output and arguments.output.suffix == ".swz":
            arguments.output.write_bytes(stream_to_bytes(stream))
        elif arguments.output:
            save_scene(result.scene, arguments.output)
        summary |= quality(result, stream, test, official, "cpu" if arguments.device == "cpu" else "gsplat")
        write(summary, arguments.json)
    print(json.dumps(summary, indent=1))


def fitting(its_per_s: float, minutes: float) -> int:
    """Number of iterations that fit into some minutes, at the speed with all anchors and entropy terms."""
    return max(round(60 * minutes * its_per_s), MIN_ITERATIONS)


def write(summary: dict[str, Any], path: Path | None) -> None:
    """Writes the results so far."""
    if path:
        path.write_text(json.dumps(summary, indent=1) + "\n")


def quality(
    result: TrainResult, stream: SceneStream, test: Dataset, official: dict[str, Any], renderer: str
) -> dict[str, Any]:
    """PSNR and bytes of a finished run and the official one; decoded pictures are rendered by `renderer`."""
    decoded = assess_scene(decode_stream(stream).scene, test, test.num_views, result.state.iteration, renderer)
    return {
        "test_psnr": result.test.psnr if result.test else None,
        "decoded_psnr": decoded.psnr,
        "decoded_ssim": decoded.ssim,
        "official_psnr": official["test_after_psnr"],
        "psnr_gain_db": decoded.psnr - official["test_after_psnr"],
        "bytes": stream.num_bytes,
        "official_bytes": official[TOTAL],
        "bytes_ratio": stream.num_bytes / official[TOTAL],
        "anchors": result.scene.anchors.num_anchors,
        "official_anchors": official["anchors_kept"],
    }


if __name__ == "__main__":
    main()
