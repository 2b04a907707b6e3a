"""Processor time of decoding explicit Gaussians in node and in Python, against SPZ and SOG, or an older checkout.

    python benchmarks/decode_speed.py biker.spz playbot_125k.sog [--old CHECKOUT] [--runs 3] [-o decode_speed.json]

Each file is encoded with `splatwire encode`. Every run is a separate process, and the kinds of runs alternate.
Figures are medians, in microseconds a Gaussian. `node` includes the start of node and the check of the digest;
`node_call` is the same without the start, and `node_plain` does without WebAssembly. `python` is one thread, after
kernels are loaded; `spz` and `sog` are the readers of `splatwire.io.formats` for the same scene in these formats. Node
runs without `NODE_EXTRA_CA_CERTS`, because reading certificates at its start takes longer than the start itself. With
`--old`, the same runs of another checkout of the project, which needs `web/node_modules`, alternate with these.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from figures import publish

from splatwire.io.formats import read_splats, write_splats

HERE = Path(__file__).parents[1]
NODE = """
import { readFileSync } from "node:fs";
const { decode } = await import(process.argv[2]);
const file = new Uint8Array(readFileSync(process.argv[3])), begin = process.argv[4] && process.cpuUsage();
const { gaussians, verified } = await decode(file);
if (!verified) throw new Error("the digest differs");
const { user, system } = process.cpuUsage(begin);
console.log((user + system) / gaussians.count);
"""
PYTHON = """
import sys, time
from splatwire.bitstream import read_stream
from splatwire.codec import decode_stream
stream = read_stream(sys.argv[1])[0]
decode_stream(stream, threads=1)
started = time.process_time()
decode_stream(stream, threads=1)
print((time.process_time() - started) / stream.manifest.num_elements * 1e6)
"""
READER = """
import sys, time
from splatwire.io.formats import read_splats
from splatwire.ops.threads import use_single_thread
use_single_thread()
read_splats(sys.argv[1])
started = time.process_time()
splats = read_splats(sys.argv[1])
print((time.process_time() - started) / splats.num_gaussians * 1e6)
"""


def bundled(checkout: Path, folder: Path) -> Path:
    """Bundles the decoder of a checkout for node and returns the module's path."""
    module = folder / "decoder.mjs"
    subprocess.run(
        [checkout / "web/node_modules/.bin/esbuild", "src/decoder.ts", "--bundle", "--platform=node", "--format=esm",
         f"--outfile={module}", "--log-level=error"],
        cwd=checkout / "web", check=True,
    )  # fmt: skip
    return module


def figure(command: list[str | Path], checkout: Path) -> float:
    """Runs a command that prints one number, with the Python package of a checkout."""
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
    environment.pop("NODE_EXTRA_CA_CERTS", None)
    return float(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)


def measure(path: Path, checkouts: dict[str, Path], runs: int, folder: Path) -> dict:
    """Median processor time per Gaussian of a scene, by kind of run, microseconds."""
    splats = read_splats(path)
    files = {kind: folder / f"scene.{kind}" for kind in ("swz", "spz", "sog")}
    subprocess.run(["splatwire", "encode", path, "-o", files["swz"]], check=True, capture_output=True)
    for kind in ("spz", "sog"):
        write_splats([splats], files[kind])
    script = folder / "decode.mjs"
    script.write_text(NODE)
    commands: dict[str, tuple[list[str | Path], Path]] = {}
    for name, checkout in checkouts.items():
        module = bundled(checkout, Path(tempfile.mkdtemp(dir=folder)))
        commands[f"{name}node"] = ["node", script, module, files["swz"]], checkout
        commands[f"{name}node_call"] = ["node", script, module, files["swz"], "call"], checkout
        if not name:
            commands["node_plain"] = ["node", "--no-expose-wasm", script, module, files["swz"]], checkout
        commands[f"{name}python"] = [sys.executable, "-c", PYTHON, files["swz"]], checkout
    for kind in ("spz", "sog"):
        commands[kind] = [sys.executable, "-c", READER, files[kind]], HERE
    found: dict[str, list[float]] = {kind: [] for kind in commands}
    for _ in range(runs):
        for kind, command in commands.items():
            found[kind].append(figure(*command))
    return {
        "scene": path.name, "gaussians": splats.num_gaussians, "degree": splats.degree,
        "bytes": {kind: file.stat().st_size for kind, file in files.items()},
        "us_per_gaussian": {kind: statistics.median(values) for kind, values in found.items()},
    }  # fmt: skip


def main() -> None:
    """Measures all given files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--old", type=Path, help="another checkout of the project, for comparison")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    checkouts = {"": HERE} | ({"old_": args.old.resolve()} if args.old else {})
    with tempfile.TemporaryDirectory() as folder:
        publish([measure(path, checkouts, args.runs, Path(folder)) for path in args.files], args.output)


if __name__ == "__main__":
    main()
