"""Charts of a report as SVG."""

import io
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from splatwire.channel import Bernoulli, GilbertElliott, parse_loss
from splatwire.channel.loss_models import UNIT_NAMES
from splatwire.evaluation.study.curves import Curve
from splatwire.evaluation.study.definition import Loss, common_word
from splatwire.evaluation.study.summary import Summary

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
def seeds_chart(shown: Sequence[Summary]) -> str | None:
    """Draws the PSNR of every method: one dot per seed, with mean and confidence interval.

    Args:
        shown: Results of the methods on one scene with one loss model (simulated loss of packets or datagrams).

    Returns:
        The chart as SVG text, or None if no method has a PSNR.
    """
    rows = [s for s in shown if s.figures.get("psnr") is not None]
    if not rows:
        return None
    figure = Figure(figsize=(8.6, 0.8 + 0.34 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    for i, s in enumerate(rows):
        estimate = s.figures["psnr"]
        assert estimate is not None
        color = PALETTE[i % len(PALETTE)]
        axes.plot(s.by_seed["psnr"], [i] * len(s.by_seed["psnr"]), "o", color=color, ms=4, alpha=0.45, mec="none")
        axes.errorbar(estimate.mean, i, xerr=estimate.half_width or 0, fmt="|", color=color, ms=13, mew=2.2, capsize=4)
        axes.annotate(
            f"{estimate.mean:.2f}", (estimate.mean, i), (0, 7), textcoords="offset points", ha="center", size=8
        )
    axes.set_yticks(range(len(rows)), [plain_label(s.row.label) for s in rows])
    axes.set_ylim(len(rows) - 0.4, -0.7)
    axes.set_xlabel("PSNR (dB): a dot per seed, mean, 95 % interval")
    axes.grid(axis="x", alpha=0.25)
    return svg(figure)


@rc_context(STYLE)
def views_chart(shown: Sequence[Summary], views: Sequence[str]) -> str | None:
    """Draws a line chart of PSNR by view, with one line per method: mean over the seeds, and range as a shaded band.

    Args:
        shown: Results of the methods on one scene with one loss model (simulated loss of packets or datagrams). Methods
            without a PSNR for each view are left out.
        views: Names of the views, in the order of the results.

    Returns:
        The chart as SVG text, or None if all methods are left out.
    """
    rows = [s for s in shown if s.figures.get("psnr") is not None and s.by_view]
    if not rows:
        return None
    figure = Figure(figsize=(8.6, 3.4), layout="constrained")
    axes = figure.add_subplot()
    for i, s in enumerate(rows):
        color, (low, high) = PALETTE[i % len(PALETTE)], s.view_range["psnr"]
        axes.plot(s.by_view["psnr"], "o-", color=color, ms=3, lw=1.2, label=plain_label(s.row.label))
        axes.fill_between(range(len(low)), low, high, color=color, alpha=0.12, lw=0)
    axes.set_xticks(range(len(views)), [plain_label(name[-14:]) for name in views], rotation=60, ha="right", fontsize=7)
    axes.set_ylabel("PSNR (dB), mean over seeds")
    axes.grid(axis="y", alpha=0.25)
    _legend_above(axes)
    return svg(figure)


@rc_context(STYLE)
def losses_chart(shown: Sequence[Summary], losses: Sequence[Loss]) -> str | None:
    """Draws PSNR against the loss rate, one line per method.

    Loss models that lose packets and loss models that lose datagrams have separate panels. A panel needs at least two
    loss models.

    Args:
        shown: Results of the methods on one scene.
        losses: Loss models of the evaluation.

    Returns:
        The chart as SVG text, or None if no panel has enough loss models.
    """
    units = [unit for unit in ("pak", "datagram") if sum(loss.unit == unit for loss in losses) > 1]
    if not units:
        return None
    figure = Figure(figsize=(8.6, 3.8), layout="constrained")
    panels = figure.subplots(1, len(units), squeeze=False, sharey=True)[0]
    for axes, unit in zip(panels, units, strict=True):
        own = [loss for loss in losses if loss.unit == unit]
        ticks, labels = _axis_positions(own)
        for i, key in enumerate(dict.fromkeys(s.row.key for s in shown if s.loss is not None)):
            points = [(p, s) for p, loss in zip(ticks, own, strict=True) for s in shown
                      if s.row.key == key and s.loss == loss and s.figures.get("psnr") is not None]  # fmt: skip
            means = [s.figures["psnr"].mean for _, s in points]  # type: ignore[union-attr]
            halves = [s.figures["psnr"].half_width or 0 for _, s in points]  # type: ignore[union-attr]
            label = plain_label(points[0][1].row.label if points else key)
            axes.errorbar([p for p, _ in points], means, yerr=halves, fmt="o-", ms=3, lw=1.2, capsize=2,
                          color=PALETTE[i % len(PALETTE)], label=label)  # fmt: skip
        axes.set_xticks(ticks, labels, rotation=60 if len(own) > 5 else 0, fontsize=7)
        axes.set_xlabel(f"loss per {UNIT_NAMES[unit]}")
        axes.grid(alpha=0.25)
    panels[0].set_ylabel("PSNR (dB)")
    _legend_above(panels[0])
    return svg(figure)


@rc_context(STYLE)
def scale_chart(summaries: Sequence[Summary], loss: Loss) -> str | None:
    """Draws each method's PSNR difference to the baseline against the number of elements of the scene.

    Args:
        summaries: Results of the methods on all scenes.
        loss: Loss model whose results are drawn.

    Returns:
        The chart as SVG text, or None if there are results for fewer than three scenes.
    """
    own = [s for s in summaries if s.loss == loss and s.delta.get("psnr") is not None and s.by_view]
    if len({s.scene for s in own}) < 3:
        return None
    figure = Figure(figsize=(8.6, 3.4), layout="constrained")
    axes = figure.add_subplot()
    for i, key in enumerate(dict.fromkeys(s.row.key for s in own)):
        line = _by_size(own, key)
        axes.errorbar([s.num_anchors for s in line], [s.delta["psnr"].mean for s in line],  # type: ignore[union-attr]
                      yerr=[s.delta["psnr"].half_width or 0 for s in line], fmt="o-", ms=4, lw=1.2, capsize=2,  # type: ignore[union-attr]
                      color=PALETTE[i % len(PALETTE)], label=plain_label(line[0].row.label))  # fmt: skip
    axes.axhline(0, color="#888", lw=0.8)
    axes.set_xscale("log")
    axes.set_xlabel(f"{common_word(s.elements for s in own)} of the scene")
    axes.set_ylabel("PSNR against the baseline (dB)")
    axes.grid(alpha=0.25)
    _legend_above(axes)
    return svg(figure)


@rc_context(STYLE)
def rate_chart(panel: Sequence[Curve]) -> str | None:
    """Draws rate-distortion curves of one scene with one loss model: PSNR against size.

    Args:
        panel: The curves; curves without points are left out.

    Returns:
        The chart as SVG text, or None if no curve has points.
    """
    lines = [(curve.name, curve.points) for curve in panel if curve.points]
    if not lines:
        return None
    figure = Figure(figsize=(8.6, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for i, (name, points) in enumerate(lines):
        sizes, values = [p.num_bytes / 1e6 for p in points], [p.quality for p in points]
        axes.plot(sizes, values, "o-", color=PALETTE[i % len(PALETTE)], ms=4, lw=1.2, label=plain_label(name))
    axes.set_xscale("log")
    axes.set_xlabel("size (MB, 10⁶ bytes)")
    axes.set_ylabel("PSNR (dB)")
    axes.grid(which="both", alpha=0.25)
    _legend_above(axes)
    return svg(figure)


@rc_context(STYLE)
def bytes_chart(streams: Mapping[str, Summary]) -> str:
    """Draws the size of each stream in bytes, divided into attributes and overhead, as a bar chart.

    Args:
        streams: Summary of each stream, by its label in the chart.

    Returns:
        The chart as SVG text.
    """
    figure = Figure(figsize=(8.6, 0.7 + 0.55 * len(streams)), layout="constrained")
    axes = figure.add_subplot()
    left = [0.0] * len(streams)
    parts = list(dict.fromkeys(part for summary in streams.values() for part in summary.parts))
    for i, part in enumerate(parts):
        widths = [summary.parts.get(part, 0) / 1e6 for summary in streams.values()]
        color = PALETTE[i % len(PALETTE)]
        names, label = [plain_label(name) for name in streams], plain_label(part.replace("_", " "))
        axes.barh(names, widths, left=left, color=color, height=0.6, label=label)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("size (MB, 10⁶ bytes)")
    axes.legend(ncols=5, fontsize=7.5, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.0))
    return svg(figure)


def _by_size(summaries: Sequence[Summary], key: str) -> list[Summary]:
    return sorted((s for s in summaries if s.row.key == key), key=lambda s: s.num_anchors)


def _axis_positions(losses: Sequence[Loss]) -> tuple[list[float], list[str]]:
    """Returns the horizontal position and the label of each loss model in a chart.

    Positions are loss rates in percent if all losses are independent (Bernoulli); otherwise they are equally spaced.
    """
    # Loss rates in percent if all losses are independent; otherwise equally spaced.
    models = [parse_loss(loss.model) for loss in losses]
    if all(isinstance(model, Bernoulli) for model in models):
        rates = [100 * float(model.rate) for model in models if isinstance(model, Bernoulli)]
        return rates, [f"{rate:g} %" for rate in rates]
    labels = [plain_label(_short(m, loss)) for m, loss in zip(models, losses, strict=True)]
    return [float(i) for i in range(len(losses))], labels


def _short(model: Any, loss: Loss) -> str:
    name = (
        f"{100 * model.rate:g} %, bursts of {model.mean_burst:g}" if isinstance(model, GilbertElliott) else loss.model
    )
    return name if loss.send_order == "interleaved" else f"{name}, {loss.send_order}"


def plain_label(text: str) -> str:
    """Converts a name to a label that matplotlib shows as it is: dollars start no formula, `_` hides no legend."""
    return f" {text}".replace("$", r"\$") if text.startswith("_") else text.replace("$", r"\$")


def _legend_above(axes: Any) -> None:
    axes.legend(ncols=3, fontsize=7.5, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.0), labelspacing=0.3)


def svg(figure: Figure) -> str:
    """Renders a figure as SVG text."""
    # Equal figures give equal text.
    buffer = io.StringIO()
    with warnings.catch_warnings():
        # texts are stored as texts, and the browser has glyphs that the font of matplotlib lacks
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
