"""The paper's network with the paper's schedule: errors and PSNR over 15,000 steps on one scene.

    python benchmarks/gnn_schedule.py scene.swz cameras.json -o out/scene_paper [--preset paper|full] [--sharpness 0]
        [--render-weight 0.01 --render-cameras training.json] [--iterations 15000] [--threads 1]

Adam from 1e-3 with a half cosine, 128 wide, k = 24, a fifth of the packets dropped, as in Sections 3.4 and 4.1.4;
nothing stops the run early. Every `--every` steps the held-out losses are concealed as a receiver would; every fifth
time, some views of the first of them are drawn, too, with the best network so far and with the last. PSNR is against
the lossless render. The folder gets `curve.json`, the weights (`weights.gnn`) and a checkpoint, from which an
interrupted run goes on.
"""

import argparse
import copy
import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import torch
from gnn_ablation import BASELINES, Scorer

from splatwire.calibrate.pseudo_loss import calibration_data
from splatwire.codec import decode_stream
from splatwire.conceal import create_concealer
from splatwire.data import load_cameras
from splatwire.evaluate.views import spread
from splatwire.packets import read_stream
from splatwire.paper import Gnn
from splatwire.paper.calibration.config import CALIBRATION_PRESETS, CalibrationConfig
from splatwire.paper.calibration.run import CalibrationRun, restore_checkpoint, save_checkpoint
from splatwire.paper.gnn.weights import save_weights

_NEVER_STALE = 10**6


def configuration(options: argparse.Namespace) -> CalibrationConfig:
    preset = CALIBRATION_PRESETS[options.preset]
    settings, changes = preset.settings, dict[str, float]()
    if options.sharpness is not None:
        changes["sharpness"] = options.sharpness
    return dataclasses.replace(
        preset, settings=dataclasses.replace(settings, **changes), iterations=options.iterations, bits=0,
        losses=dataclasses.replace(preset.losses, render=options.render_weight), patience=_NEVER_STALE,
        validation_interval=options.every,
    )  # fmt: skip


def drawn(run: CalibrationRun, scorer: Scorer, which: str) -> float:
    """PSNR with the best network or with the last one; the run is left as it is."""
    other = copy.copy(run)
    other.network = copy.deepcopy(run.network)
    if which == "last":
        other.best, other.best_errors = other.network.state_dict(), run.validate()
    return scorer.psnr(Gnn(other.result(0.0).weights))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", type=Path)
    parser.add_argument("cameras", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--preset", choices=["paper", "full"], default="paper")
    parser.add_argument("--iterations", type=int, default=15000)
    parser.add_argument("--every", type=int, default=250)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--sharpness", type=float, help="of the confidence; 0 trusts every residual")
    parser.add_argument("--render-weight", type=float, default=0.0)
    parser.add_argument("--render-cameras", type=Path, help="where the rendering loss looks from: not the scored views")
    parser.add_argument("--render-width", type=int, default=200)
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    if bool(options.render_weight) != bool(options.render_cameras):
        parser.error("--render-weight and --render-cameras go together")
    torch.set_num_threads(options.threads)

    stream, _ = read_stream(options.stream)
    complete, cameras = decode_stream(stream), load_cameras(options.cameras)
    looking = load_cameras(options.render_cameras) if options.render_cameras else None
    small = looking.scaled(min(1.0, options.render_width / looking.width)) if looking else None
    run = CalibrationRun(calibration_data(stream, complete, small), configuration(options))
    seen = cameras.select(spread(cameras.num_views, options.views))
    scorer = Scorer(run.data, complete, run.held_out, seen)
    options.output.mkdir(parents=True, exist_ok=True)
    curve, checkpoint = options.output / "curve.json", options.output / "checkpoint"
    if checkpoint.exists():
        restore_checkpoint(run, checkpoint)
        report = json.loads(curve.read_text())
        report["points"] = [point for point in report["points"] if point["step"] <= run.iteration]
    else:
        concealers = {
            name: create_concealer(kind, **more) for name, (kind, more) in BASELINES.items() if "," not in name
        }
        report = {
            "scene": options.stream.stem, "anchors": run.data.scene.num_elements, "views": seen.num_views,
            "config": dataclasses.asdict(run.config), "reference": run.reference, "cpu_seconds": 0.0,
            "psnr": {name: scorer.psnr(concealer) for name, concealer in concealers.items()}, "points": [],
        }  # fmt: skip
    while not run.finished():
        advance(run, scorer, report, options.every)
        save_checkpoint(run, checkpoint)
        curve.write_text(json.dumps(report, indent=1) + "\n")
    save_weights(run.result(0.0).weights, options.output / "weights.gnn", precision="float16")


def advance(run: CalibrationRun, scorer: Scorer, report: dict[str, Any], steps: int) -> None:
    """Some steps, then a point of the curve."""
    began, losses = time.process_time(), []
    while len(losses) < steps and not run.finished():
        losses.append(run.step())
    report["cpu_seconds"] += time.process_time() - began
    run.improve()
    point: dict[str, Any] = {"step": run.iteration, "loss": sum(losses) / len(losses), "last": run.validate()}
    point["best"] = run.best_errors
    if run.iteration % (5 * steps) == 0 or run.finished():
        point |= {"psnr_best": drawn(run, scorer, "best"), "psnr_last": drawn(run, scorer, "last")}
    report["points"].append(point)
    print(
        run.iteration,
        {name: round(value, 4) for name, value in point["last"].items()},
        point.get("psnr_last"),
        flush=True,
    )


if __name__ == "__main__":
    main()
