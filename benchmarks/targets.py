"""Encoder with a target against the encoder that keeps all Gaussians: bytes at equal PSNR, time, accuracy, as JSON.

    python benchmarks/targets.py luigi.ply guitar.compressed.ply biker.spz -o targets.json

`fast` encodes at several quality numbers; its bytes are interpolated, logarithm over PSNR. `default` is `--effort
default`, with `--psnr` 40 and 45 and with `--size` at half of the bytes of `fast` at its default quality. PSNR is the
mean of 15 views that no encoder measures, against renders of the source (`splatwire.evaluation.views`). Times are
processor seconds of one thread, the least of `REPEATS`.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from figures import publish

from splatwire.bitstream import SceneStream
from splatwire.codec import encode_scene
from splatwire.codec.gaussians.quality import QUALITY_NUMBERS, quality_of
from splatwire.evaluation.views import held_out_cameras
from splatwire.io import open_scene
from splatwire.ops.threads import use_single_thread
from splatwire.rate_control import EncodedScene, Target, encode_controlled
from splatwire.rate_control.encoding import Effort, decoded_finest
from splatwire.rate_control.views import SourcePictures
from splatwire.types import SplatScene

QUALITIES = (10.0, 30.0, 40.0, 50.0, 60.0, 70.0)
"""Quality numbers of `fast`."""
PSNRS = (40.0, 45.0)
REPEATS = 2


def encode(some: SplatScene, classes: np.ndarray, quality: object) -> SceneStream:
    return encode_scene(some, class_offsets=classes, quality=quality, threads=1)


def controlled(scene: SplatScene, target: Target, effort: Effort) -> tuple[EncodedScene, float]:
    """Stream with a target, and the processor time."""
    started = time.process_time()
    found = encode_controlled(scene, target, encode, effort=effort)
    return found, time.process_time() - started


def bytes_at(curve: list[dict], psnr: float) -> float | None:
    """Bytes of `fast` at a PSNR, interpolated as logarithms; None outside of the measured range."""
    rows = sorted(curve, key=lambda row: row["psnr"])
    values = [row["psnr"] for row in rows]
    if not values[0] <= psnr <= values[-1]:
        return None
    return float(np.exp(np.interp(psnr, values, np.log([row["bytes"] for row in rows]))))


def measure_scene(path: Path) -> dict:
    scene = open_scene(path)
    assert isinstance(scene, SplatScene)
    pictures = SourcePictures(scene, held_out_cameras(scene))
    curve, seconds = [], {}

    def row(found: EncodedScene, **more: object) -> dict:
        psnr = pictures.mean_psnr(decoded_finest(found.stream))
        size = found.stream.num_bytes
        return {"bytes": size, "psnr": psnr, "kept": found.kept, "level": found.quality.level, **more}

    for number in QUALITIES:
        found, used = controlled(scene, Target(quality=quality_of(number)), "fast")
        curve.append(row(found, quality=number))
        if number == QUALITY_NUMBERS["default"]:
            default = found.stream.num_bytes
    target = Target(quality=quality_of("default"))
    for effort in ("fast", "default"):
        times = [controlled(scene, target, effort) for _ in range(REPEATS)]
        seconds[effort] = min(used for _, used in times)
        found = times[0][0]
    rows = [row(found, asked="default")]
    for psnr in PSNRS:
        found, used = controlled(scene, Target(psnr=psnr), "default")
        rows.append(row(found, asked=f"{psnr:g} dB", seconds=used))
    found, used = controlled(scene, Target(size=default // 2), "default")
    rows.append(row(found, asked=f"{default // 2} bytes", seconds=used))
    for each in rows:
        at = bytes_at(curve, each["psnr"])
        each["share_of_fast_at_equal_psnr"] = None if at is None else each["bytes"] / at
    return {
        "gaussians": scene.num_elements, "degree": scene.splats.degree, "fast": curve, "default": rows,
        "seconds": seconds, "times_of_fast": seconds["default"] / seconds["fast"],
        "psnr_off": max(abs(each["psnr"] - psnr) for each, psnr in zip(rows[1:], PSNRS, strict=False)),
        "size_share": rows[-1]["bytes"] / (default // 2),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    use_single_thread()
    scenes = {}
    for path in args.files:
        scenes[path.name] = measure_scene(path)
        publish({"scenes": scenes}, args.output)


if __name__ == "__main__":
    main()
