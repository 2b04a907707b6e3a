"""Quality of PLY, compressed PLY, SPZ, SOG, HAC++ files and a stream of the same scene under packet loss: JSON.

    SPLATWIRE_DATA=DATA python benchmarks/other_formats_under_loss.py -o other_formats_under_loss.json

Each file is cut into packets of 1,200 bytes. Lost ones become zeros (`zeros`), or the file ends at the first gap
(`cut`). `strict` is the reader of splatwire with all checks of the format. `lenient` ignores checksums and lengths
(`lenient_readers.py`). `rows known` is a PLY reader that knows the missing bytes and omits their rows. PSNR is against
the same complete file, mean of the masks that leave a picture; `nothing` is the PSNR of an empty one. A mask that loses
nothing is drawn again. Losses of the `.swz` are those of a file, as for the others, and those of datagrams with
protected side information, as over a network.
"""

import argparse
import logging
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from figures import publish
from lenient_readers import REPAIRS, HacppFiles, known_rows

from splatwire.anchors.voxels import voxel_indices
from splatwire.bitstream import SceneStream, packetization_named, read_stream, write_stream
from splatwire.channel import parse_loss, transmit
from splatwire.codec import decode_stream, encode_scene
from splatwire.concealment import conceal
from splatwire.errors import SplatwireError
from splatwire.io.formats import read_rows, read_splats, write_splats
from splatwire.metrics import psnr
from splatwire.neural.importers.hacpp import import_hacpp
from splatwire.ops.threads import use_single_thread
from splatwire.render import iterate_views
from splatwire.render.importance import surrounding_cameras
from splatwire.render.precision import scene_class_offsets
from splatwire.types import Cameras, SplatScene
from splatwire.types.scene import Scene

DATA = Path(os.environ.get("SPLATWIRE_DATA", "../shared/data"))
FILES = [DATA / "splats" / name for name in ("guitar.compressed.ply", "biker.spz", "playbot_125k.sog")]
MODELS = [DATA / "hacpp" / name for name in ("snowmiku_small_2400", "snowmiku_15k")]
LOSSES = [kind.format(rate) for rate in (0.01, 0.05, 0.2) for kind in ("bernoulli:{}", "gilbert:{},20")]
PACKET, CAP = 1200, 60.0
CONCEALERS = ("drop", "grow")


class Gauge:
    """Pictures of a complete scene, with which pictures of damaged scenes are compared."""

    def __init__(self, scene: Scene, cameras: Cameras) -> None:
        self._cameras, self._truth = cameras, list(iterate_views(scene, cameras))

    def psnr(self, scene: Scene) -> float:
        """Mean PSNR over the views, at most `CAP`, decibels."""
        pairs = zip(iterate_views(scene, self._cameras), self._truth, strict=True)
        return float(np.mean([min(float(psnr(a[None], b[None])[0]), CAP) for a, b in pairs]))

    @property
    def nothing(self) -> float:
        """PSNR of black pictures, dB."""
        return float(np.mean([float(psnr(np.zeros_like(b)[None], b[None])[0]) for b in self._truth]))


def fates(loss: str, packets: int, seeds: int) -> Iterator[np.ndarray]:
    """Masks of received packets, bool (packets), one for each seed; each loses at least one packet."""
    model = parse_loss(loss, "datagram")
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        arrived = model.received(packets, rng)
        while arrived.all():
            arrived = model.received(packets, rng)
        yield arrived


def damaged(data: bytes, arrived: np.ndarray) -> dict[str, bytes]:
    """The file with zeros in place of lost packets, and the file cut before the first lost packet."""
    known = np.repeat(arrived, PACKET)[: len(data)]
    zeros = (np.frombuffer(data, np.uint8) * known).tobytes()
    return {"zeros": zeros, "cut": data[: int(np.argmin(arrived)) * PACKET]}


def summary(values: list[float | None]) -> dict[str, float | int | None]:
    """Result row: number of readable files, and their mean PSNR."""
    seen = [value for value in values if value is not None]
    return {"opened": len(seen), "of": len(values), "psnr": round(float(np.mean(seen)), 2) if seen else None}


def psnr_if_readable(path: Path, gauge: Gauge) -> float | None:
    """PSNR of the file as read by splatwire, or None if refused."""
    try:
        return gauge.psnr(SplatScene(read_splats(path)))
    except SplatwireError:
        return None


def psnr_of_rows(path: Path, kept: np.ndarray, gauge: Gauge) -> float | None:
    """PSNR of a complete file if only some rows are kept."""
    splats, validity = read_rows(path)
    shown = validity.kept & kept
    return gauge.psnr(SplatScene(splats.select(shown))) if shown.any() else None


def lost_file(path: Path, kind: str, gauge: Gauge, seeds: int, folder: Path) -> dict[str, object]:
    """Results of one file of explicit Gaussians under all losses."""
    data, rows = path.read_bytes(), {}
    for loss in LOSSES:
        found: dict[str, list[float | None]] = {}
        for arrived in fates(loss, -(-len(data) // PACKET), seeds):
            for how, left in damaged(data, arrived).items():
                broken = folder / f"broken.{kind}"
                broken.write_bytes(left)
                strict = psnr_if_readable(broken, gauge)
                found.setdefault(f"strict, {how}", []).append(strict)
                lenient = strict
                if strict is None:
                    with tempfile.TemporaryDirectory() as made:
                        target = Path(made) / ("sog" if kind == "sog" else f"repaired.{kind}")
                        lenient = psnr_if_readable(target, gauge) if REPAIRS[kind](left, target) else None
                found.setdefault(f"lenient, {how}", []).append(lenient)
            if kind.endswith("ply"):
                kept = known_rows(data, np.repeat(arrived, PACKET)[: len(data)])
                found.setdefault("rows known", []).append(None if kept is None else psnr_of_rows(path, kept, gauge))
        rows[loss] = {how: summary(values) for how, values in found.items()}
        print(path.name, loss, rows[loss], file=sys.stderr, flush=True)
    return {"bytes": len(data), "losses": rows}


def lost_stream(stream: SceneStream, gauge: Gauge, seeds: int, folder: Path) -> dict[str, object]:
    """Results of a stream as a file, and as datagrams with protected side information."""
    path = folder / "scene.swz"
    write_stream(stream, path)
    data, rows = path.read_bytes(), {}
    for loss in LOSSES:
        found: dict[str, list[float | None]] = {}
        for seed, arrived in enumerate(fates(loss, -(-len(data) // PACKET), seeds)):
            for how, left in damaged(data, arrived).items():
                path.write_bytes(left)
                try:
                    received = decode_stream(read_stream(path)[0])
                except SplatwireError:
                    received = None
                for name in CONCEALERS:
                    seen = None if received is None else gauge.psnr(conceal(received, name))
                    found.setdefault(f"file, {how}, {name}", []).append(seen)
            sent, again = transmit(stream, parse_loss(loss, "datagram"), seed=seed)[0], seed
            while len(sent.packets) == len(stream.packets):
                again += seeds
                sent = transmit(stream, parse_loss(loss, "datagram"), seed=again)[0]
            received = decode_stream(sent)
            for name in CONCEALERS:
                found.setdefault(f"datagrams, {name}", []).append(gauge.psnr(conceal(received, name)))
        rows[loss] = {how: summary(values) for how, values in found.items()}
        print("swz", loss, rows[loss], file=sys.stderr, flush=True)
    head = stream.num_bytes - sum(len(packet.data) + 4 for packet in stream.packets)
    return {"bytes": len(data), "bytes that a file cannot lose": head, "losses": rows}


def explicit(source: Path, options: argparse.Namespace) -> dict[str, object]:
    """Results of all formats of one file of explicit Gaussians; its own format is the file itself."""
    splats, formats = read_splats(source), {}
    scene = SplatScene(splats)
    cameras = surrounding_cameras(scene, options.views, options.width)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for kind in REPAIRS:
            path = source if source.name.partition(".")[2] == kind else folder / f"whole.{kind}"
            if path is not source:
                write_splats([splats], path)
            gauge = Gauge(SplatScene(read_splats(path)), cameras)
            formats[kind] = lost_file(path, kind, gauge, options.seeds, folder)
        packets = packetization_named("datagram", "gaussians", splats.num_gaussians)
        stream = encode_scene(scene, packets, class_offsets=scene_class_offsets(scene))
        gauge = Gauge(decode_stream(stream).scene, cameras)
        formats["swz"] = lost_stream(stream, gauge, options.seeds, folder)
    return {"gaussians": splats.num_gaussians, "nothing": round(gauge.nothing, 2), "formats": formats}


def neural(model: Path, options: argparse.Namespace) -> dict[str, object]:
    """Results of HAC++'s own files, and of a stream of the same anchors."""
    scene = import_hacpp(model)
    cameras = surrounding_cameras(scene, options.views, options.width)
    gauge, rows = Gauge(scene, cameras), {}
    voxels = voxel_indices(scene.anchors.positions, scene.coding.voxel_size)
    files = HacppFiles(model / "bitstreams", voxels, scene.anchors.mask)

    def psnr_of_received(arrived: np.ndarray, given: bool) -> float | None:
        whole = files.whole(arrived, PACKET, given)
        if whole is None or not whole.any():
            return None
        return gauge.psnr(scene.select(np.flatnonzero(whole)))

    for loss in LOSSES:
        found: dict[str, list[float | None]] = {}
        for arrived in fates(loss, -(-files.num_bytes // PACKET), options.seeds):
            cut = np.arange(len(arrived)) < np.argmin(arrived)
            for how, fate in (("zeros", arrived), ("cut", cut)):
                found.setdefault(f"lenient, {how}", []).append(psnr_of_received(fate, given=False))
            found.setdefault("lenient, zeros, places, masks and hash grid given", []).append(
                psnr_of_received(arrived, given=True)
            )
        rows[loss] = {how: summary(values) for how, values in found.items()}
        print(model.name, loss, rows[loss], file=sys.stderr, flush=True)
    stream = encode_scene(scene, packetization_named("datagram", "hacpp", scene.num_elements))
    whole = Gauge(decode_stream(stream).scene, cameras)
    with tempfile.TemporaryDirectory() as made:
        swz = lost_stream(stream, whole, options.seeds, Path(made))
    needed = {"bytes": files.num_bytes, "bytes that all anchors need": files.shared_bytes, "losses": rows}
    return {"anchors": scene.num_elements, "nothing": round(gauge.nothing, 2), "formats": {"hacpp": needed, "swz": swz}}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", nargs="*", type=Path, default=FILES)
    parser.add_argument("--models", nargs="*", type=Path, default=MODELS)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--width", type=int, default=224)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    logging.disable()  # only missing parts of damaged files count here
    use_single_thread()
    preview_attributes, scenes = {"seeds": options.seeds, "views": options.views, "packet": PACKET}, {}
    for path in [*options.models, *options.files]:
        scenes[path.name] = (neural if path.is_dir() else explicit)(path, options)
        publish({**preview_attributes, "scenes": scenes}, options.output)


if __name__ == "__main__":
    main()
