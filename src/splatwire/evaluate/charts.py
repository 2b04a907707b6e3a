"""The charts of a report, as SVG text; no window system, no global state."""

import io
import math
from collections.abc import Sequence
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from splatwire.evaluate.results import Evaluation

PALETTE = ("#3b6ea5", "#c4493d", "#4d8a57", "#8a63a8", "#c08a2e", "#3f9aa3", "#7a7a7a", "#b0567f", "#5a5ad0")
STYLE: dict[str, Any] = {
    "svg.hashsalt": "splatwire",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


@rc_context(STYLE)
def psnr_by_view(evaluation: Evaluation) -> str:
    """Draws the PSNR of every view under every lossy method; the band is the range over seeds."""
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    axes = figure.add_subplot()
    names = evaluation.view_names
    for color, method in zip(_cycle(len(evaluation.protocol.methods)), evaluation.protocol.methods, strict=True):
        runs = evaluation.runs_of(method)
        columns = list(zip(*(run.scores.psnr for run in runs), strict=True))
        if not all(math.isfinite(value) for column in columns for value in column):
            continue
        axes.plot([sum(column) / len(column) for column in columns], "o-", color=color, ms=3, lw=1.2, label=method.name)
        if len(runs) > 1:
            low, high = [min(column) for column in columns], [max(column) for column in columns]
            axes.fill_between(range(len(columns)), low, high, color=color, alpha=0.12, lw=0)
    axes.set_xticks(range(len(names)), [name[-12:] for name in names], rotation=60, ha="right", fontsize=7)
    axes.set_ylabel("PSNR (dB)")
    axes.grid(axis="y", alpha=0.25)
    if axes.lines:
        axes.legend(ncols=4, fontsize=7.5, frameon=False, loc="upper left", bbox_to_anchor=(0, 1.22))
    return svg(figure)


@rc_context(STYLE)
def bytes_by_part(evaluation: Evaluation) -> str:
    """Draws where the bytes of each stream are."""
    streams = evaluation.stream_parts
    figure = Figure(figsize=(8.6, 0.7 + 0.55 * len(streams)), layout="constrained")
    axes = figure.add_subplot()
    labels = list(streams)
    left = [0.0] * len(labels)
    parts = list(dict.fromkeys(part for sizes in streams.values() for part in sizes))
    for color, part in zip(_cycle(len(parts)), parts, strict=True):
        widths = [streams[label].get(part, 0) / 1e6 for label in labels]
        axes.barh(labels, widths, left=left, color=color, height=0.6, label=part.replace("_", " "))
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("size (MB, 10⁶ bytes)")
    axes.legend(ncols=5, fontsize=7.5, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.0))
    return svg(figure)


def _cycle(count: int) -> Sequence[str]:
    return [PALETTE[index % len(PALETTE)] for index in range(count)]


def svg(figure: Figure) -> str:
    """The drawing as SVG text, the same for the same drawing."""
    buffer = io.StringIO()
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
