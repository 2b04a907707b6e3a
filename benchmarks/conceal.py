"""Seconds and memory of every concealer on 400,000 anchors of which 20 % are lost; prints one JSON object.

The cloud is synthetic (spheres and planes, snapped to voxels, in Morton order), its sizes are those of HAC++ scenes.
"""

import argparse
import json
import os
import resource
import time

import numpy as np

from splatwire.conceal import Concealer, create_concealer
from splatwire.model import AnchorScene, AttributePrior, Partial, Prior
from splatwire.ops.morton import morton_encode
from splatwire.paper import Gnn, GnnWeights
from splatwire.paper.gnn import GNN_PRESETS
from splatwire.paper.gnn.network import InpaintingNetwork, InputSizes
from splatwire.paper.gnn.weights import scene_fingerprint
from splatwire.scene import AnchorLayout, Anchors, Erasures

GOAL_SECONDS = {
    "drop": 5.0, "prior": 5.0, "idw": 5.0, "cari": 10.0, "grow": 5.0, "scene_free": 5.0,
    "kriging": 5.0, "gnn": 10.0, "gnn compact": 10.0,
}  # fmt: skip
GOAL_MEMORY_BYTES = 2 << 30


def surface_points(num_points: int, rng: np.random.Generator, num_surfaces: int = 20) -> np.ndarray:
    parts = []
    for number in range(num_surfaces):
        share = num_points // num_surfaces + (number < num_points % num_surfaces)
        if number % 2:
            points = rng.normal(size=(share, 3))
            points *= rng.uniform(0.2, 1.5) / np.linalg.norm(points, axis=1, keepdims=True)
        else:
            points = rng.random((share, 2)) @ rng.normal(size=(2, 3))
        parts.append(points + 2 * rng.normal(size=3) + 0.01 * rng.normal(size=points.shape))
    voxels = np.round(np.concatenate(parts) / 0.001).astype(np.int64)
    order = np.argsort(morton_encode(voxels - voxels.min(axis=0)), kind="stable")
    return (voxels[order] * 0.001).astype(np.float32)


def make_context(num_anchors: int, loss: float, seed: int) -> Partial:
    rng = np.random.default_rng(seed)
    layout = AnchorLayout()

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal((num_anchors, *shape), np.float32)

    def size(spread: float) -> np.ndarray:
        return np.exp(draw(6) * np.float32(spread)) * np.float32(0.02)

    known = rng.random(num_anchors) >= loss
    mask = (rng.random((num_anchors, 10)) < 0.2) & known[:, None]
    anchors = Anchors(
        positions=surface_points(num_anchors, rng),
        features=draw(50) * known[:, None],
        scalings=size(0.3) * known[:, None],
        offsets=draw(10, 3) * mask[:, :, None],
        mask=mask,
    )
    step = np.ones((num_anchors, 1), np.float32)
    prior = Prior(
        feature=AttributePrior(draw(50), np.abs(draw(50)) + np.float32(0.1), step),
        scaling=AttributePrior(size(0.1), np.abs(draw(6)) * np.float32(0.01) + np.float32(1e-3), step),
        offset=AttributePrior(draw(30), np.abs(draw(30)) + np.float32(0.1), step),
        context=draw(96),
    )
    scene = AnchorScene(anchors, heads=None, coding=None)  # no concealer looks at networks
    return Partial(scene, Erasures.of_anchors(known), {}, (prior, layout))


def concealer_for(name: str, context: Partial) -> Concealer:
    """A concealer; the GNN's weights are untrained, which takes the same time."""
    if not name.startswith("gnn"):
        return create_concealer(name)
    settings = GNN_PRESETS[name[4:] or "paper"]
    network = InpaintingNetwork(InputSizes(context[AnchorLayout], context[Prior].context.shape[1]), settings)
    return Gnn(GnnWeights(network.eval().requires_grad_(False), scene_fingerprint(context), {}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--anchors", type=int, default=400_000)
    parser.add_argument("--loss", type=float, default=0.2)
    parser.add_argument("--methods", nargs="*", default=list(GOAL_SECONDS))
    options = parser.parse_args()

    warm = make_context(2000, 0.2, seed=1)
    context = make_context(options.anchors, options.loss, seed=0)
    rows = []
    for name in options.methods:
        concealer_for(name, warm)(warm)  # compiles, imports
        concealer = concealer_for(name, context)
        start, cpu_start = time.perf_counter(), time.process_time()
        concealer(context)
        row = {"method": name, "seconds": round(time.perf_counter() - start, 2)}
        row["cpu_seconds"] = round(time.process_time() - cpu_start, 2)
        rows.append({**row, "goal_seconds": GOAL_SECONDS[name]})
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    report = {
        "num_anchors": options.anchors,
        "num_lost": context.erasures.num_lost,
        "cores": os.cpu_count(),
        "load_before": os.getloadavg()[0],
        "peak_memory_bytes": peak,
        "goal_memory_bytes": GOAL_MEMORY_BYTES,
        "rows": rows,
    }
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
