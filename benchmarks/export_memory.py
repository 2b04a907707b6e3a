"""Seconds and peak memory of `splatwire export ply` and `export splat`, each in a fresh process.

    python benchmarks/export_memory.py [--data ../shared/data] [--output benchmarks/results/export_memory.json]

Scenes are the bundled one and, with --data, HAC++'s bonsai (175,556 anchors), each with the cameras that come with it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from figures import publish

ASSETS = Path(__file__).resolve().parent.parent / "src" / "splatwire" / "assets"
GOAL_MIB = 4096
_MEASURED = """
import resource, sys
from splatwire.cli.main import main

try:
    main(sys.argv[1:])
finally:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)
"""


def export(kind: str, scene: Path, cameras: Path, folder: Path) -> dict[str, object]:
    words = ["export", kind, scene, "-o", folder / f"out.{kind}", "--cameras", cameras, "--json"]
    start = time.perf_counter()
    command = [sys.executable, "-c", _MEASURED, *map(str, words)]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    told = json.loads(done.stdout)
    return {
        "peak_memory_mib": round(int(done.stderr.splitlines()[-1]) / 1024),
        "seconds": round(time.perf_counter() - start, 1),
        "num_gaussians": told["num_gaussians"],
        "num_bytes": told["num_bytes"],
        "num_views": told["measured"]["num_views"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    result: dict[str, object] = {"goal_peak_memory_mib": GOAL_MIB}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scenes = {"bundled": (ASSETS / "snowmiku.swz", ASSETS / "snowmiku_cameras.json")}
        if arguments.data:
            model = arguments.data / "hacpp" / "bonsai_30k"
            words = ["import", "hacpp", str(model), "-o", str(folder / "bonsai.scene")]
            subprocess.run([sys.executable, "-m", "splatwire", *words], check=True)
            scenes["bonsai_30k"] = (folder / "bonsai.scene", model / "cameras.json")
        for scene, (source, cameras) in scenes.items():
            result[scene] = {kind: export(kind, source, cameras, folder) for kind in ("ply", "splat")}
    publish(result, arguments.output)


if __name__ == "__main__":
    main()
