"""What an evaluation found: one run per method and seed, and the rows of its table."""

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatwire.evaluate.protocol import Method, Protocol

LPIPS_OF_MASKED = "both pictures black outside the masks, mean over the whole picture"
"""How LPIPS, whose features look far around, treats what does not count."""


@dataclass(frozen=True)
class Scores:
    """How near the pictures of one run are to the references, view by view.

    Attributes:
        psnr: Decibels; infinite where a picture equals its reference.
        ssim: Structural similarity.
        lpips: LPIPS of the views `lpips_views`; None if its weights are absent.
        lpips_views: Indices of the views that have LPIPS.
    """

    psnr: tuple[float, ...]
    ssim: tuple[float, ...]
    lpips: tuple[float, ...] | None
    lpips_views: tuple[int, ...] = ()


@dataclass(frozen=True)
class Run:
    """One method under one loss mask.

    Attributes:
        method: The method.
        seed: Seed of the mask; None without loss.
        scores: Its scores.
        seconds: Seconds by phase: `decode` (shared by the methods of one stream and seed), `conceal`, `render`.
        num_lost: Anchors lost.
        num_lost_packets: Packets lost.
        num_bytes_received: Bytes of the stream that arrived.
    """

    method: Method
    seed: int | None
    scores: Scores
    seconds: Mapping[str, float]
    num_lost: int
    num_lost_packets: int
    num_bytes_received: int


@dataclass(frozen=True, eq=False)
class Picture:
    """One view of one method, for the report.

    Attributes:
        view: Index of the view.
        method: Name of the row.
        pixels: RGB, uint8, H W 3.
        psnr: Decibels.
    """

    view: int
    method: str
    pixels: np.ndarray
    psnr: float


@dataclass(frozen=True, eq=False)
class LossMap:
    """Where anchors fall on a picture, and which of them were lost.

    Attributes:
        view: Index of the view.
        stream: Name of the stream.
        pixels: The map, RGB, uint8, H W 3.
    """

    view: int
    stream: str
    pixels: np.ndarray


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Everything that an evaluation found.

    Attributes:
        protocol: What was compared.
        runs: One per method and seed, in the order of the methods.
        view_names: Names of the views.
        reference: What the references are.
        stream_parts: Bytes by part, per stream.
        total_bytes: Bytes that each row needs, by its name: the stream with what its concealer reads and no more.
        num_anchors: Anchors of the complete scene.
        num_packets: Packets of the complete stream, per stream.
        references: Reference picture of each view of the pictures, uint8.
        pictures: Pictures of the hardest views under the first seed.
        loss_maps: Loss maps of the hardest view under the first seed.
        lpips_note: Why there is no LPIPS, or on which views it is; empty if it is on all.
        unit: What is lost as one.
        masked: Whether masks say which pixels count; pictures and figures know nothing of the others.
    """

    protocol: Protocol
    runs: tuple[Run, ...]
    view_names: tuple[str, ...]
    reference: str
    stream_parts: Mapping[str, Mapping[str, int]]
    total_bytes: Mapping[str, int]
    num_anchors: int
    num_packets: Mapping[str, int]
    references: Mapping[int, np.ndarray]
    pictures: tuple[Picture, ...]
    loss_maps: tuple[LossMap, ...]
    lpips_note: str
    unit: str
    masked: bool = False

    def rows(self) -> list[dict[str, Any]]:
        """The table: one row per method, means over views and then over seeds; plain numbers only.

        `psnr` is None where every picture equals its reference (`exact`), because infinity is not a number.
        """
        return [self._row(method) for method in self.protocol.methods]

    def runs_of(self, method: Method) -> list[Run]:
        """The runs of one method, one per seed."""
        return [run for run in self.runs if run.method == method]

    def _row(self, method: Method) -> dict[str, Any]:
        runs = self.runs_of(method)
        psnr = [statistics.fmean(run.scores.psnr) for run in runs]
        lpips = [statistics.fmean(run.scores.lpips) for run in runs if run.scores.lpips is not None]
        phases = {name: statistics.fmean(run.seconds[name] for run in runs) for name in runs[0].seconds}
        by_view = [statistics.fmean(values) for values in zip(*(run.scores.psnr for run in runs), strict=True)]
        return {
            "method": method.name,
            "psnr": finite(statistics.fmean(psnr)),
            "ssim": statistics.fmean(statistics.fmean(run.scores.ssim) for run in runs),
            "lpips": statistics.fmean(lpips) if lpips else None,
            "seconds": sum(phases.values()),
            "num_bytes": self.total_bytes[method.name],
            "exact": all(math.isinf(value) for run in runs for value in run.scores.psnr),
            "concealer": None if method.lossless else method.concealer,
            "stream": method.stream,
            "num_lost": statistics.fmean(run.num_lost for run in runs),
            "num_lost_packets": statistics.fmean(run.num_lost_packets for run in runs),
            "num_bytes_received": statistics.fmean(run.num_bytes_received for run in runs),
            "seconds_by_phase": phases,
            "psnr_by_seed": [finite(value) for value in psnr],
            "psnr_spread": statistics.stdev(psnr) if len(psnr) > 1 and all(map(math.isfinite, psnr)) else None,
            "psnr_by_view": [finite(value) for value in by_view],
            "parts": dict(self.stream_parts[method.stream]),
        }

    def to_json(self) -> dict[str, Any]:
        """The whole result without its pictures, ready for `json.dumps`."""
        return {
            "rows": self.rows(),
            "loss": self.protocol.loss.name,
            "unit": self.unit,
            "seeds": list(self.protocol.seeds),
            "send_order": self.protocol.send_order,
            "renderer": self.protocol.renderer,
            "reference": self.reference,
            "masked": self.masked,
            "views": list(self.view_names),
            "num_anchors": self.num_anchors,
            "num_packets": dict(self.num_packets),
            "lpips": self.lpips_note or "computed on every view",
        }


def finite(value: float) -> float | None:
    """The number itself, or None where it is infinite."""
    return value if math.isfinite(value) else None
