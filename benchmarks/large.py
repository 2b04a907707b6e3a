"""Time and memory of writing a scene of ten million Gaussians and encoding it with levels.

    python benchmarks/large.py $SPLATWIRE_DATA/splats/tandt_truck_opensplat_116k.splat -o out/large > large.json

Copies of the scene fill a square up to the requested number, written as PLY (68 bytes per Gaussian). Memory is the
private memory of `splatwire encode` (`RssAnon` of /proc), sampled ten times per second, and its resident file pages
(`RssFile`), which the system reclaims when memory is short. Linux only.
"""

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatwire.io.formats import read_splats, write_splats
from splatwire.types.splats import Splats


def copies(splats: Splats, count: int) -> Iterator[Splats]:
    """Copies of the scene on the ground, degree 0, up to `count` Gaussians."""
    splats = splats.at_most_degree(0)
    low, high = np.quantile(splats.means, (0.02, 0.98), axis=0)
    number = -(-count // splats.num_gaussians)
    side = math.isqrt(number - 1) + 1
    for copy in range(number):
        x, z = divmod(copy, side)
        shift = np.float32([x * (high - low)[0], 0, z * (high - low)[2]])
        left = count - copy * splats.num_gaussians
        yield replace(splats, means=splats.means + shift).select(np.arange(min(left, splats.num_gaussians)))


def watched(command: list[str]) -> dict[str, float]:
    """Runs a command and measures it."""
    began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    most = {"RssAnon": 0, "RssFile": 0, "VmRSS": 0}
    while process.poll() is None:
        try:
            text = Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")
        except OSError:
            break
        for line in text.splitlines():
            name, _, value = line.partition(":")
            if name in most:
                most[name] = max(most[name], int(value.split()[0]))
        time.sleep(0.1)
    if process.wait():
        sys.exit(f"{command[1]} failed")
    seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seconds": round(seconds, 1), "processor_seconds": round(cpu, 1),
            **{f"{name}_mib": value >> 10 for name, value in most.items()}, "load": os.getloadavg()[0]}  # fmt: skip


def main() -> None:
    """Prints one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", help="file of explicit Gaussians")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for what is written")
    parser.add_argument("--count", type=int, nargs="+", default=[1_000_000, 10_000_000], help="Gaussians")
    parser.add_argument("--runs", type=int, default=1, help="runs of each, of which the fastest counts")
    given = parser.parse_args()
    one = read_splats(Path(given.scene))
    given.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for count in given.count:
        source, stream = given.output / f"{count}.ply", given.output / f"{count}.swz"
        if not source.exists():
            write_splats(copies(one, count), source)
        command = [sys.executable, "-m", "splatwire", "encode", str(source), "-o", str(stream), "--levels", "auto"]
        took = min((watched(command) for _ in range(given.runs)), key=lambda row: row["seconds"])
        each = {"microseconds": took["seconds"], "processor_microseconds": took["processor_seconds"]}
        sizes = {"gaussians": count, "source_bytes": source.stat().st_size, "bytes": stream.stat().st_size}
        rows.append({**sizes, **took, **{f"{name}_a_gaussian": 1e6 * value / count for name, value in each.items()}})
    print(json.dumps({"scene": given.scene.rsplit("/", 1)[-1], "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
