"""Bytes at a PSNR with and without fine-tuning, and the quality at 20 % lost datagrams, as JSON.

    python benchmarks/fine_tuning.py guitar.compressed.ply luigi.ply --psnr 40 -o fine_tuning.json
    python benchmarks/fine_tuning.py guitar.compressed.ply --psnr 40 --loss bernoulli:0.2 -o fine_tuning_loss.json

Pictures are compared with the file's own in `held_out_cameras`, 15 views that nothing else uses. Bytes at a PSNR are
interpolated (logarithm of bytes against PSNR) between streams of several levels of quantisation: of the whole scene,
and of the fine-tuned one, which is fine-tuned once and then encoded at levels around its own. Seconds are processor
time of all threads.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from figures import publish

from splatwire.bitstream import PRESETS, SceneStream
from splatwire.channel import parse_loss, transmit
from splatwire.cli._calibration import with_quick_sketch
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.quality import Quality
from splatwire.concealment import conceal
from splatwire.evaluation.views import held_out_cameras
from splatwire.finetuning import FineTuning, fitting_cameras, own_pictures, prune_and_tune
from splatwire.io import open_scene
from splatwire.metrics import psnr
from splatwire.render import iterate_views
from splatwire.render.precision import precision_classes
from splatwire.types import SplatScene

BASE_LEVELS, OFFSETS = (5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0), (-1.0, -0.5, 0.0, 0.5, 1.0)
LOSSES = 4


class Held:
    """Pictures of a scene in the held-out views."""

    def __init__(self, scene: SplatScene) -> None:
        self.cameras = held_out_cameras(scene)
        self.images = list(iterate_views(scene, self.cameras))

    def psnr(self, scene: SplatScene) -> float:
        """Mean PSNR of the views, decibels."""
        pairs = zip(iterate_views(scene, self.cameras), self.images, strict=True)
        return float(np.mean([float(psnr(a[None], b[None])[0]) for a, b in pairs]))

    def point(self, stream: SceneStream) -> tuple[int, float]:
        """Bytes and PSNR of a stream."""
        return stream.num_bytes, self.psnr(decode_stream(stream).scene)


def bytes_at(points: list[tuple[int, float]], wanted: float) -> float:
    """Bytes at a PSNR; not a number outside of the measured range."""
    sizes, quality = zip(*sorted(points, key=lambda p: p[1]), strict=True)
    return float(np.exp(np.interp(wanted, quality, np.log(sizes), np.nan, np.nan)))


def lossy(stream: SceneStream, held: Held) -> dict[str, float]:
    """PSNR by concealer at 20 % lost datagrams, mean of `LOSSES` seeds."""
    found: dict[str, list[float]] = {"drop": [], "grow": [], "sketch": []}
    for seed in range(LOSSES):
        received, _ = transmit(stream, parse_loss("bernoulli:0.2", "datagram"), seed=seed)
        partial = decode_stream(received)
        for name, values in found.items():
            values.append(held.psnr(conceal(partial, name)))
    return {name: float(np.mean(values)) for name, values in found.items()}


def measured(path: Path, options: argparse.Namespace) -> dict[str, object]:
    """Results of one file."""
    source = open_scene(path)
    if not isinstance(source, SplatScene):
        raise SystemExit(f"{path} holds no explicit Gaussians")
    source = source.select(np.flatnonzero(source.drawable))
    held, classes = Held(source), precision_classes(source.splats)
    base = [held.point(encode_scene(source, quality=Quality(level), classes=classes)) for level in BASE_LEVELS]
    started = time.process_time()
    pictures = own_pictures(source, fitting_cameras(source))
    preset = "datagram" if options.loss else "paper"
    loss = parse_loss(options.loss, "datagram") if options.loss else None
    tuning = FineTuning(
        Quality(options.level), options.iterations, loss=loss, packetization=PRESETS[preset], seed=options.seed
    )
    tuned = prune_and_tune(source, pictures, tuning, psnr=options.psnr)
    seconds = time.process_time() - started
    assert tuned.coding is not None
    own = (tuned.coding.classes.astype(int) - int(tuned.coding.classes.max())).astype(np.int8)
    points = []
    for offset in OFFSETS:
        quality = Quality(options.level + offset)
        stream = (
            encode_scene(replace(tuned, coding=None), quality=quality, classes=own) if offset else encode_scene(tuned)
        )
        points.append(held.point(stream))
    before, after = bytes_at(base, options.psnr), bytes_at(points, options.psnr)
    result: dict[str, object] = {
        "gaussians": source.num_elements, "degree": source.splats.degree,
        "kept": tuned.num_elements / source.num_elements, "level": options.level,
        "iterations": options.iterations, "seconds": seconds, "base": base, "tuned": points,
        "bytes_before": before, "bytes_after": after, "ratio": after / before,
    }  # fmt: skip
    if options.loss:
        stream = with_quick_sketch(encode_scene(tuned, "datagram"), None, lambda task, share: None)
        result["lossy"] = {"complete": held.psnr(tuned), **lossy(stream, held)}
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--psnr", type=float, default=40.0)
    parser.add_argument("--level", type=float, default=7.5)
    parser.add_argument("--iterations", type=int, default=FineTuning().iterations)
    parser.add_argument("--loss")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    publish({path.name: measured(path, options) for path in options.files}, options.output)


if __name__ == "__main__":
    main()
