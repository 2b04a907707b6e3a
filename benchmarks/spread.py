"""Lanes over blocks of 3000 anchors (`paper`) and over the whole scene (`spread`): bytes, and pictures under loss.

A scene is NAME=SCENE,PHOTOS. PSNR of `scene_free` in test views, mean and least over masks of 20 % of `.pak` packets.

    python benchmarks/spread.py lego=lego.scene,data/lego --masks 24 --views 8 -o benchmarks/results/spread.json
"""

import argparse
from pathlib import Path

from figures import publish

from splatwire.channel import draw_mask, parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.conceal import conceal
from splatwire.data import Dataset, open_dataset
from splatwire.model import AnchorScene
from splatwire.model.scene_file import load_scene
from splatwire.packets import packetization_named
from splatwire.train.quality import assess_scene

LOSS = parse_loss("bernoulli:0.2")


def score(scene: AnchorScene, name: str, test: Dataset, options: argparse.Namespace) -> dict[str, float]:
    """Sizes of one packetization's stream, and PSNR under the masks."""
    stream = encode_scene(scene, packetization_named(name, scene.ELEMENTS, int(scene.drawable.sum())))
    found, lost = [], 0.0
    for seed in range(options.masks):
        received = decode_stream(draw_mask(stream, LOSS, seed=seed).apply(stream))
        lost += 1 - float(received.erasures.known.float().mean())
        found.append(assess_scene(conceal(received, "scene_free"), test, options.views, 0).psnr)
    return {
        "bytes": stream.num_bytes, "packets": len(stream.packets), "lost": round(lost / options.masks, 4),
        "mean": round(sum(found) / len(found), 3), "least": round(min(found), 3),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", metavar="NAME=SCENE,PHOTOS")
    parser.add_argument("--masks", type=int, default=24)
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    result: dict[str, object] = {"masks": options.masks, "views": options.views}
    for text in options.scenes:
        label, _, paths = text.partition("=")
        source, photos = paths.split(",")
        scene = load_scene(Path(source))
        test = open_dataset(Path(photos), split="test", background=scene.background)
        result[label] = {name: score(scene, name, test, options) for name in ("paper", "spread")}
    publish(result, options.output)


if __name__ == "__main__":
    main()
