"""Rate-distortion curves of an evaluation, one per codec, scene and loss model."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

from splatwire.evaluation.rate_distortion import RatePoint, bd_quality, bd_rate
from splatwire.evaluation.study.definition import Study
from splatwire.evaluation.study.summary import Summary
from splatwire.evaluation.study.tables import Table


@dataclass(frozen=True)
class Curve:
    """A rate-distortion curve: results of one codec at several rates.

    Attributes:
        name: Name of the codec or setting.
        scene: Name of the scene, or description of the mean over scenes.
        loss: Label of the loss model (packets or datagrams lost in transfer), such as `bernoulli:0.1 per packet`; empty
            for results without loss.
        rows: Result at each rate, ascending by bytes.
    """

    name: str
    scene: str
    loss: str
    rows: tuple[Summary, ...]

    @property
    def points(self) -> list[RatePoint]:
        """Bytes and mean PSNR of each point of the curve."""
        pairs = [(row.num_bytes, row.figures.get("psnr")) for row in self.rows]
        return [RatePoint(size, estimate.mean) for size, estimate in pairs if estimate is not None]


def curves_of(study: Study, summaries: Sequence[Summary]) -> list[Curve]:
    """Returns all rate-distortion curves, sorted by scene, then by loss model, then by codec.

    Scenes are in the order of `summaries`, and codecs in the order of the study's rows.

    Args:
        study: Definition of the evaluation.
        summaries: Results of the evaluation; those that belong to no curve are skipped.
    """
    groups: dict[tuple[str, str, str], list[Summary]] = {}
    for s in summaries:
        if s.row.curve:
            groups.setdefault((s.scene, "" if s.loss is None else s.loss.label, s.row.curve), []).append(s)
    order = {name: i for i, name in enumerate(dict.fromkeys(row.curve for row in study.rows))}
    curves = [
        Curve(name, scene, loss, tuple(sorted(rows, key=lambda s: s.num_bytes)))
        for (scene, loss, name), rows in groups.items()
    ]
    scenes = {scene: i for i, scene in enumerate(dict.fromkeys(s.scene for s in summaries))}
    return sorted(curves, key=lambda curve: (scenes[curve.scene], curve.loss, order[curve.name]))


def panels(curves: Sequence[Curve]) -> list[list[Curve]]:
    """Groups rate-distortion curves into charts: one group for each pair of scene and loss model."""
    cases = dict.fromkeys((curve.scene, curve.loss) for curve in curves)
    return [[curve for curve in curves if (curve.scene, curve.loss) == case] for case in cases]


def title_of(panel: Sequence[Curve]) -> str:
    """Returns the headline of a chart: name of its scene, label of its loss model (if any), and the chart's topic.

    Args:
        panel: Rate-distortion curves of the chart, at least one; all have the same scene and loss model.
    """
    first = panel[0]
    return f"{first.scene}{f', {first.loss}' if first.loss else ''}: rate and distortion"


def bd_table(panel: Sequence[Curve]) -> Table | None:
    """Returns a table with BD-rate and BD-PSNR of each curve against the first curve; None for a single curve.

    Args:
        panel: Rate-distortion curves with the same scene and loss model.
    """
    if len(panel) < 2:
        return None
    first, rows = panel[0], []
    for curve in panel[1:]:
        rate, quality = bd_rate(first.points, curve.points), bd_quality(first.points, curve.points)
        fewer = "no common range" if rate is None else f"{100 * rate:+.1f} %"
        rows.append((curve.name, fewer, "" if quality is None else f"{quality:+.2f}", _range(curve)))
    columns = ("curve", f"BD-rate against {first.name}", "BD-PSNR (dB)", "bytes")
    return Table(title_of(panel), columns, ((first.name, "", "", _range(first)), *rows))


def _range(curve: Curve) -> str:
    sizes = [row.num_bytes for row in curve.rows]
    return f"{sizes[0]:,}" if len(sizes) == 1 else f"{sizes[0]:,} to {sizes[-1]:,}"


def curves_csv(curves: Sequence[Curve]) -> str:
    """Formats curves as CSV, one line per point."""
    metrics = list(dict.fromkeys(metric for curve in curves for row in curve.rows for metric in row.figures))
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["scene", "loss", "curve", "row", "num_bytes", *metrics])
    for curve in curves:
        for row in curve.rows:
            figures = [row.figures.get(metric) for metric in metrics]
            cells = ["" if e is None else f"{e.mean:.6f}" for e in figures]
            writer.writerow([curve.scene, curve.loss or "none", curve.name, row.row.label, row.num_bytes, *cells])
    return buffer.getvalue()
