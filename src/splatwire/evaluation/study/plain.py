"""Simple evaluations: one scene and one loss model, with one table row per concealer."""

import statistics
from collections.abc import Iterable
from typing import Any

from splatwire.bitstream import Packetization
from splatwire.evaluation.study.definition import DEFAULT_METRICS, Row
from splatwire.evaluation.study.run import StudyResult
from splatwire.evaluation.study.summary import Summary, summarize
from splatwire.files.json_text import json_ready

USUAL_ORDER = ("drop", "prior", "idw", "cari", "grow")
"""Order of concealers in tables, simplest first; concealers that are not listed follow in the given order."""


def concealment_rows(
    concealers: Iterable[str],
    packetization: Packetization | None = None,
    *,
    complete: bool = True,
    contiguous: Packetization | None = None,
) -> tuple[Row, ...]:
    """Creates the table rows for a comparison of concealers: one row per concealer, and optional rows for comparison.

    Args:
        concealers: Names of concealers.
        packetization: Packetization of the scene; None to send a stream without repacking.
        complete: True to add a row without loss; the stream must be complete.
        contiguous: Packetization of an additional row in which packets contain neighbouring elements; None for no such
            row.
    """
    rows = [Row("no loss", "no loss", packetization, lossless=True)] if complete else []
    rows += [Row("contiguous drop", "contiguous drop", contiguous)] if contiguous else []
    usual = {name: index for index, name in enumerate(USUAL_ORDER)}
    ordered = sorted(dict.fromkeys(concealers), key=lambda name: usual.get(name, len(usual)))
    return (*rows, *(Row(name, name, packetization, name) for name in ordered))


def plain_content(result: StudyResult) -> dict[str, Any]:
    """Converts the results of an evaluation of one scene under one loss model to JSON values."""
    study, (scene,), loss = result.study, result.scenes.values(), result.study.losses[0]
    rows = [_row(result, summary) for summary in summarize(result)]
    streams = {_stream_name(row): scene.streams[row.variant] for row in reversed(study.rows)}
    return {
        "rows": rows,
        "loss": loss.process.name,
        "unit": loss.unit,
        "seeds": list(study.seeds),
        "send_order": loss.send_order,
        "renderer": study.renderer,
        "reference": scene.references.source,
        "masked": scene.references.masked,
        "views": [record.view for record in result.records[result.cells[0].unit.key]],
        "num_anchors": result.records[result.cells[0].unit.key][0].num_anchors,
        "num_packets": {name: stream.num_packets for name, stream in streams.items()},
        "lpips": result.lpips_note or "computed on every view",
    }


def _row(result: StudyResult, summary: Summary) -> dict[str, Any]:
    row = summary.row
    runs = [result.records[cell.unit.key][0] for cell in result.cells if cell.row is row]
    seconds = {phase: value for phase, value in summary.seconds.items() if phase != "score"}
    psnr, (ssim, lpips) = summary.figures.get("psnr"), (summary.by_seed.get(name) for name in ("ssim", "lpips"))
    return {
        "method": row.label,
        "psnr": psnr and psnr.mean,
        "ssim": ssim and statistics.fmean(ssim),
        "lpips": lpips and statistics.fmean(lpips),
        "metrics": {
            name: value and value.mean for name, value in summary.figures.items() if name not in DEFAULT_METRICS
        },
        "seconds": sum(seconds.values()),
        "num_bytes": summary.num_bytes,
        "exact": summary.exact,
        "concealer": None if row.lossless else row.conceal,
        "stream": _stream_name(row),
        "num_lost": statistics.fmean(run.num_lost_anchors for run in runs),
        "num_lost_packets": statistics.fmean(run.num_lost_packets for run in runs),
        "num_bytes_received": statistics.fmean(run.num_bytes_received for run in runs),
        "seconds_by_phase": seconds,
        "psnr_by_seed": json_ready(summary.by_seed["psnr"]),
        "psnr_spread": psnr and psnr.spread,
        "psnr_by_view": json_ready(summary.by_view["psnr"]),
        "parts": dict(summary.parts),
    }


def _stream_name(row: Row) -> str:
    """Returns "contiguous" if the packets of a method's stream contain consecutive elements, otherwise "stream"."""
    return "contiguous" if row.packetization is not None and row.packetization.grouping == "contiguous" else "stream"
