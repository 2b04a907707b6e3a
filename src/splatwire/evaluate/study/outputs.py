"""Files that a protocol leaves: records, tables, leaderboard, report."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from splatwire.channel import Bernoulli, GilbertElliott, parse_loss
from splatwire.evaluate.results import LPIPS_OF_MASKED
from splatwire.evaluate.study.definition import Study
from splatwire.evaluate.study.masks import Equivalence, equivalence
from splatwire.evaluate.study.pictures import safe, save_pictures, take_pictures
from splatwire.evaluate.study.records import records_to_bytes
from splatwire.evaluate.study.report import render_sizes_report, render_study_report
from splatwire.evaluate.study.run import StudyResult
from splatwire.evaluate.study.sizes import SceneSizes, size_tables
from splatwire.evaluate.study.store import Store, write_whole
from splatwire.evaluate.study.summary import INTERVALS, Summary, dataset_means, orderings, summarize
from splatwire.evaluate.study.tables import (
    Table,
    bytes_table,
    equivalence_table,
    leaderboard_csv,
    ordering_table,
    result_tables,
    summary_csv,
    to_csv,
)
from splatwire.packets import read_stream

RATES = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2)
"""Datagram loss rates that the report translates into packet losses."""
Progress = Callable[[str, float], None]


def write_outputs(result: StudyResult, store: Store, folder: Path, progress: Progress) -> dict[str, Path]:
    """Writes everything that a protocol found.

    Args:
        result: What it found.
        store: Its store.
        folder: Where to; files of the same names are replaced.
        progress: Called with what is being done and the share of it that is done.

    Returns:
        The paths of the files by kind.
    """
    summaries = summarize(result)
    everything = [*summaries, *dataset_means(result, summaries)]
    order = ordering_table(orderings(result, summaries))
    means = {name: _equivalences(result, store, name) for name in result.scenes}
    tables = {
        "results": result_tables(result, everything),
        "orderings": [order] if order else [],
        "equivalence": [t for name, found in means.items() if (t := equivalence_table(name, found)) is not None],
        "bytes": [t for name in result.scenes if (t := bytes_table(name, summaries)) is not None],
    }
    pictures = take_pictures(result, store, progress)
    save_pictures(pictures, folder / "pictures")
    records, files = result.merged(), {}
    every = [table for group in tables.values() for table in group]
    for kind, name, text in (
        ("records", "records.csv", to_csv(records)),
        ("summary", "summary.csv", summary_csv(everything)),
        ("markdown", "tables.md", _markdown(result.study, [*_mask_notes(result), *result.skipped], every)),
        ("latex", "tables.tex", "\n".join(table.latex() for table in every)),
        ("json", "results.json", json.dumps(_json(result, everything), indent=1) + "\n"),
        ("report", "report.html", render_study_report(result, everything, tables, pictures)),
    ):
        files[kind] = write_whole(folder / name, text.encode())
    files["parquet"] = write_whole(folder / "records.parquet", records_to_bytes(records, merged=True))
    for name in result.scenes:
        lines = leaderboard_csv([summary for summary in summaries if summary.scene == name])
        write_whole(folder / "leaderboard" / f"{safe(name)}.csv", lines.encode())
    return files


def write_size_outputs(study: Study, found: Sequence[SceneSizes], folder: Path) -> dict[str, Path]:
    """Writes what a protocol of kind `sizes` found; see `write_outputs`."""
    tables = size_tables(study, found)
    lines = [
        {"scene": sizes.scene, "num_anchors": sizes.num_anchors, "column": column, "part": part, "num_bytes": size}
        for sizes in found
        for column, parts in sizes.columns.items()
        for part, size in parts.items()
    ]
    content = {"protocol": study.name, "scenes": [vars(sizes) for sizes in found]}
    texts = {
        "summary": ("summary.csv", to_csv(lines)),
        "markdown": ("tables.md", _markdown(study, (), tables)),
        "latex": ("tables.tex", "\n".join(table.latex() for table in tables)),
        "json": ("results.json", json.dumps(content, indent=1) + "\n"),
        "report": ("report.html", render_sizes_report(study, tables)),
    }
    return {kind: write_whole(folder / name, text.encode()) for kind, (name, text) in texts.items()}


def _markdown(study: Study, skipped: Sequence[str], tables: Sequence[Table]) -> str:
    notes = [*study.notes, *([INTERVALS] if study.kind == "losses" else []), *skipped]
    return "\n".join(
        [f"## {study.title}", "", *(f"{note}\n" for note in notes), *(table.markdown() for table in tables)]
    )


def _mask_notes(result: StudyResult) -> list[str]:
    lpips = f"; LPIPS: {LPIPS_OF_MASKED}" if "lpips" in result.study.metrics else ""
    masked = [name for name, scene in result.scenes.items() if scene.masked]
    return [f"Compared inside the masks of the photos: {', '.join(masked)}{lpips}."] if masked else []


def _json(result: StudyResult, summaries: Sequence[Summary]) -> dict[str, Any]:
    study = result.study
    return {
        "protocol": study.name,
        "seeds": list(study.seeds),
        "losses": [loss.label for loss in study.losses],
        "references": {name: scene.reference for name, scene in result.scenes.items()},
        "masked": [name for name, scene in result.scenes.items() if scene.masked],
        "skipped": list(result.skipped),
        "num_units": len(result.records),
        "rows": [_without_infinity(summary.to_json()) for summary in summaries],
    }


def _without_infinity(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_infinity(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_infinity(item) for item in value]
    return None if isinstance(value, float) and value in (float("inf"), float("-inf")) else value


def _equivalences(result: StudyResult, store: Store, scene: str) -> dict[str, list[Equivalence]]:
    """What datagram losses of the protocol's processes mean in packets, by packetization."""
    found, prepared = {}, result.scenes[scene]
    models = list(dict.fromkeys(model for loss in result.study.losses for model in _at_rates(loss.model)))
    for variant, stream in prepared.streams.items():
        opened, _ = read_stream(store.root / stream.path)
        found[variant] = [equivalence(opened, model, result.study.seeds, "interleaved") for model in models]
    return found


def _at_rates(spec: str) -> list[str]:
    """A process at the rates of `RATES`."""
    model = parse_loss(spec)
    if isinstance(model, Bernoulli):
        return [f"bernoulli:{rate}" for rate in RATES]
    if isinstance(model, GilbertElliott):
        return [f"gilbert:{rate},{model.mean_burst}" for rate in RATES]
    return [spec]
