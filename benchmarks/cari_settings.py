"""Search for settings with which CARI beats omitting lost anchors, as the paper reports.

    python benchmarks/cari_settings.py scene.swz cameras.json [-o FILE] [--views 5] [--masks 2] [--rate 0.2]

`.pak` packets are lost. The rows vary CARI's settings, the interpolated attributes (an oracle gives the others), and
the treatment of lost anchors in the row "none". PSNR is against the lossless render, mean over masks and views. Every
row has the same masks.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from figures import publish

from splatwire.bitstream import read_stream
from splatwire.calibration.pseudo_loss import calibration_data
from splatwire.codec import decode_stream
from splatwire.concealment import create_concealer
from splatwire.concealment.conceal import conceal
from splatwire.data import load_cameras
from splatwire.evaluation.views import spread
from splatwire.metrics import psnr
from splatwire.render import render_scene
from splatwire.types import Anchors, AnchorScene, ReceivedScene

SETTINGS: dict[str, dict[str, Any]] = {
    "paper": {},
    "1 pass": {"passes": 1},
    "4 passes": {"passes": 4},
    "ridge 0.01": {"ridge": 0.01},
    "ridge 1": {"ridge": 1.0},
    "L 32": {"candidates": 32},
    "L 512": {"candidates": 512},
    "K 2": {"neighbors": 2},
    "K 32": {"neighbors": 32},
    "beta 0": {"context_exponent": 0.0},
    "gamma 0": {"uncertainty_exponent": 0.0},
    "delta 0": {"signature_exponent": 0.0},
    "alpha 3": {"distance_exponent": 3.0},
}
"""Options of CARI that differ from the paper's."""
KEPT: dict[str, tuple[str, ...]] = {
    "features": ("scalings", "offsets", "mask"),
    "features and sizes": ("offsets", "mask"),
    "features, sizes, offsets": ("mask",),
}
"""Interpolated attributes, and unchanged ones."""


def mixed(truth: Anchors, filled: Anchors, kept: tuple[str, ...]) -> Anchors:
    """Concealed anchors with the true values of some attributes."""
    anchors = replace(filled, **{name: getattr(truth, name) for name in kept})
    return replace(anchors, offsets=anchors.offsets * anchors.mask[:, :, None])


def fillings(complete: ReceivedScene, context: ReceivedScene) -> dict[str, Callable[[], AnchorScene]]:
    """Yields one row for each setting, with the scene that it draws after a loss."""
    truth, received = complete.scene.anchors, context.scene.anchors
    lossy = replace(context, scene=complete.scene.with_elements(received))

    def scene(anchors: Anchors) -> AnchorScene:
        return replace(complete.scene, anchors=anchors)

    def filled(name: str, **options: Any) -> Anchors:
        anchors: Anchors = create_concealer(name, **options)(context).elements
        return anchors

    rows: dict[str, Callable[[], AnchorScene]] = {
        "none: not drawn": lambda: conceal(lossy, create_concealer("drop")),
        "none: features zero, geometry true": lambda: scene(mixed(truth, received, ("scalings", "offsets", "mask"))),
        "none: features zero, sizes of the prior, every offset": lambda: scene(
            replace(filled("prior"), features=received.features)
        ),
        "none: the prior's mean": lambda: scene(filled("prior")),
        "none: the prior's features, geometry true": lambda: scene(mixed(truth, filled("prior"), KEPT["features"])),
        "idw": lambda: scene(filled("idw")),
        "grow": lambda: conceal(lossy, create_concealer("grow")),
    }
    rows |= {
        f"cari: {name}": (lambda options=options: scene(filled("cari", **options)))
        for name, options in SETTINGS.items()
    }
    for attribute, kept in KEPT.items():
        for name in ("cari", "idw"):
            rows[f"{name}: {attribute} alone, the rest true"] = lambda name=name, kept=kept: scene(
                mixed(truth, filled(name), kept)
            )
    absolute = create_concealer("kriging", target="absolute")
    rows["kriging: absolute values"] = lambda: scene(absolute(context).elements)
    rows["kriging: residuals to the prior"] = lambda: scene(filled("kriging"))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", type=Path)
    parser.add_argument("cameras", type=Path)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--masks", type=int, default=2)
    parser.add_argument("--rate", type=float, default=0.2)
    options = parser.parse_args()
    stream, _ = read_stream(options.stream)
    complete, cameras = decode_stream(stream), load_cameras(options.cameras)
    seen = cameras.select(spread(cameras.num_views, options.views))
    data = calibration_data(stream, complete)
    references = render_scene(complete.scene, seen)
    scores: dict[str, list[float]] = {}
    for known in data.pseudo_losses([options.rate] * options.masks, 0):
        context = data.complete.masked(known)
        for name, make in fillings(complete, context).items():
            pictures = render_scene(make(), seen)
            each = [float(psnr(a[None], b[None])[0]) for a, b in zip(pictures, references, strict=True)]
            scores.setdefault(name, []).append(float(np.mean(each)))
            print(f"{name:<60} {scores[name][-1]:.2f}", flush=True)
    rows = {name: round(sum(values) / len(values), 2) for name, values in scores.items()}
    result = {"scene": options.stream.stem, "anchors": data.complete.scene.anchors.num_anchors, "rate": options.rate,
              "views": seen.num_views, "masks": options.masks, "psnr": rows}  # fmt: skip
    publish(result, options.output)


if __name__ == "__main__":
    main()
