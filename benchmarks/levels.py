"""Scenes with levels: bytes of each, the first picture, the gain of `coarse`, and encoding time and memory.

    python benchmarks/levels.py $SPLATWIRE_DATA/splats/{biker.spz,playbot_125k.sog} --loss 0.05 0.2 0.5 > levels.json
    python benchmarks/levels.py $SPLATWIRE_DATA/splats/{biker.spz,guitar.compressed.ply} --sog > levels_sog.json

Pictures are compared with those of the file, from views around the scene (`surrounding_cameras`).

With `--sog`, all levels are compared with streamed SOG of three levels, each a quarter of the finer one (see
`walks.py`): the fewest bytes of `DIALS` with a finest level of at least SOG's PSNR. Harmonics above degree 0 are left
out of both: writing SOG clusters them for minutes.
"""

import argparse
import json
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from walks import joined, streamed_sog

from splatwire.bitstream import SceneStream
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.concealment import conceal
from splatwire.io import open_scene
from splatwire.io.formats import read_splats
from splatwire.lod import encode_levels, tiles_of
from splatwire.metrics import psnr
from splatwire.render import render_scene
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.types import RenderHints, SplatScene
from splatwire.types.lod_scene import Levels
from splatwire.types.scene import Scene

VIEWS = 6
SEEDS = (0, 1)
DIALS = ((7.0, 6), (7.5, 6), (8.0, 6), (8.5, 6), (9.0, 6), (9.0, 4), (9.5, 6), (9.5, 3), (10.0, 3))
"""Qualities that are tried, level and classes."""


def measured(path: str, rates: list[float]) -> dict[str, object]:
    """Measures a scene."""
    scene = open_scene(path)
    scene = scene.select(scene.drawable)
    cameras, classes = surrounding_cameras(scene, VIEWS), scene_class_offsets(scene, None)
    truth = render_scene(scene, cameras)
    began = time.perf_counter()
    plain = encode_scene(scene, class_offsets=classes)
    plain_seconds, began = time.perf_counter() - began, time.perf_counter()
    stream = encode_levels(scene, class_offsets=classes)
    seconds = time.perf_counter() - began
    tiles, received = tiles_of(stream), decode_stream(stream)
    level_of = received[Levels].lod_level

    def quality(shown: Scene) -> float:
        return round(float(psnr(render_scene(shown, cameras), truth).mean()), 2)

    levels = []
    for level in range(int(tiles.levels.max()) + 1):
        hints = RenderHints(np.ones(len(level_of), np.float32), level_of != level)
        here = tiles.levels == level
        facts = {"tiles": int(here.sum()), "gaussians": int(tiles.counts[here].sum())}
        facts |= {"bytes": int(tiles.sizes[here].sum()), "error": float(tiles.errors[here].mean())}
        levels.append(facts | {"psnr": quality(replace(received.scene, hints=hints))})
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
    """PSNR of each concealer, mean over seeds; packets of coarser levels are protected and never lost."""
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


def against_sog(path: str) -> dict[str, object]:
    """Compares the bytes of all levels with streamed SOG at equal or higher PSNR of the finest level."""
    flat = SplatScene(read_splats(Path(path)).at_most_degree(0))
    cameras, classes = surrounding_cameras(flat, VIEWS), scene_class_offsets(flat, None)
    truth = render_scene(flat, cameras)
    sog = streamed_sog(flat.splats)

    def quality(shown: SplatScene) -> float:
        return float(psnr(render_scene(shown, cameras), truth).mean())

    wanted = quality(SplatScene(joined(sog.leaves[0])))
    found = []
    for level, count in DIALS:
        stream = encode_levels(flat, class_offsets=classes, quality=Quality(level, classes=count))
        shown = decode_stream(stream).scene
        found.append({"level": level, "classes": count, "bytes": stream.num_bytes, "psnr": quality(shown)})
    enough = min((one for one in found if one["psnr"] >= wanted), key=lambda one: one["bytes"], default=None)
    return {
        "scene": path.rsplit("/", 1)[-1], "gaussians": flat.num_elements, "sog_bytes": sum(sog.sizes),
        "sog_psnr": wanted, "dials": found, "ours": enough,
        "share": None if enough is None else enough["bytes"] / sum(sog.sizes),
    }  # fmt: skip


def main() -> None:
    """Prints one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", help="files of explicit Gaussians")
    parser.add_argument("--loss", nargs="*", type=float, default=[], help="shares of packets that are lost")
    parser.add_argument("--sog", action="store_true", help="against streamed SOG at equal PSNR instead")
    given = parser.parse_args()
    if given.sog:
        print(json.dumps([against_sog(path) for path in given.scenes], indent=1))
        return
    print(json.dumps([measured(path, given.loss) for path in given.scenes], indent=1))


if __name__ == "__main__":
    main()
