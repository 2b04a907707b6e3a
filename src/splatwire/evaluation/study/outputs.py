"""Output files of an evaluation: scores per view, tables, leaderboard, report."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from splatwire.arguments import checked
from splatwire.channel import Bernoulli, GilbertElliott, parse_loss
from splatwire.evaluation.study.charts import rate_chart
from splatwire.evaluation.study.curves import bd_table, curves_csv, curves_of, panels, title_of
from splatwire.evaluation.study.definition import Study
from splatwire.evaluation.study.lead import make_lead
from splatwire.evaluation.study.masks import PacketLossRates, mask_bytes, measure_packet_loss
from splatwire.evaluation.study.pictures import save_pictures, take_pictures
from splatwire.evaluation.study.records import RECORD_KEY, table_to_bytes
from splatwire.evaluation.study.report import render_sizes_report, render_study_report
from splatwire.evaluation.study.run import LPIPS_OF_MASKED, StudyResult
from splatwire.evaluation.study.sizes import SceneSizes, size_tables
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.summary import INTERVALS, Summary, dataset_means, orderings, streams_of, summarize
from splatwire.evaluation.study.tables import (
    Table,
    bytes_table,
    leaderboard_csv,
    ordering_table,
    packet_loss_table,
    result_tables,
    seconds_table,
    summary_csv,
    to_csv,
)
from splatwire.files.atomic_write import atomic_write
from splatwire.files.json_text import json_text
from splatwire.files.names import distinct_names, safe_name
from splatwire.metrics.registry import LPIPS_SCALED

RATES = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2)
"""Loss rates of datagrams for which the report lists the resulting loss rates of packets."""


@checked
def write_outputs(result: StudyResult, store: Store, folder: Path) -> dict[str, Path]:
    """Writes all results of an evaluation.

    Args:
        result: Results of the evaluation.
        store: Store of the evaluation.
        folder: Output folder; files of the same names are replaced.

    Returns:
        Paths of the written files by kind of content.
    """
    summaries = summarize(result)
    everything = [*summaries, *dataset_means(result, summaries)]
    tables = _tables(result, store, summaries, everything)
    every = [table for section in _IN_FILES for table in tables[section]]
    records, notes = result.merged(), [*_mask_notes(result), *result.skipped]
    texts = {
        "records": ("records.csv", to_csv(records)),
        "summary": ("summary.csv", summary_csv(everything)),
        "markdown": ("tables.md", _markdown(result.study, notes, every)),
        "latex": ("tables.tex", "\n".join(table.latex() for table in every)),
        "json": ("results.json", json_text(_content(result, everything), 1) + "\n"),
    }
    if curves := curves_of(result.study, everything):
        texts["curves"] = ("rate_distortion.csv", curves_csv(curves))
    files = {kind: atomic_write(folder / name, text.encode(), parents=True) for kind, (name, text) in texts.items()}
    files["parquet"] = atomic_write(folder / "records.parquet", table_to_bytes(records, RECORD_KEY), parents=True)
    for name, file in zip(result.scenes, distinct_names(result.scenes), strict=True):
        lines = leaderboard_csv([summary for summary in summaries if summary.scene == name])
        atomic_write(folder / "leaderboard" / f"{file}.csv", lines.encode(), parents=True)
    drawn = panels(curves_of(result.study, everything))
    for panel, file in zip(drawn, distinct_names([title_of(panel) for panel in drawn]), strict=True):
        if (chart := rate_chart(panel)) is not None:
            atomic_write(folder / "curves" / f"{file}.svg", chart.encode(), parents=True)
    _save_masks(result, store)
    files["report"] = _write_page(result, store, everything, tables, folder)
    return files


@checked
def write_report(
    result: StudyResult, store: Store, folder: Path, content: Mapping[str, Any], *, curve: StudyResult | None = None,
    links: Mapping[str, str] | None = None,
) -> Path:  # fmt: skip
    """Writes an HTML report with images and `results.json` of an evaluation, and returns the path of the report.

    Args:
        result: Results of the evaluation.
        store: Store of the evaluation.
        folder: Output folder; files of the same names are replaced.
        content: Content of `results.json`.
        curve: Results of the same scene at other loss rates.
        links: Paths of other reports to link to, by title.
    """
    summaries = summarize(result)
    atomic_write(folder / "results.json", (json_text(content, 1) + "\n").encode(), parents=True)
    tables = _tables(result, store, summaries, summaries)
    return _write_page(result, store, summaries, tables, folder, curve, links)


def _write_page(
    result: StudyResult, store: Store, summaries: Sequence[Summary], tables: Mapping[str, Sequence[Table]],
    folder: Path, curve: StudyResult | None = None, links: Mapping[str, str] | None = None,
) -> Path:  # fmt: skip
    pictures = take_pictures(result, store)
    save_pictures(pictures, folder / "pictures")
    worst = [] if curve is None else take_pictures(curve, store)
    lead = make_lead(result, pictures, curve, worst)
    page = render_study_report(result, summaries, tables, pictures, lead, links)
    return atomic_write(folder / "report.html", page.encode(), parents=True)


_IN_FILES = ("results", "curves", "orderings", "equivalence", "bytes")
"""Sections of the report that are also written as table files. Timings are excluded, because they depend on the
machine."""


def _tables(
    result: StudyResult, store: Store, summaries: Sequence[Summary], everything: Sequence[Summary]
) -> dict[str, list[Table]]:
    """Returns the tables of the report, by section.

    Args:
        result: Results of the evaluation.
        store: Store of the evaluation.
        summaries: Statistics for each scene, method and loss model.
        everything: `summaries`, followed by the means over scenes if there are several.
    """
    names = list(result.scenes)
    order = ordering_table(orderings(result, summaries))
    deltas = [bd_table(panel) for panel in panels(curves_of(result.study, everything))]
    means = [packet_loss_table(name, _packet_loss_rates(result, store, name)) for name in names]
    sizes = [bytes_table(name, streams_of(summaries, name)) for name in names]
    return {
        "results": result_tables(result, everything),
        "curves": [table for table in deltas if table is not None],
        "orderings": [order] if order else [],
        "equivalence": [table for table in means if table is not None],
        "bytes": [table for table in sizes if table is not None],
        "seconds": [seconds_table(name, summaries) for name in names],
    }


def _save_masks(result: StudyResult, store: Store) -> None:
    """Writes all loss masks of an evaluation into the store, to evaluate other codecs on the same losses."""
    folders = dict(zip(result.scenes, distinct_names(result.scenes), strict=True))
    for scene in result.scenes.values():
        for (variant, loss, seed), mask in scene.masks.items():
            start = f"masks/{folders[scene.entry.name]}/{variant}/{safe_name(loss.label)}"
            name = f"{start}_{seed}_{mask.digest[:12]}.npz"
            if not (store.root / name).is_file():
                stream = store.files.stream(store.root / scene.streams[variant].path)
                store.write(name, mask_bytes(stream, mask, loss, seed))


@checked
def write_size_outputs(study: Study, scene_sizes: Sequence[SceneSizes], folder: Path) -> dict[str, Path]:
    """Writes the results of a comparison of sizes into a folder.

    Args:
        study: Definition of the comparison.
        scene_sizes: Sizes of each scene.
        folder: Output folder.

    Returns:
        Paths of the written files by kind of content.
    """
    tables = size_tables(study, scene_sizes)
    lines = [
        {"scene": sizes.scene, "num_anchors": sizes.num_anchors, "column": column, "part": part, "num_bytes": size}
        for sizes in scene_sizes
        for column, parts in sizes.columns.items()
        for part, size in parts.items()
    ]
    content = {"protocol": study.name, "scenes": [vars(sizes) for sizes in scene_sizes]}
    texts = {
        "summary": ("summary.csv", to_csv(lines)),
        "markdown": ("tables.md", _markdown(study, (), tables)),
        "latex": ("tables.tex", "\n".join(table.latex() for table in tables)),
        "json": ("results.json", json_text(content, 1) + "\n"),
        "report": ("report.html", render_sizes_report(study, tables)),
    }
    return {kind: atomic_write(folder / name, text.encode(), parents=True) for kind, (name, text) in texts.items()}


def _markdown(study: Study, skipped: Sequence[str], tables: Sequence[Table]) -> str:
    notes = [*study.notes, *([INTERVALS] if study.kind == "losses" else []), *skipped]
    return "\n".join(
        [f"## {study.title}", "", *(f"{note}\n" for note in notes), *(table.markdown() for table in tables)]
    )


def _mask_notes(result: StudyResult) -> list[str]:
    lpips = f"; LPIPS: {LPIPS_OF_MASKED}" if not LPIPS_SCALED.keys().isdisjoint(result.study.metrics) else ""
    masked = [name for name, scene in result.scenes.items() if scene.references.masked]
    return [f"Compared inside the masks of the photos: {', '.join(masked)}{lpips}."] if masked else []


def _content(result: StudyResult, summaries: Sequence[Summary]) -> dict[str, Any]:
    study = result.study
    return {
        "protocol": study.name,
        "seeds": list(study.seeds),
        "losses": [loss.label for loss in study.losses],
        "references": {name: scene.references.source for name, scene in result.scenes.items()},
        "masked": [name for name, scene in result.scenes.items() if scene.references.masked],
        "skipped": list(result.skipped),
        "num_units": len(result.records),
        "rows": [summary.to_json() for summary in summaries],
    }


def _packet_loss_rates(result: StudyResult, store: Store, scene: str) -> dict[str, list[PacketLossRates]]:
    """Measures, for several loss rates of datagrams, the share of packets that each stream loses.

    Args:
        result: Results of the evaluation.
        store: Store of the evaluation.
        scene: Name of the scene.

    Returns:
        One result for each loss rate, by name of the stream.
    """
    # The share of lost packets is higher than that of lost datagrams if a packet takes several datagrams.
    rates = {}
    models = list(dict.fromkeys(model for loss in result.study.losses for model in _with_loss_rates(loss.model)))
    for variant, stream in result.scenes[scene].streams.items():
        if not stream.num_packets:
            continue
        opened = store.files.stream(store.root / stream.path)
        rates[variant] = [measure_packet_loss(opened, model, result.study.seeds, "interleaved") for model in models]
    return rates


def _with_loss_rates(spec: str) -> list[str]:
    """Returns the specifications of a loss model at several loss rates."""
    model = parse_loss(spec)
    if isinstance(model, Bernoulli):
        return [f"bernoulli:{rate}" for rate in RATES]
    if isinstance(model, GilbertElliott):
        return [f"gilbert:{rate},{model.mean_burst}" for rate in RATES]
    return [spec]
