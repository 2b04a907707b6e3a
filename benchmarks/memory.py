"""Seconds and peak memory of encoding and decoding 400,000 anchors, each in a fresh process.

    python benchmarks/memory.py [--data ../shared/data] [--output benchmarks/results/memory.json]

The scene is a real one (HAC++'s bonsai) three times over, shifted by a few voxels, cut to 400,000 anchors.
"""

import argparse
import dataclasses
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from figures import publish

NUM_ANCHORS = 400_000
GOAL_MIB = 2048


def enlarged(model_dir: Path):
    import numpy as np

    from splatwire.importers.hacpp import import_hacpp
    from splatwire.model.voxels import voxel_indices, voxel_positions
    from splatwire.scene import Anchors

    scene = import_hacpp(model_dir)
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    copies = [
        voxel_positions(voxels + np.array(s), scene.coding.voxel_size) for s in ((0, 0, 0), (7, 5, 3), (-5, 9, 2))
    ]
    repeat = {f.name: np.concatenate([getattr(scene.anchors, f.name)] * 3) for f in dataclasses.fields(scene.anchors)}
    repeat["positions"] = np.concatenate(copies)
    return dataclasses.replace(scene, anchors=Anchors(**{k: v[:NUM_ANCHORS] for k, v in repeat.items()}))


def work(step: str, model_dir: Path, stream_path: Path) -> dict[str, float]:
    from splatwire.codec import decode_stream, encode_scene
    from splatwire.packets import read_stream, write_stream

    if step == "encode":
        scene = enlarged(model_dir)
        start = time.perf_counter()
        write_stream(encode_scene(scene), stream_path)
    else:
        stream, _ = read_stream(stream_path)
        start = time.perf_counter()
        decode_stream(stream)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"seconds_with_loading_of_kernels": round(seconds, 2), "peak_memory_mib": round(peak)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--output", type=Path)
    parser.add_argument("--step", choices=("encode", "decode"))
    parser.add_argument("--stream", type=Path)
    arguments = parser.parse_args()
    model_dir = arguments.data / "hacpp" / "bonsai_30k"
    if arguments.step:
        print(json.dumps(work(arguments.step, model_dir, arguments.stream)))
        return
    result: dict[str, object] = {"num_anchors": NUM_ANCHORS, "goal_peak_memory_mib": GOAL_MIB}
    with tempfile.TemporaryDirectory() as folder:
        for step in ("encode", "decode"):
            command = [sys.executable, __file__, "--data", str(arguments.data), "--step", step]
            done = subprocess.run(
                [*command, "--stream", f"{folder}/big.swz"], check=True, capture_output=True, text=True
            )
            result[step] = json.loads(done.stdout.splitlines()[-1])
    publish(result, arguments.output)


if __name__ == "__main__":
    main()
