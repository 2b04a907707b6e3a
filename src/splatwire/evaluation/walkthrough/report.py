"""Report of the evaluation of a camera path: chart of PSNR over time, and images; one self-contained HTML file."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from splatwire.evaluation.pixels import jpeg
from splatwire.evaluation.study.charts import PALETTE, STYLE, svg
from splatwire.evaluation.study.page import filled_page
from splatwire.evaluation.walkthrough.evaluation import QualitySample

MAX_PICTURES = 24


class Pictures:
    """Images for the report, at a few times that are evenly spread over a camera path.

    Args:
        times: All times at which images are compared, seconds.
    """

    def __init__(self, times: Sequence[float]) -> None:
        step = -(-len(times) // MAX_PICTURES)
        self._wanted = set(times[::step])
        self.taken: list[tuple[float, str, str]] = []

    def add(self, seconds: float, shown: np.ndarray, reference: np.ndarray) -> None:
        """Adds a rendered image and its reference image, if the report shows this point in time.

        Args:
            seconds: Time since the request, seconds.
            shown: Rendered image, RGB, uint8 (H, W, 3).
            reference: Reference image, RGB, uint8 (H, W, 3).
        """
        if seconds in self._wanted:
            self.taken.append((seconds, jpeg(shown), jpeg(reference)))


def decibels_text(value: float) -> str:
    """Formats a PSNR with its unit, for display."""
    return f"{value:.2f} dB" if np.isfinite(value) else "equal"


def render_walk_report(
    title: str, subtitle: str, facts: Sequence[tuple[str, str]], moments: Sequence[QualitySample], pictures: Pictures
) -> str:
    """Renders the report of the image quality along a camera path as HTML.

    Args:
        title: Headline.
        subtitle: Description of the comparison.
        facts: Names and values for the table of results.
        moments: Image quality at each time.
        pictures: Images at a few times.
    """
    psnr = {moment.seconds: decibels_text(moment.psnr) for moment in moments}
    shown: list[dict[str, Any]] = [
        {"seconds": f"{seconds:g}", "psnr": psnr[seconds], "picture": picture, "reference": reference}
        for seconds, picture, reference in pictures.taken
    ]
    return filled_page(
        "splatwire.evaluation.walkthrough", "report.html.jinja",
        title=title, subtitle=subtitle, facts=facts, chart=_chart(moments), pictures=shown,
    )  # fmt: skip


@rc_context(STYLE)
def _chart(moments: Sequence[QualitySample]) -> str:
    """Draws PSNR and received bytes over time; returns the chart as SVG text."""
    figure = Figure(figsize=(8.6, 3.6), layout="constrained")
    axes = figure.add_subplot()
    seconds = [moment.seconds for moment in moments]
    axes.plot(
        seconds,
        [moment.complete_psnr for moment in moments],
        "--",
        color="#7a7a7a",
        lw=1,
        label="whole stream received",
    )
    axes.plot(seconds, [moment.psnr for moment in moments], "-", color=PALETTE[0], lw=1.6, label="shown")
    axes.set_xlabel("seconds since the request")
    axes.set_ylabel("PSNR (dB)")
    axes.grid(alpha=0.25)
    came = axes.twinx()
    came.plot(seconds, [moment.num_bytes / 1e6 for moment in moments], ":", color=PALETTE[4], lw=1.2, label="came")
    came.set_ylabel("came (MB, 10⁶ bytes)")
    figure.legend(ncols=3, fontsize=7.5, frameon=False, loc="outside upper left")
    return svg(figure)
