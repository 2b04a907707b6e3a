"""Draws the official decoded anchors and prints, as JSON, the PSNR and the time of the pictures.

Goals: at least 55 dB against every official render; under 0.5 s for a view of 400x266, heads and rasteriser, after
warm-up. Times are the best of the repeats.

    python benchmarks/render.py [--data DIR] [--repeats 5] [--all-views]
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch
from PIL import Image

from splatwire.anchors.compiled_heads import drawn_gaussians
from splatwire.metrics import psnr, psnr_by_channel, ssim
from splatwire.neural.importers.hacpp import import_hacpp
from splatwire.neural.render.differentiable import render_differentiable
from splatwire.ops.threads import allowed_threads
from splatwire.render import iterate_views, render_scene
from splatwire.render.cpu import render_cpu
from splatwire.types import Cameras, Gaussians

MODELS = {"bonsai_30k": "bonsai", "snowmiku_15k": "snowmiku", "snowmiku_small_2400": "snowmiku_small"}
GOAL_DB, GOAL_S = 55.0, 0.5


def read_cameras(model_dir: Path) -> Cameras:
    entries = json.loads((model_dir / "cameras.json").read_text())["cameras"]
    poses = np.array([e["w2c"] for e in entries], np.float32)
    Ks = np.array([e["K"] for e in entries], np.float32)
    return Cameras(poses, Ks, entries[0]["width"], entries[0]["height"], tuple(e["name"] for e in entries))


def read_image(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"), np.float32)[None] / 255


def milliseconds(work: Callable[[], Any], repeats: int) -> float:
    work()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return round(1000 * min(seconds), 2)


def likeness(scene: Any, cameras: Cameras, model_dir: Path) -> dict[str, Any]:
    """PSNR of rendered pictures against the official ones, as floats and rounded to 8 bits."""
    views = {}
    for file in sorted((model_dir / "renders").glob("*_after.png")):
        name = file.name.removesuffix("_after.png")
        ours, theirs = render_scene(scene, cameras.select([cameras.names.index(name)])), read_image(file)
        rounded = (ours * 255).round() / 255
        views[name] = {"db": round(psnr(ours, theirs).item(), 2), "db_8bit": round(psnr(rounded, theirs).item(), 2)}
    worst = min(v["db"] for v in views.values())
    return {"views": views, "worst_db": worst, "goal_db": GOAL_DB, "reached": worst >= GOAL_DB}


def photo_scores(scene: Any, cameras: Cameras, model_dir: Path, photos: Path) -> dict[str, Any]:
    """Mean scores over the test views with the official ones, and the largest difference on any view."""
    official = {s["name"]: s for s in json.loads((model_dir / "metrics.json").read_text())["test_after"]}
    names = sorted(official)
    chosen = cameras.select([cameras.names.index(n) for n in names])
    rows = []
    for name, image in zip(names, iterate_views(scene, chosen), strict=True):
        photo = read_image(photos / f"{name}.jpg")
        scores = (psnr(image[None], photo), psnr_by_channel(image[None], photo), ssim(image[None], photo))
        rows.append([s.item() for s in scores])
    psnr_mean, by_channel, ssim_mean = np.mean(rows, axis=0).tolist()
    theirs = np.array([[official[n]["psnr"], official[n]["ssim"]] for n in names])
    return {
        "views": len(names),
        "psnr": round(psnr_mean, 4),
        "psnr_by_channel": round(by_channel, 4),
        "official_psnr_by_channel": round(float(theirs[:, 0].mean()), 4),
        "largest_psnr_difference": float(np.abs(np.array(rows)[:, 1] - theirs[:, 0]).max()),
        "ssim": round(ssim_mean, 5),
        "official_ssim": round(float(theirs[:, 1].mean()), 5),
        "largest_ssim_difference": float(np.abs(np.array(rows)[:, 2] - theirs[:, 1]).max()),
    }


def timings(scene: Any, cameras: Cameras, repeats: int) -> dict[str, Any]:
    """Milliseconds of one view: heads, rasteriser, and the rasteriser with gradients."""
    one = cameras.select([0])
    gaussians = drawn_gaussians(scene, one, 0)
    black = np.zeros(3, np.float32)
    fields = (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors)
    leaves = [torch.from_numpy(field).requires_grad_() for field in fields]

    def step() -> None:
        render_differentiable(Gaussians(*leaves), one, background=torch.zeros(3)).sum().backward()

    with torch.no_grad():
        heads = milliseconds(lambda: drawn_gaussians(scene, one, 0), repeats)
        draw = milliseconds(lambda: render_cpu(gaussians, one, background=black), repeats)
        whole = milliseconds(lambda: render_scene(scene, one), repeats)
    return {
        "size": f"{cameras.width}x{cameras.height}",
        "gaussians": gaussians.num_gaussians,
        "heads_ms": heads,
        "raster_ms": draw,
        "view_ms": whole,
        "raster_with_gradients_ms": milliseconds(step, repeats),
    }


def kernel_times() -> dict[str, float]:
    """Nanoseconds per pixel of the two inner loops on whole tiles, everything in cache."""
    from splatwire.render import _cpu_gradients, _cpu_kernels

    row = np.zeros(_cpu_gradients.SUMS, np.float32)
    kernels = {"forward": (_cpu_kernels._blend, ()), "backward": (_cpu_gradients._blend_back, (row, 0))}
    return {f"{name}_ns_per_pixel": nanoseconds_per_pixel(*kernel) for name, kernel in kernels.items()}


def nanoseconds_per_pixel(kernel: Any, extra: tuple[Any, ...]) -> float:
    from splatwire.render._cpu_kernels import TILE, new_buffer

    @numba.njit
    def loop(buf, x, y, a, b, c, log_opacity, red, green, blue, *rest):  # type: ignore[no-untyped-def]
        for _ in range(20_000):
            kernel(buf, 0, TILE, x, y, a, b, c, log_opacity, red, green, blue, *rest)

    numbers = [np.float32(v) for v in (8.0, 8.0, -0.01, 0.001, -0.01, -7.0, 0.5, 0.5, 0.5)]
    arguments = (new_buffer(TILE, TILE), *numbers, *extra)
    return round(milliseconds(lambda: loop(*arguments), 5) * 1e6 / (20_000 * TILE * TILE), 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("SPLATWIRE_DATA", default)))
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--all-views", action="store_true", help="score every test view against its photo, too")
    arguments = parser.parse_args()
    report: dict[str, Any] = {"threads": allowed_threads(), "kernels": kernel_times(), "models": {}}
    for model, photos in MODELS.items():
        model_dir = arguments.data / "hacpp" / model
        scene, cameras = import_hacpp(model_dir), read_cameras(model_dir)
        entry = {"official": likeness(scene, cameras, model_dir), "time": timings(scene, cameras, arguments.repeats)}
        if model == "bonsai_30k":
            small = timings(scene, cameras.scaled(0.5), arguments.repeats)
            entry["time_400x266"] = {**small, "goal_ms": 1000 * GOAL_S, "reached": small["view_ms"] < 1000 * GOAL_S}
        if arguments.all_views:
            folder = arguments.data / "scenes" / photos / "images"
            entry["photos"] = photo_scores(scene, cameras, model_dir, folder)
        report["models"][model] = entry
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
