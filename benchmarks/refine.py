"""What fitting the context model once more brings: bytes by part, PSNR on test photos, processor seconds; JSON.

    python benchmarks/refine.py NAME=SCENE:PHOTOS ... [--steps 600] [--views 8] [--keep FOLDER]

SCENE is a scene file or a folder of the official HAC++ code. A scene of `splatwire train` must be one of a run with
`--refine 0`, since the trainer refines by itself.
"""

import argparse
import json
import time
from pathlib import Path

from splatwire.codec import decode_stream, encode_scene, side_info_parts
from splatwire.data import Dataset, open_dataset
from splatwire.evaluate.views import spread
from splatwire.importers.hacpp import import_hacpp
from splatwire.metrics import psnr
from splatwire.model import AnchorScene
from splatwire.model.scene_file import load_scene, save_scene
from splatwire.ops.threads import use_single_thread
from splatwire.render import iterate_views
from splatwire.train.config import RefineConfig
from splatwire.train.refine import refine_context


def measure(scene: AnchorScene, photos: Dataset) -> dict:
    """Bytes of the stream and PSNR of what it decodes to."""
    stream = encode_scene(scene)
    pictures = iterate_views(decode_stream(stream).scene, photos.cameras)
    scores = [float(psnr(image[None], photos.image(view)[None])[0]) for view, image in enumerate(pictures)]
    return {
        "num_bytes": stream.num_bytes,
        "psnr": round(sum(scores) / len(scores), 4),
        "side_info": stream.parts()["side_info"],
        "packets": stream.parts()["packet_payloads"],
        "side_info_parts": side_info_parts(stream.side_info, stream.manifest.codec),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="+", help="NAME=SCENE:PHOTOS")
    parser.add_argument("--steps", type=int, default=RefineConfig().steps)
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--keep", type=Path, help="folder for the refined scenes")
    arguments = parser.parse_args()
    use_single_thread()
    results = {}
    for text in arguments.scenes:
        name, _, files = text.partition("=")
        path, _, data = files.partition(":")
        scene = import_hacpp(Path(path)) if Path(path).is_dir() else load_scene(Path(path))
        photos = open_dataset(Path(data), split="test", background=scene.background)
        photos = photos.select(spread(photos.num_views, arguments.views))
        started = time.process_time()
        refined = refine_context(scene, RefineConfig(steps=arguments.steps))
        seconds = round(time.process_time() - started, 1)
        results[name] = {
            "steps": arguments.steps, "views": photos.num_views, "cpu_seconds": seconds,
            "before": measure(scene, photos), "after": measure(refined, photos),
        }  # fmt: skip
        if arguments.keep:
            save_scene(refined, arguments.keep / f"{name}.scene")
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
