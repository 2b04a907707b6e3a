"""Head of a report: one sentence, two pictures under one slider, quality over loss, and the words of its tables."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from splatwire.evaluate.pixels import jpeg
from splatwire.evaluate.study.charts import losses_chart
from splatwire.evaluate.study.curve import ComparedRows, compared_rows, curve_losses
from splatwire.evaluate.study.definition import Loss
from splatwire.evaluate.study.pictures import Shot, ViewPictures
from splatwire.evaluate.study.run import StudyResult
from splatwire.evaluate.study.summary import Summary, summarize
from splatwire.evaluate.study.tables import Table

TERMS = {
    "PSNR": "peak signal-to-noise ratio in decibels: higher is better, and 3 dB more is half of the squared error",
    "SSIM": "structural similarity of two pictures: 1 for equal ones",
    "LPIPS": "perceptual distance of two pictures that a network has learned: 0 for equal ones",
    "packets lost": "share of the packets that did not arrive",
    "anchors hit": "share of the scene's anchors (groups of up to ten Gaussians) that lost something",
    "Gaussians hit": "share of the scene's Gaussians that were lost",
    "no loss": "everything arrived",
    "contiguous drop": "neighbours share a packet, and lost anchors are left out: holes",
    "drop": "lost elements are left out; neighbours are in different packets, so gaps are small",
    "grow": "what arrived is enlarged by what the loss uncovered",
    "scene_free": "as grow, with gains that a network chooses; it was trained on other scenes",
    "sketch": "important lost elements come from a coarse copy in the stream (its bytes are counted), the rest grows",
    "coarse": "a coarser level of the scene takes the place of what is lost",
    "prior": "lost attributes are those that the side information predicts",
    "idw": "lost attributes are means of the neighbours, weighted by inverse distance",
    "cari": "the paper's interpolation between neighbours",
    "kriging": "lost attributes are conditional means given 16 neighbours",
    "gnn": "the paper's network fills lost attributes",
}
"""Meaning of columns and rows."""


@dataclass(frozen=True)
class Side:
    """One picture under the slider.

    Attributes:
        label: Row and PSNR.
        image: The picture as a data URL.
    """

    label: str
    image: str


@dataclass(frozen=True)
class Lead:
    """Head of a report.

    Attributes:
        sentence: The result in one sentence.
        left: Picture without concealment; None where there are no two pictures.
        right: Picture with the best concealment, or the reference.
        caption: View and loss of the pictures.
        curve: PSNR over the loss rate, SVG; None where only one rate was measured.
        opens: Labels of the rows that comparisons of views open on; empty for the reference and the baseline.
    """

    sentence: str
    left: Side | None = None
    right: Side | None = None
    caption: str = ""
    curve: str | None = None
    opens: tuple[str, ...] = ()


def make_lead(
    result: StudyResult, pictures: Sequence[ViewPictures], curve: StudyResult | None, worst: Sequence[ViewPictures]
) -> Lead | None:
    """Makes the head of the report of one scene.

    Args:
        result: The evaluation.
        pictures: Pictures of its hardest views.
        curve: The same scene at other loss rates; None if there are none.
        worst: Pictures at the worst of these.

    Returns:
        The head; None for evaluations of several scenes or losses, or without losses.
    """
    if len(result.scenes) > 1 or len(result.study.losses) > 1 or not result.study.lossy_rows:
        return None
    summaries = [s for s in summarize(result) if s.loss is not None]
    rows = compared_rows(result, summaries)
    drawn = None
    if curve is not None and rows is not None:
        keys = {row.key for row in rows}
        summaries = [s for s in (*summaries, *summarize(curve)) if s.row.key in keys]
        drawn = losses_chart(summaries, curve_losses(result, curve))
    worst_loss = max((s.loss for s in summaries if s.loss), key=_rate, default=None)
    at_worst = {s.row.key: s for s in summaries if s.loss == worst_loss}
    source = next(iter(result.scenes.values())).references.source
    sentence = _sentence(at_worst, rows, source)
    view = next(iter(worst or pictures), None)
    if sentence is None:
        return None
    opens = () if rows is None else (rows.uncovered.label, rows.best.label)
    if view is None:
        return Lead(sentence, curve=drawn, opens=opens)
    left, right = _sides(view, rows)
    return Lead(sentence, left, right, f"View {view.view}, {view.loss}.", drawn, opens)


def _rate(loss: Loss) -> float:
    return float(getattr(loss.process, "rate", 0.0))


def _sentence(found: dict[str, Summary], rows: ComparedRows | None, source: str) -> str | None:
    """The result in one sentence; None without a finite figure."""
    shown = [found[row.key] for row in (rows.uncovered, rows.best)] if rows else list(found.values())[:1]
    figures = [s.figures.get("psnr") for s in shown]
    if not shown or any(figure is None for figure in figures):
        return None
    means = [figure.mean for figure in figures if figure is not None]
    lost = f"With {100 * shown[0].lost_packets:.0f} % of the packets lost"
    if rows is None:
        return f"{lost}, pictures are at {means[0]:.1f} dB ({shown[0].row.label}; PSNR against {source})."
    more = shown[1].num_bytes / shown[0].num_bytes - 1
    cost = f" for {100 * more:.0f} % more bytes" if more >= 0.005 else ""
    return (
        f"{lost}, pictures are at {means[0]:.1f} dB if the gaps stay ({shown[0].row.label}) and at {means[1]:.1f} dB "
        f"with concealment ({shown[1].row.label}){cost}. PSNR is against {source}; higher is better."
    )


def _sides(view: ViewPictures, rows: ComparedRows | None) -> tuple[Side | None, Side | None]:
    """The two pictures that differ most: without concealment and with the best, or the reference."""
    shots = {shot.label: shot for shot in view.shots}
    reference = Side(f"reference ({view.source})", jpeg(view.reference))
    if rows is not None and {rows.uncovered.label, rows.best.label} <= set(shots):
        return _side(shots[rows.uncovered.label]), _side(shots[rows.best.label])
    lossy = [shot for shot in view.shots if shot.psnr is not None]
    return (_side(min(lossy, key=lambda shot: shot.psnr or 0.0)), reference) if lossy else (None, None)


def _side(shot: Shot) -> Side:
    psnr = "" if shot.psnr is None else f": {shot.psnr:.1f} dB"
    return Side(f"{shot.label}{psnr}", jpeg(shot.pixels))


def fold(table: Table, hidden: set[str]) -> tuple[Table, Table | None]:
    """Splits a table into the rows that are shown at once and those below a fold.

    Args:
        table: The table.
        hidden: First cells of rows below the fold.

    Returns:
        Both tables; None for the second if it has no row.
    """
    shown = tuple(row for row in table.rows if row[0] not in hidden)
    rest = tuple(row for row in table.rows if row[0] in hidden)
    if not rest or not shown:
        return table, None
    best = None if table.best is None or table.rows[table.best] not in shown else shown.index(table.rows[table.best])
    return replace(table, rows=shown, best=best), replace(table, rows=rest, best=None)


def rows_that_lose(result: StudyResult, summaries: Sequence[Summary]) -> set[str]:
    """Labels of rows in the baseline's packets with a lower PSNR than the baseline everywhere."""
    if result.study.published or result.study.baseline is None:
        return set()
    packing = result.study.row(result.study.baseline).packetization
    deltas: dict[str, list[float]] = {}
    for s in summaries:
        if s.row.packetization == packing and (delta := s.delta.get("psnr")) is not None:
            deltas.setdefault(s.row.label, []).append(delta.mean)
    return {label for label, values in deltas.items() if max(values) < 0}


def terms_of(tables: Sequence[Table]) -> list[tuple[str, str]]:
    """Returns the entries of `TERMS` for the columns and rows of tables."""
    names = [*(name for table in tables for name in table.columns), *(row[0] for table in tables for row in table.rows)]
    return [(name, TERMS[name]) for name in dict.fromkeys(names) if name in TERMS]
