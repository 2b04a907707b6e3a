"""Collects what `gnn_schedule.py` found: one file of figures, one plot of error and PSNR over steps.

python benchmarks/gnn_curves.py out/scene_paper out/other_paper ... -o benchmarks/results/gnn_schedule.json
    --plot benchmarks/pictures/gnn_schedule.svg
"""

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import matplotlib
from figures import publish

matplotlib.use("Agg")
from matplotlib import pyplot


def read(folder: Path) -> dict[str, Any]:
    """A run: what it was compared with, and errors and PSNR by step."""
    report = json.loads((folder / "curve.json").read_text())
    points = [
        {"step": p["step"], "loss": round(p["loss"], 3), "errors": {k: round(v, 4) for k, v in p["last"].items()}}
        | ({"psnr": p["psnr_last"]} if "psnr_last" in p else {})
        for p in report["points"]
    ]
    same = {name: report[name] for name in ("scene", "anchors", "views", "config", "psnr")}
    return {"run": folder.name, **same, "interpolation": report["reference"],
            "cpu_seconds": round(report["cpu_seconds"]), "points": points}  # fmt: skip


def plot(runs: list[dict[str, Any]], path: Path) -> None:
    """Errors of features on the left, PSNR on the right, with the concealers that were not trained."""
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 4))
    for run, color in zip(runs, itertools.cycle(pyplot.rcParams["axes.prop_cycle"].by_key()["color"]), strict=False):
        drawn = [(p["step"], p["psnr"]) for p in run["points"] if "psnr" in p]
        left.plot([p["step"] for p in run["points"]], [p["errors"]["feature"] for p in run["points"]], color=color,
                  label=run["run"])  # fmt: skip
        left.axhline(run["interpolation"]["feature"], color=color, linestyle=":")
        right.plot(*zip(*drawn, strict=True), color=color, label=run["run"])
        right.axhline(run["psnr"]["drop"], color=color, linestyle="--")
        right.axhline(run["psnr"]["grow"], color=color, linestyle=":")
    left.set(xlabel="step", ylabel="error of features on held-out losses / spread", title="dotted: the interpolation")
    right.set(xlabel="step", ylabel="PSNR against the lossless render, dB", title="dashed: drop, dotted: grow")
    left.legend()
    figure.tight_layout()
    figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    runs = [read(folder) for folder in options.folders]
    publish(runs, options.output)
    if options.plot:
        plot(runs, options.plot)


if __name__ == "__main__":
    main()
