"""Report of a sequence evaluation: quality per frame as table, chart and player, in one self-contained HTML file."""

import base64
import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from splatwire.evaluation.sequence.evaluation import SequenceScore
from splatwire.evaluation.study.charts import PALETTE, STYLE, plain_label, svg
from splatwire.evaluation.study.page import filled_page
from splatwire.types.sequence_scene import Timeline

HEADINGS = ("method", "loss", "PSNR dB", "below complete", "worst below", "first group dB", "flicker", "packets lost")


class PlayerPictures:
    """Pictures of one view of a sequence for the player in the HTML report, by experiment and frame.

    Args:
        num_rows: Number of experiments, without the reference.
    """

    def __init__(self, num_rows: int) -> None:
        self.pictures: list[list[str]] = [[] for _ in range(num_rows + 1)]

    def add(self, row: int, frame: int, pixels: np.ndarray) -> None:
        """Adds the next frame's picture, either of an experiment or of the reference.

        Args:
            row: Index of the experiment, from 0; -1 for the reference.
            frame: Index of the frame; frames must be added in order.
            pixels: RGB image, uint8 (H, W, 3).
        """
        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, "WEBP", quality=80, method=2)
        self.pictures[row + 1].append("data:image/webp;base64," + base64.b64encode(buffer.getvalue()).decode("ascii"))


def score_rows(scores: Sequence[SequenceScore]) -> list[dict[str, Any]]:
    """Converts the scores of experiments to table rows.

    Args:
        scores: The scores. The first one is for the sequence without losses; the others are compared with it.
    """
    complete = scores[0]
    return [
        {
            "method": score.row.concealer if score.num_lost else "complete",
            "loss": score.row.loss_label or None,
            "seed": score.row.seed,
            "psnr": score.mean,
            "below_complete": score.mean_below(complete),
            "worst_below": score.worst_below(complete),
            "first_group_psnr": float(score.psnr[: score.later or None].mean()),
            "flicker": score.flicker / complete.flicker if complete.flicker else None,
            "num_lost_packets": score.num_lost,
            "frames": score.psnr.tolist(),
        }
        for score in scores
    ]


def cells(row: dict[str, Any]) -> list[str]:
    """Formats a table row of `score_rows` as cell texts, in the order of `HEADINGS`."""
    flicker = "-" if row["flicker"] is None else f"{row['flicker']:.2f}"
    numbers = [f"{row[name]:.2f}" for name in ("psnr", "below_complete", "worst_below", "first_group_psnr")]
    return [row["method"], row["loss"] or "none", *numbers, flicker, f"{row['num_lost_packets']:,}"]


def render_sequence_report(
    title: str, subtitle: str, timeline: Timeline, scores: Sequence[SequenceScore], player_pictures: PlayerPictures
) -> str:
    """Renders the report of a sequence evaluation as HTML.

    Args:
        title: Headline.
        subtitle: Description of the comparison.
        timeline: Frame rate and groups of pictures.
        scores: Scores of the experiments, the complete sequence first.
        player_pictures: Pictures of the reference and of each experiment.
    """
    rows = score_rows(scores)
    labels = ["reference", *(", ".join(filter(None, (row["method"], row["loss"]))) for row in rows)]
    players = [
        {"label": label, "pictures": pictures, "psnr": [] if number == 0 else rows[number - 1]["frames"]}
        for number, (label, pictures) in enumerate(zip(labels, player_pictures.pictures, strict=True))
    ]
    return filled_page(
        "splatwire.evaluation.sequence", "report.html.jinja", title=title, subtitle=subtitle, columns=HEADINGS,
        rows=[cells(row) for row in rows], chart=_chart(scores, labels[1:]), num_frames=timeline.num_frames,
        rate=float(timeline.rate), players=players, players_json=json.dumps(players).replace("<", "\\u003c"),
    )  # fmt: skip


@rc_context(STYLE)
def _chart(scores: Sequence[SequenceScore], labels: Sequence[str]) -> str:
    """Draws PSNR per frame, one line per experiment; vertical lines separate groups of pictures.

    Args:
        scores: Result of each experiment.
        labels: Label of each experiment.

    Returns:
        The chart as SVG text.
    """
    figure = Figure(figsize=(8.6, 3.6), layout="constrained")
    axes = figure.add_subplot()
    for number, (score, label) in enumerate(zip(scores, labels, strict=True)):
        axes.plot(score.psnr, "-", color=PALETTE[number % len(PALETTE)], lw=1.4, label=plain_label(label))
    later = scores[0].later
    for begin in range(later, len(scores[0].psnr), later) if later else ():
        axes.axvline(begin - 0.5, color="#dfe4ea", lw=0.8, zorder=0)
    axes.set_xlabel("frame")
    axes.set_ylabel("PSNR (dB)")
    axes.legend(fontsize=7, frameon=False, ncol=3, loc="upper center", bbox_to_anchor=(0.5, 1.22))
    return svg(figure)
