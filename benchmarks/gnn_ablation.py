"""What each part of the inpainting network is worth: short calibrations of one scene that share their pseudo-losses.

Each row is calibrated for the same few hundred steps and scored on the same held-out losses: errors by attribute (RMSE
over spread on lost anchors, mask: share of wrong entries), PSNR of some views against the lossless render on the first
loss, and the bytes that its weights take in the stream. Prints one JSON object; a results file is extended by the rows
that it does not have yet.
"""

import argparse
import json
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from splatwire.calibrate.pseudo_loss import CalibrationData, calibration_data
from splatwire.codec import decode_stream
from splatwire.conceal import create_concealer
from splatwire.conceal.conceal import conceal
from splatwire.data import load_cameras
from splatwire.evaluate.views import spread
from splatwire.metrics import psnr
from splatwire.model import Partial
from splatwire.model.tensors import to_tensors
from splatwire.packets import read_stream
from splatwire.paper import Gnn, GnnSettings
from splatwire.paper.calibration.calibrate import calibrate
from splatwire.paper.calibration.config import CALIBRATION_PRESETS, CalibrationConfig
from splatwire.paper.calibration.losses import LOSS_PRESETS, channel_spread, normalized_errors
from splatwire.paper.calibration.run import pseudo_graphs
from splatwire.paper.gnn import GNN_PRESETS, write_section
from splatwire.paper.gnn.graph import RepairGraph
from splatwire.render import render_scene

PAPER, ON = GNN_PRESETS["paper"], "interpolation"
KRIGED = replace(PAPER, interpolation="kriging", baseline=ON)
FULL = replace(KRIGED, scaling_threshold=0.10, offset_threshold=0.10)
ROWS: dict[str, tuple[GnnSettings, str, int]] = {
    "paper": (PAPER, "feature", 0),
    "compact": (GNN_PRESETS["compact"], "feature", CALIBRATION_PRESETS["compact"].bits),
    "on kriging": (KRIGED, "feature", 0),
    "no cross-attention": (replace(PAPER, cross_attention=False), "feature", 0),
    "no confidence": (replace(PAPER, sharpness=0.0), "feature", 0),
    "k 8": (replace(PAPER, neighbors=8), "feature", 0),
    "k 16": (replace(PAPER, neighbors=16), "feature", 0),
    "hidden 32": (replace(PAPER, hidden=32), "feature", 0),
    "hidden 64": (replace(PAPER, hidden=64), "feature", 0),
    "every attribute": (GNN_PRESETS["full"], "full", 0),
    "on cari": (replace(PAPER, baseline=ON), "feature", 0),
    "on idw": (replace(PAPER, baseline=ON, interpolation="idw"), "feature", 0),
    "on kriging, every attribute": (FULL, "full", 0),
    "on kriging, hidden 32": (replace(KRIGED, hidden=32), "feature", 0),
    "on kriging, hidden 16": (replace(KRIGED, hidden=16), "feature", 0),
}
"""Settings, losses and bits by name; `paper` is the preset, others say what differs from it."""
BASELINES: dict[str, tuple[str, dict[str, str]]] = {
    **{name: (name, {}) for name in ("drop", "grow", "prior", "idw", "cari", "kriging")},
    "kriging, absolute": ("kriging", {"target": "absolute"}),
    "kriging, regression": ("kriging", {"target": "regression"}),
}


class Scorer:
    """Scores concealed scenes on the held-out losses."""

    def __init__(self, data: CalibrationData, complete: Partial, held_out: list[RepairGraph], cameras: Any) -> None:
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
            anchors = to_tensors(concealer(self.data.complete.without(known)).elements)
            lost = torch.from_numpy(np.flatnonzero(~known))
            rows.append(normalized_errors(anchors.select(lost), self.truth, self.spread, lost))
        return {name: round(sum(row[name] for row in rows) / len(rows), 4) for name in rows[0]}

    def psnr(self, concealer: Any) -> float:
        known = self.known[0]
        scene = conceal(self.complete.without(known), concealer)
        values = [float(psnr(self._draw(scene, view), picture)[0]) for view, picture in enumerate(self.references)]
        return round(sum(values) / len(values), 3)


def score_row(scorer: Scorer, result: Any, bits: int, stream_bytes: int) -> dict[str, Any]:
    concealer = Gnn(result.weights)
    size = len(write_section(result.weights, bits or 5)) if result.weights.improves else 0
    return {
        "errors": scorer.errors(concealer), "psnr": scorer.psnr(concealer), "improves": result.weights.improves,
        "section_bytes": size, "section_bits": bits or 5, "section_share": round(size / stream_bytes, 4),
        "iterations": result.iterations,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stream", type=Path)
    parser.add_argument("cameras", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--batch", type=int, default=512)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--rows", nargs="*", default=list(ROWS))
    options = parser.parse_args()

    stream, _ = read_stream(options.stream)
    complete = decode_stream(stream)
    data = calibration_data(stream, complete)
    cameras = load_cameras(options.cameras)
    cameras = cameras.select(spread(cameras.num_views, options.views))
    base = CalibrationConfig(
        iterations=options.steps, batch=options.batch, train_masks=4, validation_masks=2,
        validation_interval=max(1, options.steps // 4),
    )  # fmt: skip
    report: dict[str, Any] = json.loads(options.output.read_text()) if options.output.exists() else {}
    report |= {
        "scene": options.stream.stem,
        "stream_bytes": stream.num_bytes,
        "num_anchors": stream.manifest.num_elements,
    }
    report |= {
        "steps": options.steps,
        "batch": options.batch,
        "views": cameras.num_views,
        "threads": torch.get_num_threads(),
    }
    rows, graphs, scorer = report.setdefault("rows", {}), dict[str, list[RepairGraph]](), None
    for name in [*BASELINES, *options.rows]:
        if name in rows:
            continue
        settings, losses, bits = ROWS.get(name, (PAPER, "feature", 0))
        shared = f"{settings.interpolation}"
        if shared not in graphs:
            graphs[shared] = list(pseudo_graphs(data, replace(base, settings=settings)))
        scorer = scorer or Scorer(data, complete, graphs[shared][base.train_masks :], cameras)
        cpu = time.process_time()
        if name in BASELINES:
            concealer = create_concealer(BASELINES[name][0], **BASELINES[name][1])
            errors = {} if name in ("drop", "grow") else scorer.errors(concealer)
            rows[name] = {"errors": errors, "psnr": scorer.psnr(concealer), "section_bytes": 0}
        else:
            config = replace(base, settings=settings, losses=LOSS_PRESETS[losses], bits=bits)
            own = [replace(g, index=g.index[:, : settings.neighbors]) for g in graphs[shared]]
            rows[name] = score_row(scorer, calibrate(data, config, graphs=own), bits, stream.num_bytes)
        rows[name]["cpu_seconds"] = round(time.process_time() - cpu, 1)
        report["load"] = os.getloadavg()[0]
        options.output.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
