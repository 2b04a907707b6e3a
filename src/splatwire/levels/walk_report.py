"""The report of a walk: PSNR over time as a chart, and what was seen; one HTML file that fetches nothing."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from splatwire.evaluate.pixels import jpeg
from splatwire.evaluate.study.charts import PALETTE, STYLE, svg
from splatwire.evaluate.study.page import filled_page
from splatwire.levels.journey import Moment

MOST_PICTURES = 24


class Pictures:
    """Pictures of some moments, spread over a walk.

    Args:
        times: When pictures are compared, seconds.
    """

    def __init__(self, times: Sequence[float]) -> None:
        step = -(-len(times) // MOST_PICTURES)
        self._wanted = set(times[::step])
        self.taken: list[tuple[float, str, str]] = []

    def add(self, seconds: float, shown: np.ndarray, reference: np.ndarray) -> None:
        """Takes the picture of a moment and that of the reference, RGB, uint8, if it is one of them."""
        if seconds in self._wanted:
            self.taken.append((seconds, jpeg(shown), jpeg(reference)))


def decibels_text(value: float) -> str:
    """A PSNR for people."""
    return f"{value:.2f} dB" if np.isfinite(value) else "equal"


def render_walk_report(
    title: str, subtitle: str, facts: Sequence[tuple[str, str]], moments: Sequence[Moment], pictures: Pictures
) -> str:
    """Renders the report.

    Args:
        title: Headline.
        subtitle: What was compared.
        facts: Names and values of a table.
        moments: What was seen when.
        pictures: Some of them.
    """
    psnr = {moment.seconds: decibels_text(moment.psnr) for moment in moments}
    shown: list[dict[str, Any]] = [
        {"seconds": f"{seconds:g}", "psnr": psnr[seconds], "picture": picture, "reference": reference}
        for seconds, picture, reference in pictures.taken
    ]
    return filled_page(
        "splatwire.levels", "walk_report.html.jinja",
        title=title, subtitle=subtitle, facts=facts, chart=_chart(moments), pictures=shown,
    )  # fmt: skip


@rc_context(STYLE)
def _chart(moments: Sequence[Moment]) -> str:
    """PSNR and bytes over time."""
    figure = Figure(figsize=(8.6, 3.6), layout="constrained")
    axes = figure.add_subplot()
    seconds = [moment.seconds for moment in moments]
    axes.plot(
        seconds, [moment.complete_psnr for moment in moments], "--", color="#7a7a7a", lw=1, label="with everything"
    )
    axes.plot(seconds, [moment.psnr for moment in moments], "-", color=PALETTE[0], lw=1.6, label="shown")
    axes.set_xlabel("seconds since somebody asked for the scene")
    axes.set_ylabel("PSNR (dB)")
    axes.grid(alpha=0.25)
    came = axes.twinx()
    came.plot(seconds, [moment.num_bytes / 1e6 for moment in moments], ":", color=PALETTE[4], lw=1.2, label="came")
    came.set_ylabel("came (MB, 10⁶ bytes)")
    figure.legend(ncols=3, fontsize=7.5, frameon=False, loc="outside upper left")
    return svg(figure)
