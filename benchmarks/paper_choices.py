"""Effect of each open choice of the paper's network, by short calibrations of one scene.

    python benchmarks/paper_choices.py whole.swz cameras.json -o benchmarks/results/paper_choices.json [--steps 300]

Every row is the preset `paper` with one change; all have the same losses to learn from and the same held-out ones.
`error` is that of features on held-out losses over their spread, `psnr` that of 3 views against the lossless render
under the first of them. `trust` is no setting of the package. It adds the residual to CARI without a gate, in units of
CARI's error, and weights it by its smallness in these units.
"""

import argparse
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from splatwire.bitstream import read_stream
from splatwire.calibration.pseudo_loss import CalibrationData, calibration_data
from splatwire.codec import decode_stream
from splatwire.concealment.conceal import conceal
from splatwire.data import load_cameras
from splatwire.evaluation.views import spread
from splatwire.metrics import psnr
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper import Cari, Gnn, Idw, idw
from splatwire.paper.calibration.calibrate import calibrate
from splatwire.paper.calibration.config import CALIBRATION_PRESETS, CalibrationConfig
from splatwire.paper.calibration.losses import channel_spread, normalized_errors
from splatwire.paper.calibration.run import pseudo_graphs
from splatwire.paper.gnn import fusion
from splatwire.paper.gnn.graph import RepairGraph
from splatwire.paper.neighbors import TensorTree
from splatwire.render import render_scene
from splatwire.types import ReceivedScene

POOL = 72


class Scorer:
    """Scores concealed scenes on the held-out losses."""

    def __init__(
        self, data: CalibrationData, complete: ReceivedScene, held_out: list[RepairGraph], cameras: Any
    ) -> None:
        self.data, self.complete, self.cameras = data, complete, cameras
        self.truth = to_tensors(data.complete.scene.anchors)
        self.spread = channel_spread(self.truth)
        self.known = []
        for graph in held_out:
            known = np.ones(self.truth.num_anchors, np.bool_)
            known[graph.queries.numpy()] = False
            self.known.append(known)
        self.references = [self._draw(complete.scene, view) for view in range(cameras.num_views)]

    def _draw(self, scene: Any, view: int) -> np.ndarray:
        return render_scene(scene, self.cameras.select([view]))

    def errors(self, concealer: Any) -> dict[str, float]:
        rows = []
        for known in self.known:
            anchors = to_tensors(concealer(self.data.complete.masked(known)).elements)
            lost = torch.from_numpy(np.flatnonzero(~known))
            rows.append(normalized_errors(anchors.select(lost), self.truth, self.spread, lost))
        return {name: round(sum(row[name] for row in rows) / len(rows), 4) for name in rows[0]}

    def psnr(self, concealer: Any) -> float:
        known = self.known[0]
        scene = conceal(self.complete.masked(known), concealer)
        values = [float(psnr(self._draw(scene, view), picture)[0]) for view, picture in enumerate(self.references)]
        return round(sum(values) / len(values), 3)


class PooledSearch:
    """Neighbours by Mahalanobis distance among the nearest by Euclid only."""

    def __init__(self, points: torch.Tensor, sizes: torch.Tensor) -> None:
        self.points, self.sizes, self.tree = points, sizes, TensorTree(points)

    def query(self, queries: torch.Tensor, k: int) -> tuple[torch.Tensor, torch.Tensor]:
        near, _ = self.tree.query(queries, POOL)
        gap = torch.linalg.vector_norm((queries[:, None] - self.points[near]) / self.sizes[near], dim=2)
        distance, order = gap.topk(k, largest=False)
        return near.gather(1, order), distance


@contextmanager
def replaced(place: Any, name: str, value: Any) -> Iterator[None]:
    """Context manager that gives a name another value."""
    before = getattr(place, name)
    setattr(place, name, value)
    try:
        yield
    finally:
        setattr(place, name, before)


def trusting(error: torch.Tensor) -> Any:
    """Branch of the network that adds its residual to the interpolation, without a gate, in units of the error."""

    def branch(residual: Any, prior: Any, interpolated: Any, settings: Any) -> fusion.Branch:
        if interpolated.shape[1] != len(error):  # scalings and offsets stay with the interpolation
            return fusion.Branch(interpolated, interpolated, torch.zeros(len(interpolated), 1), prior)
        z = residual.clamp(-settings.clip, settings.clip)
        confidence = torch.exp(-settings.sharpness * z.abs().mean(dim=1, keepdim=True))
        return fusion.Branch(interpolated + z * error, interpolated, confidence, prior)

    return branch


def rows(base: CalibrationConfig, batch: int) -> dict[str, CalibrationConfig]:
    """Configurations by name."""
    paper, losses = base.settings, base.losses
    on_cari = replace(paper, baseline="interpolation")
    return {
        "paper": base,
        "24 of 72 by Euclid": base,
        "queries hold CARI": replace(base, settings=replace(paper, query_input="interpolation")),
        "means over queries": replace(base, losses=replace(losses, smooth=losses.smooth * batch)),
        "trust": replace(base, settings=on_cari),
        "on CARI, no gate": replace(base, settings=replace(on_cari, sharpness=0.0)),
        "on CARI": replace(base, settings=on_cari),
        "36 masks": replace(base, train_masks=36),
    }


def measure(
    name: str, config: CalibrationConfig, data: CalibrationData, scorer: Scorer, shared: list[Any]
) -> dict[str, Any]:
    """Calibrates and scores one row."""
    search = PooledSearch if name == "24 of 72 by Euclid" else idw.MahalanobisSearch
    with replaced(idw, "MahalanobisSearch", search):
        graphs = shared
        if search is PooledSearch or config.train_masks != len(shared) - config.validation_masks:
            graphs = list(pseudo_graphs(data, config))
        elif config.settings.query_input == "interpolation":
            graphs = [replace(graph, given=graph.interpolated) for graph in shared]
        branch = fusion._branch
        if name == "trust":
            truth = to_tensors(data.complete.scene.anchors)
            wrong = torch.cat([g.interpolated.features - truth.select(g.queries).features for g in graphs[:2]])
            branch = trusting(wrong.square().mean(dim=0).sqrt())
        with replaced(fusion, "_branch", branch):
            result = calibrate(data, config, graphs=graphs)
            return {
                "error": round(scorer.errors(Gnn(result.weights))["feature"], 4),
                "psnr": scorer.psnr(Gnn(result.weights)),
                "below_interpolation": result.errors["feature"] < result.reference["feature"],
            }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", type=Path)
    parser.add_argument("cameras", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=300)
    options = parser.parse_args()
    stream, _ = read_stream(options.stream)
    complete, cameras = decode_stream(stream), load_cameras(options.cameras)
    cameras = cameras.select(spread(cameras.num_views, 3))
    data = calibration_data(stream, complete)
    preset = CALIBRATION_PRESETS["paper"]
    base = replace(preset, iterations=options.steps, validation_interval=options.steps)
    shared = list(pseudo_graphs(data, base))
    scorer = Scorer(data, complete, shared[base.train_masks :], cameras)
    report: dict[str, Any] = {"scene": options.stream.stem, "steps": options.steps, "pool": pool_share(shared, data)}
    for name, other in (("cari", Cari()), ("idw", Idw())):
        report[name] = {"error": scorer.errors(other)["feature"], "psnr": scorer.psnr(other)}
    for name, config in rows(base, preset.batch).items():
        report[name] = measure(name, config, data, scorer, shared)
        options.output.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


def pool_share(graphs: list[Any], data: CalibrationData) -> float:
    """Share of the exact neighbours in one graph that are among the nearest by Euclidean distance."""
    graph, anchors = graphs[0], to_tensors(data.complete.scene.anchors)
    known = torch.ones(anchors.num_anchors, dtype=torch.bool)
    known[graph.queries] = False
    support = known.nonzero()[:, 0]
    search = PooledSearch(anchors.positions[support], anchors.scalings[support, :3])
    pooled = support[search.query(anchors.positions[graph.queries], graph.index.shape[1])[0]]
    return round(float((graph.index[:, :, None] == pooled[:, None]).any(dim=2).float().mean()), 3)


if __name__ == "__main__":
    main()
