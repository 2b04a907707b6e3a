"""Speed and GPU activity of a training iteration with entropy terms at a number of anchors.

The state is made quickly: 300 iterations on the photos, then shifted copies of anchors up to the number. A checkpoint
keeps it for measurements of another version of the package:

    python benchmarks/gpu_speed.py --device cuda --checkpoint state.checkpoint --json new.json
    PYTHONPATH=OLD/src python benchmarks/gpu_speed.py --device cuda --checkpoint state.checkpoint --json old.json

Prints iterations a second, and per iteration of a profile: launches, copies between host and device, synchronisations
and milliseconds of the GPU's kernels.
"""

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import torch

import splatwire
from splatwire.data import Dataset, open_dataset
from splatwire.neural.model.tensors import to_tensors
from splatwire.neural.training import create_config
from splatwire.neural.training.checkpoint import load_checkpoint, save_checkpoint
from splatwire.neural.training.config import TrainConfig
from splatwire.neural.training.export import export_scene
from splatwire.neural.training.initial import initial_state
from splatwire.neural.training.kernels import choose_kernels
from splatwire.neural.training.photos import PhotoStore
from splatwire.neural.training.progress import RunningMeans
from splatwire.neural.training.size import stream_bytes
from splatwire.neural.training.state import ANCHOR_PARAMETERS, TrainState, append_anchors, move_state
from splatwire.neural.training.step import TrainingStep

SPREAD = 12
"""Largest distance in voxels between an anchor and its copy, along each axis."""


class Loop:
    """Training iterations as the trainer performs them."""

    def __init__(self, train: Dataset, config: TrainConfig, device: str) -> None:
        place = torch.device(device)
        kernels = choose_kernels(place)
        cameras = to_tensors(train.cameras, place)
        self.step, self.photos = TrainingStep(config, cameras, kernels), PhotoStore(train, place, kernels.prepare_photo)
        interval = getattr(kernels, "report_interval", None)
        iterations = config.milestones.iterations
        self.means = RunningMeans(iterations) if interval is None else RunningMeans(iterations, interval)
        self.views, self.on_gpu = train.num_views, place.type == "cuda"

    def run(self, state: TrainState, count: int, start: int | None = None) -> float:
        """Seconds that some iterations take, from the one after `start`, or from where the last call ended."""
        state.iteration = state.iteration if start is None else start
        self._wait()
        began = time.perf_counter()
        for _ in range(count):
            view = state.iteration * 7 % self.views
            self.means.update(state, self.step(state, view, self.photos.photo(view)), 0.01, 1.0)
        self._wait()
        return time.perf_counter() - began

    def _wait(self) -> None:
        if self.on_gpu:
            torch.cuda.synchronize()


@torch.no_grad()
def multiply(state: TrainState, num_anchors: int) -> None:
    """Adds nearby copies of anchors up to the requested number."""
    missing = num_anchors - state.num_anchors
    if missing <= 0:
        return
    rng = torch.Generator().manual_seed(0)
    rows = torch.randint(state.num_anchors, (missing,), generator=rng).to(state.device)
    moved = torch.randint(-SPREAD, SPREAD + 1, (missing, 3), generator=rng).to(state.device)
    copies = {name: state.parameters[name].detach()[rows] for name in ANCHOR_PARAMETERS}
    append_anchors(state, state.voxels[rows] + moved, copies)


def profiled(loop: Loop, state: TrainState, count: int) -> dict[str, Any]:
    """GPU activity of one iteration, measured by a profile."""
    activities = [torch.profiler.ProfilerActivity.CPU]
    if loop.on_gpu:
        activities.append(torch.profiler.ProfilerActivity.CUDA)
    with torch.profiler.profile(activities=activities) as profile:
        loop.run(state, count)
    events = profile.key_averages()

    def calls(*starts: str) -> float:
        return sum(event.count for event in events if event.key.startswith(starts)) / count

    device_us = sum(
        getattr(event, "self_device_time_total", 0)
        for event in events
        if "CUDA" in str(getattr(event, "device_type", ""))
    )
    slow = sorted(events, key=lambda event: -event.self_cpu_time_total)[:25]
    return {
        "launches": calls("cudaLaunch", "cuLaunch"),
        "host_copies": calls("Memcpy HtoD", "Memcpy DtoH"),
        "device_copies": calls("Memcpy DtoD"),
        "synchronisations": calls("cudaStreamSynchronize", "cudaDeviceSynchronize", "cudaEventSynchronize"),
        "operations": sum(event.count for event in events if event.key.startswith("aten::")) / count,
        "gpu_ms": device_us / 1000 / count,
        "host_us_by_operation": {event.key: [event.self_cpu_time_total / count, event.count / count] for event in slow},
    }


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("SPLATWIRE_DATA", "../shared/data")))
    parser.add_argument("--scene", default="bonsai")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parser.add_argument("--anchors", type=int, default=270_000)
    parser.add_argument("--warm", type=int, default=300, help="iterations before anchors are copied")
    parser.add_argument("--iterations", type=int, default=200, help="iterations that are timed")
    parser.add_argument("--profile", type=int, default=20, help="iterations that are profiled")
    parser.add_argument("--checkpoint", type=Path, help="state to measure; made if absent")
    parser.add_argument("--code", action="store_true", help="time the coder, too")
    parser.add_argument("--json", type=Path, help="file for the result")
    return parser.parse_args()


def main() -> None:
    arguments = parse()
    train = open_dataset(arguments.data / "scenes" / arguments.scene, split="train")
    config = create_config(model="causal", voxel_size=0.001, lmbda=0.004)
    loop, marks = Loop(train, config, arguments.device), config.milestones
    path = arguments.checkpoint
    if path is not None and path.exists():
        state = move_state(load_checkpoint(path)[0], torch.device(arguments.device))
    else:
        state = move_state(initial_state(train, config), torch.device(arguments.device))
        print(f"{arguments.warm} iterations without noise: {loop.run(state, arguments.warm):.1f} s", flush=True)
        multiply(state, arguments.anchors)
        loop.run(state, 2, marks.context_start)  # the networks are calibrated in the first
        state.iteration = marks.growth_end
        if path is not None:
            save_checkpoint(state, config, path)
    loop.run(state, max(arguments.iterations // 4, 2))
    seconds = loop.run(state, arguments.iterations)
    result: dict[str, Any] = {
        "anchors": state.num_anchors, "device": arguments.device, "iterations": arguments.iterations,
        "its_per_s": arguments.iterations / seconds, "package": splatwire.__file__,
    }  # fmt: skip
    count = min(arguments.iterations, 40)
    watched = loop.run(state, count, marks.context_start + 101)  # between two changes of the anchors
    result["its_per_s_with_growth"] = count / watched
    state.iteration = marks.growth_end
    result |= profiled(loop, state, arguments.profile)
    if loop.on_gpu:
        result |= {"gpu": torch.cuda.get_device_name(), "peak_gpu_gib": torch.cuda.max_memory_allocated() / (1 << 30)}
    write(result, arguments.json)
    if arguments.code:
        for name in ("code_first_s", "code_s"):
            began = time.perf_counter()
            size = stream_bytes(export_scene(state, config))
            result |= {name: time.perf_counter() - began, "bytes": size}
        write(result, arguments.json)
    print(json.dumps(result, indent=1))


def write(result: dict[str, Any], path: Path | None) -> None:
    """Writes the results so far."""
    if path is not None:
        path.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
