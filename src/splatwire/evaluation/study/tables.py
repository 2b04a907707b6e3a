"""Result tables: one representation for Markdown, LaTeX, HTML and CSV."""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from splatwire.evaluation.study.definition import DEFAULT_METRICS, SIZE_METRICS, Loss, Published, Row, common_word
from splatwire.evaluation.study.masks import PacketLossRates
from splatwire.evaluation.study.run import StudyResult
from splatwire.evaluation.study.summary import Estimate, Ordering, Summary
from splatwire.metrics.registry import METRICS, PUBLISHED_LPIPS

SKIPPED = "did not run"
"""Cell text for a method that was not evaluated on a scene."""
_LEADERBOARD = ("Submethod", "PSNR", "SSIM", "LPIPS", "Size [Bytes]", "#Gaussians")


@dataclass(frozen=True)
class Table:
    """A table of formatted text.

    Attributes:
        title: Headline.
        columns: Column headings; the first column is left-aligned.
        rows: Cells of each row.
        best: Index of the row whose name and first value are bold; None for no bold row.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: int | None = None

    def markdown(self) -> str:
        """Formats the table as Markdown."""
        lines = [f"### {_markdown_line(self.title)}", "", _markdown_row(self.columns)]
        lines.append("|" + "|".join(["---", *["---:"] * (len(self.columns) - 1)]) + "|")
        for index, row in enumerate(self.rows):
            cells = [f"**{cell}**" if index == self.best and i <= 1 else cell for i, cell in enumerate(row)]
            lines.append(_markdown_row(cells))
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        """Formats the table as LaTeX (package booktabs)."""
        head = " & ".join(_tex(name) for name in self.columns)
        lines = [r"\begin{table}", r"\centering", rf"\caption{{{_tex(self.title)}}}"]
        lines += [rf"\begin{{tabular}}{{l{'r' * (len(self.columns) - 1)}}}", r"\toprule", rf"{head} \\", r"\midrule"]
        for index, row in enumerate(self.rows):
            cells = [_tex(cell) for cell in row]
            if index == self.best:
                cells[:2] = [rf"\textbf{{{cell}}}" for cell in cells[:2]]
            lines.append(" & ".join(cells) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}"]) + "\n"


def result_tables(result: StudyResult, summaries: Sequence[Summary]) -> list[Table]:
    """Returns one table of results for each pair of scene and loss model.

    Methods that are evaluated without losses are listed in every table of their scene, for comparison.

    Args:
        result: The evaluation, with the methods that were skipped.
        summaries: Mean scores, one per scene, method and loss model.
    """
    study, tables = result.study, []
    for scene in dict.fromkeys(s.scene for s in summaries):
        for loss in study.losses:
            shown = [s for s in summaries if s.scene == scene and (s.loss in (None, loss))]
            shown.sort(key=lambda s: [row.key for row in study.rows].index(s.row.key))
            if shown:
                table = _result_table(f"{scene}, {loss.label}", shown, study.published, study.baseline)
                tables.append(_with_skipped(table, [study.row(key) for key in result.skipped_rows.get(scene, ())]))
    return tables


def _with_skipped(table: Table, rows: Sequence[Row]) -> Table:
    """Appends a table row without values for each method that was not evaluated.

    Args:
        table: Table of results.
        rows: The methods that were not evaluated.
    """
    empty = ("",) * (len(table.columns) - 2)
    return replace(table, rows=(*table.rows, *((row.label, SKIPPED, *empty) for row in rows)))


def _result_table(title: str, shown: Sequence[Summary], published: Sequence[Published], baseline: str | None) -> Table:
    metrics = measured(shown)
    datasets = list(dict.fromkeys(p.dataset for p in published))
    paper = {(p.row, p.dataset): p.values for p in published}
    columns = ["row", *(METRICS[m].label for m in metrics)]
    if baseline:
        columns.append(f"PSNR against {baseline}")
    columns += [
        "packets lost",
        f"{common_word(s.elements for s in shown if not s.row.decoded)} hit",
        "bytes",
        *(f"paper: {name}" for name in datasets),
    ]
    rows = []
    for s in shown:
        cells = [s.row.label, *(_figure(s, metric) for metric in metrics)]
        if baseline:
            cells.append(signed(s.delta.get("psnr")))
        cells += [_percent(s, s.lost_packets), _percent(s, s.lost_anchors), f"{s.num_bytes:,}"]
        cells += [_paper(paper.get((s.row.key, name))) for name in datasets]
        rows.append(tuple(cells))
    return Table(title, tuple(columns), tuple(rows), _best(shown))


def measured(summaries: Sequence[Summary]) -> list[str]:
    """Returns the names of all metrics that the summaries contain, built-in metrics first."""
    metrics = dict.fromkeys(metric for s in summaries for metric in s.figures)
    return [*(m for m in DEFAULT_METRICS if m in metrics), *(m for m in metrics if m not in DEFAULT_METRICS)]


def _best(shown: Sequence[Summary]) -> int | None:
    """Returns the index of the method with the highest PSNR; None if fewer than two methods have a PSNR.

    Methods that are evaluated without packet losses are excluded.
    """
    scores = {i: e.mean for i, s in enumerate(shown) if not s.row.lossless and (e := s.figures.get("psnr")) is not None}
    return max(scores, key=lambda i: scores[i]) if len(scores) > 1 else None


def _figure(summary: Summary, metric: str) -> str:
    if metric not in summary.figures:
        return ""
    return number(summary.figures[metric], METRICS[metric].digits) or ("= reference" if summary.exact else "infinite")


def number(estimate: Estimate | None, digits: int) -> str:
    """Formats a value, such as `27.31 ± 0.12`; an empty text for None.

    Args:
        estimate: The value and, if known, half the width of its confidence interval.
        digits: Number of decimals.
    """
    if estimate is None:
        return ""
    half = "" if estimate.half_width is None else f" ± {estimate.half_width:.{digits}f}"
    return f"{estimate.mean:.{digits}f}{half}"


def signed(estimate: Estimate | None) -> str:
    """Formats a difference in decibels with its sign, such as `+0.31 ± 0.12`; see `number`."""
    if estimate is None:
        return ""
    half = "" if estimate.half_width is None else f" ± {estimate.half_width:.2f}"
    return f"{estimate.mean:+.2f}{half}"


def _percent(summary: Summary, share: float) -> str:
    return "" if summary.row.lossless else f"{100 * share:.1f} %"


def _paper(values: Mapping[str, float] | None) -> str:
    if not values:
        return ""
    metrics = [*DEFAULT_METRICS, *(name for name in values if name not in (*DEFAULT_METRICS, *SIZE_METRICS))]
    return " / ".join(f"{values[m]:.{2 if m == 'psnr' else 3}f}" for m in metrics if m in values)


def ordering_table(orderings: Sequence[Ordering]) -> Table | None:
    """Returns a table that shows whether the measured ranking of methods agrees with the published one.

    Args:
        orderings: Pairs of methods, with their published and their measured difference in PSNR.

    Returns:
        The table; None if `orderings` is empty.
    """
    if not orderings:
        return None
    columns = ("the paper has above", "the paper has below", "scene", "paper (dB)", "here (dB)", "order")
    steps: dict[tuple[str, str, str], list[Ordering]] = {}
    for o in orderings:
        steps.setdefault((o.better, o.worse, _where(o.scene, o.loss)), []).append(o)
    rows = [
        (*step, ", ".join(f"{o.published:+.2f} ({o.dataset})" for o in same), signed(same[0].ours), same[0].verdict)
        for step, same in steps.items()
    ]
    return Table("Orderings of the paper", columns, tuple(rows))


def _where(scene: str, loss: Loss | None) -> str:
    return scene if loss is None else f"{scene}, {loss.label}"


def packet_loss_table(scene: str, by_variant: Mapping[str, Sequence[PacketLossRates]]) -> Table | None:
    """Returns a table that compares the loss rates of datagrams with the resulting loss rates of packets.

    A packet is lost if any of its datagrams is lost, so that larger packets are lost more often.

    Args:
        scene: Name of the scene.
        by_variant: Loss rates by name of the packetization (division of the scene into packets), with one entry per
            loss model.

    Returns:
        The table, with one row per loss model; None if `by_variant` is empty.
    """
    if not by_variant:
        return None
    models = [e.model for e in next(iter(by_variant.values()))]
    rows = []
    for i, model in enumerate(models):
        column = [entries[i] for entries in by_variant.values()]
        packets = (f"{100 * rates.packet_rate:.1f} %" for rates in column)
        rows.append((model, f"{100 * column[0].datagram_rate:.1f} %", *packets))
    columns = ("process over datagrams of 1200 bytes", "datagrams lost", *(f"packets lost: {v}" for v in by_variant))
    return Table(f"{scene}: what lost datagrams mean in lost packets", columns, tuple(rows))


def bytes_table(scene: str, streams: Mapping[str, Summary]) -> Table | None:
    """Returns the table of each stream's size in bytes, divided into attributes, headers and side information.

    Args:
        scene: Name of the scene.
        streams: A summary for each stream, by name of the stream.

    Returns:
        The table; None if no stream has parts.
    """
    names = list(dict.fromkeys(part for s in streams.values() for part in s.parts))
    if not names:
        return None
    own = list(streams.values())
    rows = [(n.replace("_", " "), *(f"{s.parts[n]:,}" if n in s.parts else "" for s in own)) for n in names]
    rows.append(("total", *(f"{s.num_bytes:,}" for s in own)))
    rows.append(("packets", *(f"{s.num_packets:,}" for s in own)))
    return Table(f"{scene}: bytes by part", ("part", *streams), tuple(rows))


def seconds_table(scene: str, summaries: Sequence[Summary]) -> Table:
    """Returns a table with the numbers of lost packets and elements, and the seconds that each processing step took.

    Args:
        scene: Name of the scene.
        summaries: Results of all scenes; results of other scenes are ignored.
    """
    own = [s for s in summaries if s.scene == scene]
    phases = list(dict.fromkeys(phase for s in own for phase in s.seconds))
    rows = []
    for s in own:
        name = s.row.label if s.loss is None else f"{s.row.label}, {s.loss.label}"
        lost = (f"{s.lost_packets * s.num_packets:,.0f}", f"{s.lost_anchors * s.num_anchors:,.0f}")
        rows.append((name, *lost, *(f"{s.seconds[phase]:.2f}" if phase in s.seconds else "" for phase in phases)))
    columns = (
        "row",
        "packets lost",
        f"{common_word(s.elements for s in own)} lost",
        *(f"{phase} (s)" for phase in phases),
    )
    return Table(f"{scene}: losses and seconds", columns, tuple(rows))


def summary_csv(summaries: Sequence[Summary]) -> str:
    """Formats summaries as CSV, one line per scene, method and loss model."""
    lines: list[dict[str, Any]] = []
    for s in summaries:
        line: dict[str, Any] = {"scene": s.scene, "dataset": s.dataset, "row": s.row.key, "label": s.row.label}
        line |= {"loss": "none" if s.loss is None else s.loss.model, "unit": None if s.loss is None else s.loss.unit}
        line |= {"send_order": None if s.loss is None else s.loss.send_order}
        for metric in dict.fromkeys((*DEFAULT_METRICS, *measured(summaries))):
            e, d = s.figures.get(metric), s.delta.get(metric)
            line |= {
                metric: e and e.mean,
                f"{metric}_spread": e and e.spread,
                f"{metric}_half_width": e and e.half_width,
            }
            line |= {f"{metric}_delta": d and d.mean, f"{metric}_delta_half_width": d and d.half_width}
        line |= {"lost_packets": s.lost_packets, "lost_anchors": s.lost_anchors, "lost_datagrams": s.lost_datagrams}
        line |= {"num_bytes": s.num_bytes, "num_packets": s.num_packets, "num_anchors": s.num_anchors}
        lines.append(line | {"num_gaussians": s.num_gaussians})
    return to_csv(lines)


def leaderboard_csv(summaries: Sequence[Summary]) -> str:
    """Formats results as CSV with the columns of published 3DGS leaderboards, one line per method and loss model."""
    # The column LPIPS has the metric `lpips_unscaled`, which published tables use.
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(_LEADERBOARD)
    for s in summaries:
        figures = [s.figures.get(metric) for metric in ("psnr", "ssim", PUBLISHED_LPIPS)]
        cells = ["" if e is None else f"{e.mean:.6f}" for e in figures]
        name = s.row.label if s.loss is None else f"{s.row.label} [{s.loss.label}]"
        named = name if s.row.decoded else f"splatwire: {name}"
        writer.writerow([named, *cells, s.num_bytes, s.num_gaussians])
    return buffer.getvalue()


def to_csv(lines: Sequence[Mapping[str, Any]]) -> str:
    """Formats mappings with the same keys as CSV."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(lines[0]) if lines else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return buffer.getvalue()


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(_markdown_line(cell).replace("|", "\\|") for cell in cells) + " |"


def _markdown_line(text: str) -> str:
    """Replaces line breaks by spaces, because they would end a heading or a row."""
    return " ".join(text.splitlines())


_TEX = {"&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}", "±": r"$\pm$",
        "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"}  # fmt: skip


def _tex(text: str) -> str:
    return "".join(_TEX.get(character, character) for character in text)
