"""Clips: bytes against coding frame by frame at equal PSNR, and the damage of losses by concealer.

    python benchmarks/clips.py monkey=FRAMES/ guitar=FRAMES/ [--losses bernoulli:0.2] [--seeds 1 2] [--views 2]
    python benchmarks/clips.py guitar=FRAMES/ --quality 7.25 --losses
    python benchmarks/clips.py guitar=FRAMES/ --picture docs/images/clip.webp

`bent_clip.py` makes clips with known true motion. Frame by frame means every tenth frame (in short clips every frame)
as a still scene in two qualities. Bytes at the clip's PSNR are interpolated between them, in decibels and logarithms of
bytes.
"""

import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
from PIL import Image

from splatwire.bitstream import packetization_named
from splatwire.channel import parse_loss
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.quality import QUALITIES, Quality, quality_of
from splatwire.evaluation.pixels import to_pixels
from splatwire.evaluation.sequence.evaluation import SequenceRow, frame_psnr, score_sequence
from splatwire.evaluation.sequence.report import score_rows
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.sequence import Frame, SequenceOptions, encode_sequence, frame_files, read_frames
from splatwire.types import Cameras, SplatScene

CONCEALERS = ("drop", "hold", "neighbors", "motion")
EVERY = 10
PICTURE = 256
"""Pixels of a panel."""


def drawn(frame: Frame) -> SplatScene:
    """Visible Gaussians of a frame."""
    return SplatScene(frame.splats.select(frame.drawn))


def pictures(scene: SplatScene, cameras: Cameras) -> np.ndarray:
    """All views."""
    return np.stack(list(iterate_views(scene, cameras)))


def frame_by_frame(files: list[Path], cameras: Cameras) -> list[tuple[float, float]]:
    """Mean PSNR and bytes of a frame as a still scene, by quality."""
    found, some = [], files[::EVERY] if len(files) > EVERY else files
    for quality in ("small", "default"):
        points = []
        for frame in read_frames(some):
            scene = drawn(frame)
            packets = packetization_named("datagram", "gaussians", scene.num_elements)
            stream = encode_scene(
                scene, packets, quality=quality, class_offsets=scene_class_offsets(scene, None, recompute=True)
            )
            shown = pictures(decode_stream(stream).scene, cameras)
            points.append((frame_psnr(shown, pictures(scene, cameras)), stream.num_bytes))
        found.append(tuple(np.mean(points, axis=0).tolist()))
    return found


def bytes_at(points: list[tuple[float, float]], decibels: float) -> float:
    """Bytes of a frame at a PSNR, interpolated between two qualities."""
    (low, few), (high, many) = points
    share = (decibels - low) / (high - low)
    return math.exp(math.log(few) + share * (math.log(many) - math.log(few)))


def measure(name: str, folder: Path, arguments: argparse.Namespace) -> dict:
    """Measures one clip."""
    files, began = frame_files(folder), time.perf_counter()
    stream, tracking = encode_sequence(read_frames(files), SequenceOptions(quality=arguments.quality))
    seconds = time.perf_counter() - began
    cameras = surrounding_cameras(drawn(next(read_frames(files[:1]))), arguments.views, 320)
    rows = [SequenceRow("motion")] + [
        SequenceRow(concealer, parse_loss(loss, "datagram"), seed, loss)
        for loss in arguments.losses for concealer in arguments.concealers for seed in arguments.seeds
    ]  # fmt: skip
    scores = score_sequence(stream, read_frames(files), cameras, rows)
    decibels, tracks = float(scores[0].psnr.mean()), sum(tier.num_elements for tier in stream.manifest.tiers[::2])
    still = frame_by_frame(files, cameras)
    gaussians = sum(int(frame.drawn.sum()) for frame in read_frames(files))
    return {
        "name": name, "frames": len(files), "tracks": tracks, "matched": tracking.num_matched_frames,
        "share": tracking.matched_share,
        "bytes": stream.num_bytes, "bytes_per_gaussian_and_frame": stream.num_bytes / gaussians, "psnr": decibels,
        "quality": arguments.quality.level, "frame_by_frame": still,
        "ratio": stream.num_bytes / (len(files) * bytes_at(still, decibels)),
        "encoding_seconds": seconds,
        "rows": [{k: v for k, v in row.items() if k != "frames"} for row in score_rows(scores)],
    }  # fmt: skip


def quality(word: str) -> Quality:
    """Parses a command-line argument."""
    return quality_of(word) if word in QUALITIES else Quality(float(word))


def draw(folder: Path, target: Path) -> None:
    """Animation of a clip at 20 % loss: tracks with lost motion omitted, held, concealed."""
    files = frame_files(folder)
    stream, _ = encode_sequence(read_frames(files))
    cameras = surrounding_cameras(drawn(next(read_frames(files[:1]))), 1, PICTURE)
    rows = [
        SequenceRow(concealer, parse_loss("bernoulli:0.2", "datagram"), 1) for concealer in ("drop", "hold", "motion")
    ]
    panels: dict[int, list[np.ndarray]] = {}
    score_sequence(
        stream, read_frames(files), cameras, rows,
        on_picture=lambda row, frame, image: panels.setdefault(frame, []).append(to_pixels(image)),
    )  # fmt: skip
    images = [Image.fromarray(np.concatenate(panels[frame][1:], axis=1)) for frame in sorted(panels)]
    images[0].save(target, "WEBP", save_all=True, append_images=images[1:], duration=66, loop=0, quality=55, method=6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", help="NAME=FOLDER")
    parser.add_argument("--losses", nargs="*", default=["bernoulli:0.05", "bernoulli:0.2", "gilbert:0.1,20"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--concealers", nargs="+", choices=CONCEALERS, default=CONCEALERS)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--quality", type=quality, default="default", help="name, or level of a `Quality`")
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    named = [clip.partition("=")[::2] for clip in arguments.clips]
    if arguments.picture:
        draw(Path(named[0][1]), arguments.picture)
        return
    print(json.dumps([measure(name, Path(folder), arguments) for name, folder in named], indent=1))


if __name__ == "__main__":
    main()
