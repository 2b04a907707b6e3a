"""PSNR over time along camera paths through a scene with levels, against the order of streamed SOG.

    python benchmarks/walks.py $SPLATWIRE_DATA/splats/{tandt_truck_opensplat_116k.splat,playbot_125k.sog} > walks.json

Copies of the scene fill a square, without harmonics above degree 0. Streamed SOG has the same Gaussians: leaves of a
k-d tree, levels of a quarter each by the same merging, and SOG files of at most 512 K Gaussians. Its order is that of
the PlayCanvas engine: first the coarsest level of all leaves, then for each leaf the level of its distance band,
nearest first, two files at a time. Each file takes two round trips (its index, its pictures). No slow start is counted.
All are compared with pictures of the scene. With loss, packets fit datagrams, as servers send them, and the deficit is
against the same packets without loss.
"""

import argparse
import itertools
import json
import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splatwire.bitstream import PRESETS
from splatwire.channel import parse_loss
from splatwire.codec import repack
from splatwire.evaluation.walkthrough.delivery import Link
from splatwire.evaluation.walkthrough.evaluation import QualitySample, StreamedWalkthrough, score_walk, time_to_quality
from splatwire.evaluation.walkthrough.path import Walk
from splatwire.io.formats import read_splats
from splatwire.io.formats.sog import read_sog
from splatwire.io.formats.sog_writer import write_sog
from splatwire.lod import Viewpoint, encode_levels
from splatwire.lod.merging import reduce_gaussians
from splatwire.ops.kd_order import kd_order
from splatwire.render.precision import scene_class_offsets
from splatwire.types import Cameras, SplatScene
from splatwire.types.splats import Splats

LINK = Link(10e6)
SECONDS, SIZE = 20.0, 256
LEAF, FILE = 32_768, 512 << 10
LEVELS, FACTOR = 3, 4
BUDGET = 1_000_000


def copied(splats: Splats, side: int) -> Splats:
    """A square of side x side copies on the ground, degree 0."""
    splats = splats.at_most_degree(0)
    low, high = np.quantile(splats.means, (0.02, 0.98), axis=0)
    parts = [
        replace(splats, means=splats.means + np.array([x * (high - low)[0], 0, z * (high - low)[2]], np.float32))
        for x, z in itertools.product(range(side), repeat=2)
    ]
    return joined(parts)


def joined(parts: list[Splats]) -> Splats:
    """Concatenates parts of a scene."""
    return Splats(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])})


def walks(splats: Splats) -> dict[str, Walk]:
    """Three camera paths: around the scene, from far away to a part, and through the scene; y points down."""
    means = splats.means[:: max(1, splats.num_gaussians // 200_000)]
    low, middle, high = np.quantile(means.astype(np.float64), (0.05, 0.5, 0.95), axis=0)
    span = float(np.linalg.norm((high - low)[[0, 2]]))
    up = np.array([0.0, -1.0, 0.0])
    around = [
        (middle + 0.75 * span * np.array([np.cos(a), -0.35, np.sin(a)]), middle) for a in np.linspace(0, 2 * np.pi, 9)
    ]
    corner = middle + 0.3 * (high - low) * [1, 0, 1]
    there = [(corner + share * span * np.array([0.6, -0.3, 0.8]), corner) for share in np.geomspace(1.2, 0.08, 9)]
    eyes = [low + share * (high - low) * [1, 0, 1] + [0, 0.2 * (high - low)[1], 0] for share in np.linspace(0, 1, 9)]
    eyes = [eye + 0.06 * span * up for eye in eyes]
    turns = np.linspace(0.8, 3.2, 9)
    through = [(eye, eye + np.array([np.cos(t), 0.15, np.sin(t)])) for eye, t in zip(eyes, turns, strict=True)]
    return {name: Walk(cameras(way), SECONDS) for name, way in
            {"around": around, "towards": there, "through": through}.items()}  # fmt: skip


def cameras(way: list[tuple[np.ndarray, np.ndarray]]) -> Cameras:
    """Cameras at given positions, each directed at a target."""
    poses = []
    for eye, target in way:
        ahead = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross([0.0, 1.0, 0.0], ahead)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(ahead, right), ahead])
        pose[:3, 3] = -pose[:3, :3] @ eye
        poses.append(pose)
    intrinsics = np.array([[0.9 * SIZE, 0, SIZE / 2], [0, 0.9 * SIZE, SIZE / 2], [0, 0, 1]])
    count = len(poses)
    return Cameras(
        np.array(poses, np.float32),
        np.tile(intrinsics.astype(np.float32), (count, 1, 1)),
        SIZE, SIZE, tuple(f"{n}" for n in range(count)),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class StreamedSog:
    """A scene as streamed SOG.

    Attributes:
        leaves: Gaussians of each leaf at each level, the finest first.
        files: File of each leaf at each level, an index into `sizes`.
        sizes: Bytes of each file.
        low: Corners of each leaf.
        high: Corners of each leaf.
        base: Maximum distance for the finest level; each further level has three times that of the level before.
    """

    leaves: list[list[Splats]]
    files: list[list[int]]
    sizes: list[int]
    low: np.ndarray
    high: np.ndarray
    base: float

    def wanted(self, eye: np.ndarray) -> tuple[list[int], list[int]]:
        """Level of each leaf for a viewpoint, coarser until the budget is kept; and the leaves, nearest first."""
        apart = np.maximum(np.maximum(self.low - eye, eye - self.high), 0)
        distance = np.linalg.norm(apart, axis=1)
        base = self.base
        while True:
            bands = [base * 3**level for level in range(LEVELS - 1)]
            levels = np.searchsorted(bands, distance).tolist()
            if sum(self.leaves[level][leaf].num_gaussians for leaf, level in enumerate(levels)) <= BUDGET:
                return levels, np.argsort(distance, kind="stable").tolist()
            base *= 0.8


def streamed_sog(splats: Splats) -> StreamedSog:
    """Builds the levels, writes them as streamed SOG and reads them again."""
    count = splats.num_gaussians
    edges = np.arange(-(-count // LEAF) + 1, dtype=np.int64) * count // -(-count // LEAF)
    order = kd_order(splats.means, [edges])
    finest = [splats.select(order[a:b]) for a, b in itertools.pairwise(edges)]
    low, high = (np.array([end(leaf.means, axis=0) for leaf in finest]) for end in (np.min, np.max))
    levels = [finest]
    while len(levels) < LEVELS:
        levels.append([reduce_gaussians(leaf, -(-leaf.num_gaussians // FACTOR))[0] for leaf in levels[-1]])
    leaves, files, sizes = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chunk.sog"
        for level in levels:
            read, own, waiting = [], [], []
            for number, leaf in enumerate(level):
                waiting.append(leaf)
                if number == len(level) - 1 or sum(part.num_gaussians for part in waiting) + LEAF > FILE:
                    # The file's size is that of all leaves. Each leaf is also written alone, to know its Gaussians.
                    write_sog([joined(waiting)], path)
                    sizes.append(path.stat().st_size)
                    for part in waiting:
                        write_sog([part], path)
                        read.append(read_sog(path).splats)
                    own += [len(sizes) - 1] * len(waiting)
                    waiting = []
            leaves.append(read)
            files.append(own)
    ends = np.quantile(splats.means, [0.05, 0.95], axis=0)
    span = float(np.linalg.norm(ends[1] - ends[0]))
    return StreamedSog(leaves, files, sizes, low, high, span / 4)


class SogWalkthrough:
    """Streamed SOG that arrives along a walk; see `splatwire.evaluation.walkthrough.evaluation.ProgressiveSource`."""

    def __init__(self, sog: StreamedSog, walk: Walk, link: Link) -> None:
        self._sog, self._link = sog, link
        self._done: dict[int, float] = {}
        self._deliver(walk)

    def _deliver(self, walk: Walk) -> None:
        sog, step = self._sog, 0.01
        loads: dict[int, list[float]] = {}  # file: trips that are left, bytes that are left
        now = 5 * self._link.delay  # handshake, and the scene's index
        while now < walk.seconds:
            eye = walk.at(now).centers[0].astype(np.float64)
            levels, near = sog.wanted(eye)
            order = [sog.files[-1][leaf] for leaf in near] + [sog.files[levels[leaf]][leaf] for leaf in near]
            for file in order:
                if len(loads) < 2 and file not in loads and file not in self._done:
                    loads[file] = [4 * self._link.delay, float(sog.sizes[file])]
            busy = [load for load in loads.values() if load[0] <= 0]
            for load in loads.values():
                load[0] -= step
            for load in busy:
                load[1] -= self._link.rate / 8 * step / len(busy)
            now += step
            for file in [file for file, load in loads.items() if load[1] <= 0]:
                del loads[file]
                self._done[file] = now

    def _scene(self, viewpoint: Viewpoint, arrived: dict[int, float], seconds: float) -> SplatScene:
        sog = self._sog
        levels, _ = sog.wanted(-viewpoint.viewmat[:3, :3].T @ viewpoint.viewmat[:3, 3])
        parts = [sog.leaves[0][0].select(np.zeros(0, np.int64))]
        for leaf, level in enumerate(levels):
            there = [n for n in range(LEVELS) if arrived.get(sog.files[n][leaf], np.inf) <= seconds]
            best = min(there, key=lambda n: (n < level, abs(n - level)), default=None)
            parts += [] if best is None else [sog.leaves[best][leaf]]
        return SplatScene(joined(parts))

    def shown(self, seconds: float, viewpoint: Viewpoint) -> SplatScene:
        """See `ProgressiveSource.shown`."""
        return self._scene(viewpoint, self._done, seconds)

    def complete(self, viewpoint: Viewpoint) -> SplatScene:
        """See `ProgressiveSource.complete`."""
        return self._scene(viewpoint, dict.fromkeys(range(len(self._sog.sizes)), 0.0), 0.0)

    def bytes_at(self, seconds: float) -> int:
        """See `ProgressiveSource.bytes_at`."""
        return sum(self._sog.sizes[file] for file, at in self._done.items() if at <= seconds)


def walk_result(moments: list[QualitySample]) -> dict[str, object]:
    """Result of a walk for the output."""
    return {"settled": time_to_quality(moments), "moments": [asdict(moment) for moment in moments]}


def measured(path: str, side: int) -> dict[str, object]:
    """Measures all walks through a scene."""
    one = SplatScene(read_splats(Path(path)))
    classes = scene_class_offsets(one, None)
    scene = SplatScene(copied(one.splats, side))
    stream = encode_levels(scene, class_offsets=None if classes is None else np.tile(classes, side * side))
    datagrams = repack(stream, PRESETS["datagram"])  # as servers send it over UDP and QUIC
    sog = streamed_sog(scene.splats)
    facts: dict[str, Any] = {
        "scene": path.rsplit("/", 1)[-1], "copies": side * side, "gaussians": scene.num_elements,
        "bytes": stream.num_bytes, "datagram_bytes": datagrams.num_bytes, "sog_bytes": sum(sog.sizes),
        "sog_files": len(sog.sizes), "walks": {},
    }  # fmt: skip
    for name, walk in walks(scene.splats).items():
        print(f"{path}: {name}", file=sys.stderr)
        times = [0.5, *(float(second) for second in range(1, int(SECONDS) + 1))]
        link = replace(LINK, loss=parse_loss("bernoulli:0.05", "datagram"))
        ours = StreamedWalkthrough.of(stream, walk, LINK)
        shows = {"ours": ours, "streamed SOG": SogWalkthrough(sog, walk, LINK),
                 "ours in datagrams": StreamedWalkthrough.of(datagrams, walk, LINK),
                 "ours in datagrams, 5 % lost": StreamedWalkthrough.of(datagrams, walk, link)}  # fmt: skip
        found = {key: walk_result(score_walk(show, scene, walk, times)) for key, show in shows.items()}
        whole = ours.time_to_coarsest_level
        first = score_walk(ours, scene, walk, [whole])[0]
        pairs = list(zip(*(found[key]["moments"] for key in found), strict=True))
        facts["walks"][name] = {
            "first_picture": asdict(first),
            "worst_lead": min(a["psnr"] - b["psnr"] for a, b, _, _ in pairs),
            "seconds_behind": [a["seconds"] for a, b, _, _ in pairs if a["psnr"] <= b["psnr"]],
            "worst_of_loss": max(c["psnr"] - d["psnr"] for _, _, c, d in pairs),
            **found,
        }
    return facts


def main() -> None:
    """Prints one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", help="files of explicit Gaussians")
    parser.add_argument("--side", type=int, default=3, help="the scene is copied to a square of so many on a side")
    given = parser.parse_args()
    print(json.dumps([measured(path, given.side) for path in given.scenes], indent=1))


if __name__ == "__main__":
    main()
