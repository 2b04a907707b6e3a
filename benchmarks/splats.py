"""Explicit Gaussians against SOG and SPZ: bytes at equal PSNR, damage of losses, and time, as JSON or a plot.

    python benchmarks/splats.py rates luigi.ply tiger.ply --others DIR --ready biker.spz -o splats.json
    python benchmarks/splats.py plot splats.json -o splats.svg
    python benchmarks/splats.py scale truck.splat --counts 100000 1000000 -o splats_scale.json
    python benchmarks/splats.py scale bonsai.ply --counts 500000 --threads 2 -o splats_threads.json

DIR contains a SOG and an SPZ of each PLY, of the same name, made by `splat-transform` of npm. Missing files are written
by `splatwire` and marked. Eight of the given cameras are measured, and half of the rest determine the precision
classes. A file after --ready is its own source: bytes are compared with its own. Of bonsai_30k:

    splatwire import hacpp bonsai_30k -o bonsai.scene
    splatwire export ply bonsai.scene -o bonsai.ply --data bonsai
    splatwire render bonsai.ply --data bonsai --scale 0.5 -o pictures
    python benchmarks/splats.py rates bonsai.ply --others DIR --cameras bonsai=pictures/cameras.json -o splats.json
"""

import argparse
import ctypes
import dataclasses
import gc
import itertools
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from figures import publish

from splatwire.bitstream import PRESETS, SceneStream
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.codec.gaussians.quality import QUALITIES, Quality
from splatwire.concealment import conceal
from splatwire.data import load_cameras
from splatwire.io.formats import read_splats, write_splats
from splatwire.ops.threads import use_single_thread
from splatwire.render import iterate_views
from splatwire.render.importance import cameras_around
from splatwire.render.precision import measure_class_offsets
from splatwire.types import Cameras, SplatScene
from splatwire.types.splats import Splats

LEVELS = (5.0, 9.0, 11.0, 12.0)
"""Besides those of the named qualities."""
SEEDS, VIEWS = range(5), 8
AGAIN = 1_000_000
"""Gaussians that times are taken on once more at least: the least of several is that of a quiet machine."""


def mean_psnr(splats: Splats | SplatScene, cameras: Cameras, reference: list[np.ndarray]) -> float:
    scene = splats if isinstance(splats, SplatScene) else SplatScene(splats)
    pictures = zip(iterate_views(scene, cameras), reference, strict=True)
    errors = [max(float(((ours - theirs) ** 2).mean()), 1e-12) for ours, theirs in pictures]
    return float(np.mean(-10 * np.log10(errors)))


def coded(
    splats: Splats, classes: np.ndarray, quality: Quality, preset: str = "datagram", threads: int = 1
) -> tuple[SceneStream, dict]:
    clock = time.process_time if threads == 1 else time.perf_counter
    before, started = settled_mib(), clock()
    stream = encode_scene(SplatScene(splats), PRESETS[preset], class_offsets=classes, quality=quality, threads=threads)
    encoding, encode_peak = clock() - started, peak_mib() - before
    before, started = settled_mib(), clock()
    decoded = decode_stream(stream, threads=threads).scene.splats
    decoding, decode_peak = clock() - started, peak_mib() - before
    count, output = splats.num_gaussians, sum(values.nbytes for values in vars(decoded).values())
    return stream, {
        "bytes": stream.num_bytes,
        "bits_per_gaussian": 8 * stream.num_bytes / count,
        "encode_us_per_gaussian": encoding / count * 1e6,
        "decode_us_per_gaussian": decoding / count * 1e6,
        "encode_mib_beside_stream": encode_peak - stream.num_bytes / 2**20,
        "decode_mib_beside_output": decode_peak - output / 2**20,
        "decoded": decoded,
    }


def bytes_at(rows: list[dict], wanted: float) -> float | None:
    """Bytes at a PSNR, interpolated between the two Pareto-optimal rows around it, as logarithms of bytes."""
    best = [row for row in rows if not any(r["bytes"] < row["bytes"] and r["psnr"] > row["psnr"] for r in rows)]
    rows = sorted(best, key=lambda row: row["psnr"])
    for low, high in itertools.pairwise(rows):
        if low["psnr"] <= wanted <= high["psnr"]:
            share = (wanted - low["psnr"]) / max(high["psnr"] - low["psnr"], 1e-9)
            return float(low["bytes"] * (high["bytes"] / low["bytes"]) ** share)
    return None


def others_of(path: Path, folder: Path, splats: Splats, cameras: Cameras, reference: list[np.ndarray]) -> dict:
    found = {}
    for kind in ("sog", "spz"):
        theirs = folder / f"{path.stem}.{kind}"
        writer = "splat-transform" if theirs.exists() else "splatwire.io.formats"
        with tempfile.TemporaryDirectory() as made:
            if not theirs.exists():
                theirs = Path(made) / f"own.{kind}"
                write_splats([splats], theirs)
            quality = mean_psnr(read_splats(theirs), cameras, reference)
            found[kind] = {"bytes": theirs.stat().st_size, "psnr": quality, "writer": writer}
    return found


def measure_scene(path: Path, others: Path | None, cameras_file: Path | None) -> dict:
    splats = read_splats(path)
    given_cameras = load_cameras(cameras_file) if cameras_file else None
    all_cameras = given_cameras or cameras_around(splats.means, VIEWS, 320)
    measured = np.linspace(0, all_cameras.num_views - 1, min(all_cameras.num_views, VIEWS)).astype(int).tolist()
    unmeasured = sorted({*range(given_cameras.num_views if given_cameras else 0)} - {*measured})[::2]
    cameras = all_cameras.select(measured)
    reference = list(iterate_views(SplatScene(splats), cameras))
    started = time.process_time()
    classes = measure_class_offsets(splats, all_cameras.select(unmeasured) if unmeasured else None)
    microseconds = (time.process_time() - started) / splats.num_gaussians * 1e6
    rows = []
    levels = {str(level): dataclasses.replace(QUALITIES["default"], level=level) for level in LEVELS}
    for name, quality in {**levels, **QUALITIES}.items():
        stream, row = coded(splats, classes, quality)
        row["psnr"] = mean_psnr(row.pop("decoded"), cameras, reference)
        rows.append({"name": name, "level": quality.level, **row})
        if name == "default":
            default = stream
    rows.sort(key=lambda row: row["level"])
    result = {
        "gaussians": splats.num_gaussians,
        "degree": splats.degree,
        "views": cameras.num_views,
        "classes_us_per_gaussian": microseconds,
        "rows": rows,
        "pak_bytes": coded(splats, classes, QUALITIES["default"], "paper")[1]["bytes"],
        "loss": losses(default, cameras, reference),
    }
    if unmeasured:
        row = coded(splats, measure_class_offsets(splats), QUALITIES["near-lossless"])[1]
        psnr = mean_psnr(row["decoded"], cameras, reference)
        result["near_lossless_without_cameras"] = {"bytes": row["bytes"], "psnr": psnr}
    if others is None:
        size = path.stat().st_size
        result["file_bytes"], at = size, bytes_at(rows, 40.0)
        result["share_of_file_at_40_dB"] = at / size if at else None
        return result
    result["others"] = others_of(path, others, splats, cameras, reference)
    for theirs in result["others"].values():
        at = bytes_at(rows, theirs["psnr"])
        theirs["our_bytes_at_its_psnr"], theirs["share"] = at, at / theirs["bytes"] if at else None
    return result


def losses(stream: SceneStream, cameras: Cameras, reference: list[np.ndarray]) -> dict:
    """Mean PSNR over masks at 20 % lost datagrams."""
    found: dict[str, list[float]] = {"drop": [], "grow": []}
    for seed in SEEDS:
        received = decode_stream(transmit(stream, parse_loss("bernoulli:0.2"), seed=seed)[0])
        for name, values in found.items():
            values.append(mean_psnr(conceal(received, name), cameras, reference))
    return {name: statistics.mean(values) for name, values in found.items()}


def tiled(splats: Splats, count: int) -> Splats:
    """Copies of a scene side by side, up to a number of Gaussians."""
    copies, size = (
        -(-count // splats.num_gaussians),
        float(np.ptp(np.quantile(splats.means, [0.01, 0.99], axis=0), axis=0).max()),
    )
    side = int(np.ceil(np.sqrt(copies)))
    many = {k: np.concatenate([v] * copies)[:count] for k, v in vars(splats).items()}
    cell = np.arange(copies).repeat(splats.num_gaussians)[:count]
    shift = np.stack([cell % side, cell // side, np.zeros_like(cell)], axis=1) * size * 1.05
    many["means"] = many["means"] + shift.astype(np.float32)
    return Splats(**many)


def settled_mib() -> float:
    """Memory of this process without unused parts; resets `peak_mib`."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    return peak_mib()


def peak_mib() -> float:
    """Most memory of this process since `settled_mib`."""
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024


def scale(path: Path, counts: list[int], threads: int) -> dict:
    """Time and memory of a codec call by the number of Gaussians."""
    splats, rows = read_splats(path), []
    classes = (measure_class_offsets(splats) if splats.degree else np.zeros(splats.num_gaussians)).astype(np.int8)
    coded(splats, classes, QUALITIES["default"])
    for count in counts:
        many, classes_of_many = tiled(splats, count), np.resize(classes, count)
        row = coded(many, classes_of_many, QUALITIES["default"], threads=threads)[1]
        row.pop("decoded")
        for _ in range(AGAIN // count):
            again = coded(many, classes_of_many, QUALITIES["default"], threads=threads)[1]
            row.update({name: min(row[name], again[name]) for name in row if name.endswith("us_per_gaussian")})
        rows.append({"gaussians": count, **row, "input_mib": sum(v.nbytes for v in vars(many).values()) / 2**20})
        print(rows[-1], file=sys.stderr)
    return {"source": path.name, "degree": splats.degree, "threads": threads, "rows": rows}


def plot(results: dict, output: Path) -> None:
    """A panel for each scene, four to a row, one legend for all."""
    import matplotlib.pyplot as plt

    scenes = results["scenes"]
    figure, axes = plt.subplots(-(-len(scenes) // 4), 4, figsize=(12, 5.6), layout="constrained", squeeze=False)
    marks = {"sog": "s", "spz": "D", "file": ""}
    for axis, (name, scene) in itertools.zip_longest(axes.flat, scenes.items(), fillvalue=("", None)):
        if scene is None:
            axis.axis("off")
            continue
        for style, label, names in (("o-", "splatwire, datagrams", "123456789ds"), ("*", "near-lossless", "n")):
            rows = [row for row in scene["rows"] if row["name"][0] in names]
            bits, quality = ([row[key] for row in rows] for key in ("bits_per_gaussian", "psnr"))
            axis.plot(bits, quality, style, markersize=4 if style == "o-" else 9, color="C0", label=label)
        theirs = scene.get("others") or {"file": {"bytes": scene["file_bytes"], "psnr": None}}
        for color, (kind, other) in enumerate(theirs.items(), 1):
            bits = 8 * other["bytes"] / scene["gaussians"]
            if other["psnr"] is None:
                axis.axvline(bits, color="gray", linestyle="--", label="the file itself, lossless")
            else:
                axis.plot([bits], [other["psnr"]], marks[kind], color=f"C{color}", label=kind.upper())
        axis.set_title(f"{name}, degree {scene['degree']}", fontsize=8)
        axis.set(xlim=(0, None), ylim=(30, 70))
        axis.grid(alpha=0.3)
    figure.supxlabel("bits per Gaussian, everything counted")
    figure.supylabel("PSNR against the source's own renders, dB")
    shown = {text: line for axis in axes.flat for line, text in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(shown.values(), shown.keys(), loc="outside upper center", ncols=len(shown))
    figure.savefig(output)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=("rates", "plot", "scale"))
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--others", type=Path)
    parser.add_argument("--ready", nargs="*", type=Path, default=[])
    parser.add_argument("--cameras", nargs="*", default=[], metavar="NAME=FILE", help="cameras of a file, by its stem")
    parser.add_argument("--counts", nargs="*", type=int, default=[100_000, 1_000_000])
    parser.add_argument("--threads", type=int, default=1, help="of scale: processor time of 1, seconds of more")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    use_single_thread()
    if args.task == "plot":
        plot(json.loads(args.files[0].read_text()), args.output)
        return
    if args.task == "scale":
        publish(scale(args.files[0], args.counts, args.threads), args.output)
        return
    cameras = dict(pair.split("=", 1) for pair in args.cameras)
    scenes = {}
    for path, others in [*((f, args.others) for f in args.files), *((f, None) for f in args.ready)]:
        cameras_file = cameras.get(path.stem)
        scenes[path.name] = measure_scene(path, others, Path(cameras_file) if cameras_file else None)
        publish({"scenes": scenes}, args.output)


if __name__ == "__main__":
    main()
