"""First part of a report: summary sentence, image comparison, loss curve, and explanations of terms."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from splatwire.evaluation.pixels import jpeg
from splatwire.evaluation.study.charts import losses_chart
from splatwire.evaluation.study.curve import ComparedRows, compared_rows, curve_losses
from splatwire.evaluation.study.pictures import Shot, ViewPictures
from splatwire.evaluation.study.run import StudyResult
from splatwire.evaluation.study.summary import Summary, summarize
from splatwire.evaluation.study.tables import Table

TERMS = {
    "PSNR": "peak signal-to-noise ratio in decibels: higher is better, and 3 dB more is half of the squared error",
    "infinite": "PSNR if some pictures, but not all, equal their references",
    "SSIM": "structural similarity of two pictures: 1 for equal ones",
    "LPIPS": "perceptual distance of two pictures that a network has learned: 0 for equal ones",
    "LPIPS [0, 1]": "LPIPS of pictures in [0, 1], not scaled to [-1, 1]: the variant in the tables of 3DGS and HAC++",
    "packets lost": "share of the packets that did not arrive",
    "anchors hit": "share of the scene's anchors (groups of up to ten Gaussians) that lost something",
    "Gaussians hit": "share of the scene's Gaussians that were lost",
    "no loss": "everything arrived",
    "contiguous drop": "neighbours share a packet, and lost anchors are left out: holes",
    "drop": "lost elements are left out; neighbours are in different packets, so gaps are small",
    "grow": "what arrived is enlarged by what the loss uncovered",
    "scene_free": "as grow, with gains that a network chooses; the weights that ship were trained on a few captures",
    "sketch": "important lost elements come from a coarse copy in the stream (its bytes are counted), the rest grows",
    "coarse": "a coarser level of the scene takes the place of what is lost",
    "prior": "lost attributes are those that the side information predicts",
    "idw": "lost attributes are means of the neighbours, weighted by inverse distance",
    "cari": "the paper's interpolation between neighbours",
    "kriging": "lost attributes are conditional means given 16 neighbours",
    "gnn": "the paper's network fills lost attributes",
}
"""Glossary: explanations of names of columns and rows, and of words in cells."""


@dataclass(frozen=True)
class Side:
    """One image of the comparison slider.

    Attributes:
        label: Name of the method, and its PSNR.
        image: The image as a data URL.
    """

    label: str
    image: str


@dataclass(frozen=True)
class Lead:
    """First part of a report.

    Attributes:
        sentence: Summary of the result.
        left: Image without concealment, or of the baseline if no row leaves gaps; None if no pair of images is
            available.
        right: Image with the best concealment, or the reference image.
        caption: Description of the images: view and loss.
        curve: Chart of the PSNR against the loss rate, SVG; None if only one rate was measured.
        opens: Labels of the two methods that image comparisons show at first, left and right. If empty, the comparisons
            begin with the reference and the baseline.
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
    """Creates the first part of the report of one scene: summary sentence, image comparison and loss curve.

    Args:
        result: Results of the evaluation.
        pictures: Images of the views with the lowest PSNR.
        curve: Results of the same scene at other loss rates; None to omit the loss curve.
        worst: Images at the highest loss rate, shown instead of `pictures`; may be empty.

    Returns:
        The first part. None if the evaluation has several scenes or several losses, or if a PSNR in the summary is not
        finite.
    """
    if len(result.scenes) > 1 or len(result.study.losses) > 1:
        return None
    if not result.study.lossy_rows:
        return _lossless_lead(result, pictures)
    summaries = [s for s in summarize(result) if s.loss is not None]
    rows = compared_rows(result, summaries)
    drawn = None
    if curve is not None and rows is not None:
        keys = {row.key for row in rows}
        drawn = losses_chart(
            [s for s in (*summaries, *summarize(curve)) if s.row.key in keys], curve_losses(result, curve)
        )
    source = next(iter(result.scenes.values())).references.source
    sentence = _summary_sentence({s.row.key: s for s in summaries}, rows, source)
    view = next(iter(worst or pictures), None)
    if sentence is None:
        return None
    opens = () if rows is None else (rows.uncovered.label, rows.best.label)
    if view is None:
        return Lead(sentence, curve=drawn, opens=opens)
    left, right = _compared_images(view, rows)
    higher = "; a higher loss than in the sentence above shows the difference" if worst else ""
    return Lead(sentence, left, right, f"View {view.view}, {view.loss}{higher}.", drawn, opens)


def _lossless_lead(result: StudyResult, pictures: Sequence[ViewPictures]) -> Lead | None:
    """Creates the first part of the report for an evaluation of a single method without losses.

    Returns None for an evaluation of several methods, or if no PSNR was measured.
    """
    first_summary, *others = summarize(result)
    figure = first_summary.figures.get("psnr")
    if others or figure is None:
        return None
    source = next(iter(result.scenes.values())).references.source
    sentence = (
        f"Without loss, pictures are at {figure.mean:.1f} dB with {first_summary.num_bytes:,} bytes. PSNR is against "
        f"{source}; higher is better."
    )
    view = next(iter(pictures), None)
    left, right = (None, None) if view is None else _compared_images(view, None)
    return Lead(sentence, left, right, "" if view is None else f"View {view.view}.")


def _summary_sentence(summaries: dict[str, Summary], rows: ComparedRows | None, source: str) -> str | None:
    """Summarises in one sentence the PSNR of two methods under loss; None if a PSNR is not finite.

    Args:
        summaries: Statistics under the loss of the evaluation, by key of the method.
        rows: The methods; without one that leaves gaps, the baseline is compared with the best. None to state the PSNR
            of the only method.
        source: Kind of reference images, such as `photos`.
    """
    shown = [summaries[row.key] for row in (rows.uncovered, rows.best)] if rows else list(summaries.values())[:1]
    figures = [s.figures.get("psnr") for s in shown]
    if not shown or any(figure is None for figure in figures):
        return None
    means = [figure.mean for figure in figures if figure is not None]
    lost = f"With {percent_text(shown[0].lost_packets)} of the packets lost"
    if rows is None:
        return f"{lost}, pictures are at {means[0]:.1f} dB ({shown[0].row.label}; PSNR against {source})."
    more = shown[1].num_bytes / shown[0].num_bytes - 1
    cost = f" for {100 * more:.0f} % more bytes" if more >= 0.005 else ""
    first, best = (summary.row.label for summary in shown)
    if shown[0].row.conceal == "drop":
        ways = f"if the gaps stay ({first})", f"with concealment ({best})"
    else:
        ways = f"with {first}", f"with {best}"
    return (
        f"{lost}, pictures are at {means[0]:.1f} dB {ways[0]} and at {means[1]:.1f} dB {ways[1]}{cost}. "
        f"PSNR is against {source}; higher is better."
    )


def percent_text(share: float) -> str:
    """Formats a share in percent, with decimals if it is close to 0 % or 100 %."""
    percent = 100 * share
    if 1 <= percent <= 99 or percent in (0, 100):
        return f"{percent:.0f} %"
    return f"{percent:.2g} %" if percent < 1 else f"{percent:.1f} %" if percent <= 99.9 else "over 99.9 %"


def _compared_images(view: ViewPictures, rows: ComparedRows | None) -> tuple[Side | None, Side | None]:
    """Chooses the two images of a view that the report compares: one without concealment, one with the best concealer.

    Args:
        view: Images of the view.
        rows: Table rows without concealment (the baseline if no row leaves gaps) and with the best concealer; None if
            the evaluation has no such pair.
    """
    # If one of them is missing, the image with the lowest PSNR is compared with the reference.
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
    """Splits a table into rows that the report shows initially and rows that are collapsed.

    Args:
        table: The table.
        hidden: Rows to collapse, given by the text of their first cells.

    Returns:
        The table of the shown rows, and the table of the collapsed rows or None.
    """
    shown = tuple(row for row in table.rows if row[0] not in hidden)
    rest = tuple(row for row in table.rows if row[0] in hidden)
    if not rest or not shown:
        return table, None
    best = None if table.best is None or table.rows[table.best] not in shown else shown.index(table.rows[table.best])
    return replace(table, rows=shown, best=best), replace(table, rows=rest, best=None)


def rows_that_lose(result: StudyResult, summaries: Sequence[Summary]) -> set[str]:
    """Returns the labels of methods that are worse than the baseline on every scene and under every loss.

    Methods with another packetization than the baseline are not compared.

    Args:
        result: Results of the evaluation.
        summaries: Statistics of the results, with differences to the baseline.
    """
    # Only methods with the same packetization as the baseline are compared.
    if result.study.published or result.study.baseline is None:
        return set()
    packing = result.study.row(result.study.baseline).packetization
    deltas: dict[str, list[float]] = {}
    for s in summaries:
        if s.row.packetization == packing and (delta := s.delta.get("psnr")) is not None:
            deltas.setdefault(s.row.label, []).append(delta.mean)
    return {label for label, values in deltas.items() if max(values) < 0}


def terms_of(tables: Sequence[Table]) -> list[tuple[str, str]]:
    """Returns the technical terms that occur in tables of the report, each with its explanation.

    Args:
        tables: Tables of the report.
    """
    cells = (cell for table in tables for row in table.rows for cell in row)
    names = [*(name for table in tables for name in table.columns), *cells]
    return [(name, TERMS[name]) for name in dict.fromkeys(names) if name in TERMS]
