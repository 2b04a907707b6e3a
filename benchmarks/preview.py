"""What previews of some sizes look like: test PSNR of black, of a preview's background, the preview, the scene; JSON.

Fitted to the training photos, judged on the test photos, at most 400 pixels wide.
"""

import argparse
import json
from pathlib import Path

import torch
from threadpoolctl import threadpool_limits

from splatwire.calibrate.preview import PreviewConfig, preview_for_scene
from splatwire.calibrate.views import CalibrationViews
from splatwire.codec import decode_stream
from splatwire.codec.preview import MAX_PREVIEW_BYTES
from splatwire.data import open_dataset
from splatwire.metrics import decibels
from splatwire.packets import read_stream
from splatwire.scene.background import Background

SIZES = (300, 600, MAX_PREVIEW_BYTES)


def views_of(data: Path, split: str, background: Background) -> CalibrationViews:
    return CalibrationViews.of_photos(open_dataset(data, split=split, background=background))


def black_of(views: CalibrationViews) -> float:
    each = [float(decibels(views.photo(v).square().mean())) for v in range(views.cameras.num_views)]
    return sum(each) / len(each)


def rows_of(stream: Path, data: Path, seed: int) -> list[dict]:
    scene = decode_stream(read_stream(stream)[0]).scene
    train, test = (views_of(data, split, scene.background) for split in ("train", "test"))
    rows = []
    for size in SIZES:
        result = preview_for_scene(scene, train, PreviewConfig(num_bytes=size, seed=seed), test=test)
        quality = {name: round(value, 2) for name, value in {"black": black_of(test), **result.psnr}.items()}
        row = {"bytes": len(result.section), "gaussians": result.num_gaussians, "psnr": quality}
        rows.append({**row, "seconds": round(result.seconds, 1)})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+", help="NAME=STREAM:PHOTOS")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    results, names = {}, []
    torch.set_num_threads(1)
    with threadpool_limits(1):
        for text in options.scenes:
            name, _, files = text.partition("=")
            stream, _, data = files.partition(":")
            results[name] = rows_of(Path(stream), Path(data), options.seed)
            names.append(f"{name}={Path(stream).name}:{Path(data).name}")
    command = (
        f"OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 python benchmarks/preview.py {' '.join(names)} --seed {options.seed}"
    )
    print(json.dumps({"command": command, "scenes": results}, indent=1))


if __name__ == "__main__":
    main()
