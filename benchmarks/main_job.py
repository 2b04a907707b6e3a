"""The main job on every official model: import, encode, transmit, decode, render, evaluate, each by its command.

    python benchmarks/main_job.py [--data ../shared/data] [--models ...] [--seeds 0 1 2 3 4] [--output FILE]

The loss is 20 % of `.pak` packets; all methods of a seed meet the same mask; PSNR is against the photos, over all
channels of a view, mean over views, then seeds. bonsai has 37 test views, of which 13 are drawn.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCENES = {"snowmiku_small_2400": "snowmiku_small", "snowmiku_15k": "snowmiku", "bonsai_30k": "bonsai"}
FIRST_MEASUREMENTS = {
    "bonsai_30k": {"no loss": 31.15, "drop": 27.71, "idw": 27.29},
    "snowmiku_15k": {"no loss": 29.25, "drop": 26.84, "idw": 26.93},
}
"""Means over five masks of the prototype that this project started from; masks differ, so the goal is 0.4 dB."""
GOALS = {"drop and idw near the first measurements": 0.4, "grow above drop": 0.9}


def run(*arguments: str) -> tuple[dict, float]:
    start = time.perf_counter()
    command = [sys.executable, "-m", "splatwire", *arguments, "--json"]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout), round(time.perf_counter() - start, 2)


def journey(model: str, data: Path, folder: Path, seeds: list[str], views: str) -> dict[str, object]:
    photos = str(data / "scenes" / SCENES[model])
    scene, stream = str(folder / f"{model}.safetensors"), str(folder / f"{model}.swz")
    lossy, decoded = str(folder / f"{model}_lossy.swz"), str(folder / f"{model}_decoded.safetensors")
    steps = {
        "import": ("import", "hacpp", str(data / "hacpp" / model), "-o", scene),
        "encode": ("encode", scene, "-o", stream),
        "transmit": ("transmit", stream, "-o", lossy, "--loss", "bernoulli:0.2", "--seed", "0"),
        "decode": ("decode", lossy, "-o", decoded, "--conceal", "grow"),
        "render": ("render", decoded, "--data", photos, "-o", str(folder / f"{model}_pictures")),
        "inspect": ("inspect", decoded),
    }
    seconds: dict[str, float] = {}
    for name, arguments in steps.items():
        _, seconds[name] = run(*arguments)
    scored, seconds["evaluate"] = run(
        "evaluate", stream, "--data", photos, "--loss", "bernoulli:0.2", "--seeds", *seeds, "--contiguous",
        "--views", views, "--lpips-views", "2",
    )  # fmt: skip
    rows = {row["method"]: row for row in scored["rows"]}
    first = FIRST_MEASUREMENTS.get(model, {})
    return {
        "model": model,
        "seconds_of_each_command": seconds,
        "rows": [
            {k: row.get(k) for k in ("method", "psnr", "ssim", "lpips", "seconds", "num_bytes")}
            for row in rows.values()
        ],
        "grow_above_drop_db": round(rows["grow"]["psnr"] - rows["drop"]["psnr"], 3),
        "minus_first_measurements_db": {name: round(rows[name]["psnr"] - value, 3) for name, value in first.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--models", nargs="+", default=list(SCENES))
    parser.add_argument("--seeds", nargs="+", default=["0", "1", "2", "3", "4"])
    parser.add_argument("--views", default="13")
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    result: dict[str, object] = {
        "loss": "bernoulli:0.2 of .pak",
        "seeds": arguments.seeds,
        "goals_db": GOALS,
        "models": [],
    }
    with tempfile.TemporaryDirectory() as folder:
        for model in arguments.models:
            row = journey(model, arguments.data, Path(folder), arguments.seeds, arguments.views)
            result["models"].append(row)  # type: ignore[attr-defined]
            print(json.dumps(row, indent=1), flush=True)
    if arguments.output:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
