"""Size and quality of trained scenes as streams, compared by model, as JSON.

Scenes are trained by `splatwire train DATA -o FILE --model hacpp|causal --lmbda L`; each is encoded, decoded and
rendered from the test views, completely and with 20 % of the packets lost. `drop` is the deficit against the complete
picture by concealer, a mean over three losses. Processor times are those of one thread, the best of five. With at least
four scenes per model, `bd_rate` is the change of bytes of the causal model against format 1 at equal PSNR
(Bjontegaard's mean over the overlap, of piecewise cubics).

A stream instead of a scene is measured unchanged, except for its sections for concealers.

    python benchmarks/causal.py --photos lego=DIR lego=lego_12.scene ... [--output results/causal.json] [--plot rd.png]
    python benchmarks/causal.py --rows monday.json tuesday.json --output results/causal.json --plot causal.png
"""

import argparse
import hashlib
import itertools
import json
import time
import timeit
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from figures import publish

from splatwire.anchors.scene_file import load_scene
from splatwire.anchors.voxels import voxel_indices
from splatwire.bitstream import SceneStream, read_stream, stream_to_bytes
from splatwire.bitstream.limits import SCHEMAS
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene, side_info_parts
from splatwire.codec.anchors.causal.context import CodingContext
from splatwire.codec.anchors.causal.packet_coder import anchor_bits, quantise
from splatwire.codec.anchors.causal.side_info import read_side_info
from splatwire.codec.decoding import batches_of, open_decoder
from splatwire.codec.weight_bytes import framed
from splatwire.concealment import conceal
from splatwire.data import Dataset, open_dataset
from splatwire.entropy.tables import inverse_scale_table
from splatwire.evaluation import rate_distortion
from splatwire.evaluation.rate_distortion import RatePoint
from splatwire.files.byte_io import ByteReader
from splatwire.neural.training.causal import value_bits
from splatwire.neural.training.quality import assess_scene
from splatwire.ops.morton import morton_encode
from splatwire.ops.threads import use_single_thread
from splatwire.types import AnchorScene, CausalCoding

OFFICIAL = "official"
CONCEALERS = ("grow", "scene_free")
LOSS, SEEDS = "bernoulli:0.2", (0, 1, 2)
CURVES = {"hacpp": "format 1", "causal": "format 2, causal", OFFICIAL: "HAC++, official"}
FEWEST = 4
"""Points of a curve that a mean over it needs."""


def measured(file: Path, photos: Path, copies: int) -> dict[str, Any]:
    """Bytes, quality and time of a scene as a stream; also the time with `copies` of it in a row, if given."""
    if file.suffix == ".swz":
        stream = plain(read_stream(file)[0])
        scene = decode_stream(stream).scene
    else:
        scene = load_scene(file)
        stream = encode_scene(scene)
    data = stream_to_bytes(stream)
    test = open_dataset(photos, split="test")
    received = decode_stream(stream)
    parts, num = side_info_parts(stream.side_info, stream.manifest.schema_name), stream.manifest.num_elements
    psnr = assess_scene(received.scene, test, test.num_views, 0).psnr
    row = {
        "model": "causal" if isinstance(scene.coding, CausalCoding) else "hacpp",
        "bytes": len(data), "psnr": psnr, "anchors": num, "gaussians": int(received.scene.anchors.mask.sum()),
        "head_share": len(stream.side_info) / len(data), "side_info": parts,
        "position_bits": 8 * parts["positions"] / num,
        "encode_us_per_anchor": encoding_time(scene) / num * 1e6,
        "decode_us_per_anchor": decoding_time(stream) / num * 1e6,
        "drop": {name: psnr - lossy_psnr(stream, test, name) for name in CONCEALERS},
    }  # fmt: skip
    if isinstance(scene.coding, CausalCoding):
        row["bits_of_an_anchor"] = attribute_bits(received.scene, stream)
    if copies:
        row["side_by_side"] = side_by_side(scene, copies)
    return row


def side_by_side(scene: AnchorScene, copies: int) -> dict[str, float]:
    """Wall time per anchor in microseconds, with all threads, of a large scene made of copies in a row."""
    voxel, anchors = scene.coding.voxel_size, scene.anchors
    width = (np.ptp(anchors.positions[:, 0]) // voxel + 1) * voxel
    moved = [anchors.positions + np.float32([i * width, 0, 0]) for i in range(copies)]
    rest = {name: np.concatenate([values] * copies) for name, values in vars(anchors).items()}
    larger = replace(scene, anchors=replace(anchors, **{**rest, "positions": np.concatenate(moved)}))
    stream, num = encode_scene(larger), copies * anchors.num_anchors
    times = {"encode": lambda: encode_scene(larger), "decode": lambda: decode_stream(stream)}
    best = {name: min(timeit.repeat(work, number=1, repeat=5)) for name, work in times.items()}
    return {"anchors": num, **{f"{name}_us_per_anchor": seconds / num * 1e6 for name, seconds in best.items()}}


def plain(stream: SceneStream) -> SceneStream:
    """Stream without named sections; its complete picture is the same, except for the background."""
    fixed = ByteReader(stream.side_info, "side information")
    num_sections = len(SCHEMAS[stream.manifest.schema_name].sections)
    side_info = b"".join(framed(fixed.blob()) for _ in range(num_sections))
    manifest = replace(
        stream.manifest, side_info_bytes=len(side_info), side_info_digest=hashlib.sha256(side_info).hexdigest()
    )
    return SceneStream(manifest, side_info, stream.packets)


def lossy_psnr(stream: SceneStream, test: Dataset, concealer: str) -> float:
    """Mean test PSNR of the stream after some losses."""
    arrived = (decode_stream(transmit(stream, parse_loss(LOSS), seed=seed)[0]) for seed in SEEDS)
    scenes = (conceal(received, concealer) for received in arrived)
    return float(np.mean([assess_scene(scene, test, test.num_views, 0).psnr for scene in scenes]))


def encoding_time(scene: AnchorScene, repetitions: int = 5) -> float:
    """Processor time of encoding a scene in one thread, seconds."""
    best = np.inf
    for _ in range(repetitions):
        before = time.process_time()
        encode_scene(scene, threads=1)
        best = min(best, time.process_time() - before)
    return float(best)


def decoding_time(stream: SceneStream, repetitions: int = 5) -> float:
    """Processor time of decoding all packets of a stream in one thread, seconds; side information is read before."""
    best = np.inf
    for _ in range(repetitions):
        decoder = open_decoder(stream.manifest, stream.side_info)
        batches = list(batches_of(decoder, stream.manifest, stream.packets))
        before = time.process_time()
        decoder.allocate(threads=1)
        for batch in batches:
            decoder.store(batch, decoder.decode(batch))
        best = min(best, time.process_time() - before)
    return float(best)


def attribute_bits(scene: AnchorScene, stream: SceneStream) -> dict[str, float]:
    """Bits per anchor by attribute, from the coder's normal distributions."""
    info = read_side_info(stream.side_info, stream.manifest.num_elements)
    context, layout, anchors, known = CodingContext.of(info), info.config.layout, scene.anchors, info.positions.known
    voxels = voxel_indices(anchors.positions, info.voxel_size)
    positions = replace(known, codes=morton_encode(voxels - known.corner))
    steps = scene.causal.steps.astype(np.float64)
    logs = anchors.scalings.astype(np.float64)[:, [0, 3, 4, 5]]
    steps_of_logs = steps[len(layout.feature_groups) :][[0, 1, 1, 1]]
    log_scalings = (np.log(logs) - scene.causal.zero_points.astype(np.float64)) / steps_of_logs
    feature = anchors.features.astype(np.float64) / np.repeat(
        steps[: len(layout.feature_groups)], layout.feature_groups
    )
    values = np.concatenate(
        [feature, log_scalings, anchors.offsets.reshape(len(anchors.offsets), -1).astype(np.float64) / steps[-1]],
        axis=1,
    )
    masks = anchors.mask.astype(np.uint8)
    found = quantise(context, positions, masks, values, 0.0)
    without = replace(found, positions=replace(positions, num_low_bits=np.zeros_like(known.num_low_bits)))
    place = float((anchor_bits(context, found) - anchor_bits(context, without)).mean())
    spread = -torch.from_numpy(np.log2(inverse_scale_table()[found.deviation_indices] / 2.0**20))
    each = value_bits(torch.from_numpy(found.symbols), torch.zeros(1), spread).numpy()
    each[:, context.stages[-1].first :] *= np.repeat(masks, 3, axis=1)
    p = 1 / (1 + np.exp(-found.logits * 2.0**-16))
    edges = [0, layout.feature_dim, layout.feature_dim + 1, layout.feature_dim + 4, each.shape[1]]
    parts = zip(("feature", "scale", "size", "offset"), itertools.pairwise(edges), strict=True)
    sums = {name: float(each[:, slice(*pair)].sum() / len(masks)) for name, pair in parts}
    return {"place": place, **sums, "mask": float(-np.log2(np.where(masks, p, 1 - p)).sum() / len(masks))}


def bd_rate(rows: list[dict[str, Any]]) -> float | None:
    """Mean change of bytes at equal PSNR, from format 1 to the causal model; None if curves are too short."""
    curves = {
        model: [RatePoint(row["bytes"], row["psnr"]) for row in rows if row["model"] == model]
        for model in ("hacpp", "causal")
    }
    return rate_distortion.bd_rate(*curves.values()) if min(map(len, curves.values())) >= FEWEST else None


def plot(scenes: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Draws rate against distortion, a panel for each scene."""
    from matplotlib import pyplot

    _, axes = pyplot.subplots(1, len(scenes), figsize=(5 * len(scenes), 4), squeeze=False)
    for axis, (name, rows) in zip(axes[0], scenes.items(), strict=True):
        for model, label in CURVES.items():
            points = sorted((row["bytes"] / 1000, row["psnr"]) for row in rows if row["model"] == model)
            if points:
                axis.plot(*zip(*points, strict=True), marker="o", label=label)
        axis.set(title=name, xlabel="kB, everything counted", ylabel="test PSNR, dB")
        axis.margins(0.12)
        axis.legend()
    pyplot.tight_layout()
    pyplot.savefig(path)


def main() -> None:
    """Measures all scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", help="NAME=FILE, a trained scene of the photos NAME")
    parser.add_argument("--photos", action="append", default=[], help="NAME=FOLDER")
    parser.add_argument("--rows", type=Path, nargs="*", default=[], help="outputs of earlier runs to put before")
    parser.add_argument("--official", action="append", default=[], help="NAME=BYTES,PSNR of HAC++'s own run")
    parser.add_argument("--copies", type=int, default=0, help="time so many of a scene side by side, too")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    use_single_thread()
    photos, found = dict(text.split("=", 1) for text in options.photos), defaultdict(list)
    for earlier in options.rows:
        for name, curve in json.loads(earlier.read_text()).items():
            found[name] += curve["scenes"]
    for text in options.scenes:
        name, file = text.split("=", 1)
        found[name].append({"scene": Path(file).stem, **measured(Path(file), Path(photos[name]), options.copies)})
    for text in options.official:
        name, point = text.split("=", 1)
        size, psnr = point.split(",")
        found[name].append({"scene": OFFICIAL, "model": OFFICIAL, "bytes": int(size), "psnr": float(psnr)})
    publish({name: {"bd_rate": bd_rate(rows), "scenes": rows} for name, rows in found.items()}, options.output)
    if options.plot:
        plot(found, options.plot)


if __name__ == "__main__":
    main()
