"""Scenes with levels: bytes of each, the first picture, what `coarse` gains, and the time and memory of encoding.

    python benchmarks/levels.py $SPLATWIRE_DATA/splats/{biker.spz,playbot_125k.sog} --loss 0.05 0.2 0.5 > levels.json

Pictures are compared with those of the file, from views around the scene (`surrounding_cameras`).
"""

import argparse
import json
import resource
import time
from collections.abc import Callable
from dataclasses import replace

import torch

from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal
from splatwire.levels import encode_levels, tiles_of
from splatwire.metrics import psnr
from splatwire.model import RenderHints
from splatwire.model.appearance import Scene
from splatwire.model.level_scene import Levels
from splatwire.packets import SceneStream
from splatwire.render import render_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import classes_of
from splatwire.scene_io import open_scene

VIEWS = 6
SEEDS = (0, 1)


def measured(path: str, rates: list[float]) -> dict[str, object]:
    """All figures of a scene."""
    scene = open_scene(path)
    scene = scene.select(scene.drawable)
    cameras, classes = surrounding_cameras(scene, VIEWS), classes_of(scene, None)
    truth = render_scene(scene, cameras)
    began = time.perf_counter()
    plain = encode_scene(scene, classes=classes)
    plain_seconds, began = time.perf_counter() - began, time.perf_counter()
    stream = encode_levels(scene, classes=classes)
    seconds = time.perf_counter() - began
    tiles, partial = tiles_of(stream), decode_stream(stream)
    level_of = partial[Levels].of

    def quality(shown: Scene) -> float:
        return round(float(psnr(render_scene(shown, cameras), truth).mean()), 2)

    levels = []
    for level in range(int(tiles.levels.max()) + 1):
        hints = RenderHints(torch.ones(len(level_of)), level_of != level)
        here = tiles.levels == level
        facts = {"tiles": int(here.sum()), "gaussians": int(tiles.counts[here].sum())}
        facts |= {"bytes": int(tiles.sizes[here].sum()), "error": float(tiles.errors[here].mean())}
        levels.append(facts | {"psnr": quality(replace(partial.scene, hints=hints))})
    finest = levels[0]["bytes"]
    return {
        "scene": path.rsplit("/", 1)[-1],
        "gaussians": scene.num_elements,
        "plain_bytes": plain.num_bytes,
        "plain_psnr": quality(conceal(decode_stream(plain), "drop")),
        "bytes": stream.num_bytes,
        "side_info_bytes": len(stream.side_info),
        "overhead": round(sum(level["bytes"] for level in levels[1:]) / finest, 4),
        "levels": levels,
        "loss": {str(rate): lossy(stream, rate, quality) for rate in rates},
        "plain_seconds": round(plain_seconds, 2),
        "seconds": round(seconds, 2),
        "microseconds_a_gaussian": round(1e6 * seconds / scene.num_elements, 2),
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10,
    }


def lossy(stream: SceneStream, rate: float, quality: Callable[[Scene], float]) -> dict[str, float]:
    """PSNR of each concealer, mean over seeds; packets of coarser levels, which are protected, are not lost."""
    first, found = stream.manifest.plan.spans[-1].first_block, {}
    for name in ("drop", "grow", "scene_free", "coarse"):
        values = []
        for seed in SEEDS:
            received, _ = transmit(stream, parse_loss(f"bernoulli:{rate}"), seed=seed)
            there = {packet.id for packet in received.packets}
            kept = [packet for packet in stream.packets if packet.id.block < first or packet.id in there]
            values.append(quality(conceal(decode_stream(stream.with_packets(kept)), name)))
        found[name] = round(sum(values) / len(values), 2)
    return found


def main() -> None:
    """Prints one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", help="files of explicit Gaussians")
    parser.add_argument("--loss", nargs="*", type=float, default=[], help="shares of packets that are lost")
    given = parser.parse_args()
    print(json.dumps([measured(path, given.loss) for path in given.scenes], indent=1))


if __name__ == "__main__":
    main()
