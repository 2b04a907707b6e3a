"""Report of an evaluation: one self-contained HTML file with all tables, charts and images."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from splatwire.evaluation.pixels import ERROR_GAIN, error_map, jpeg
from splatwire.evaluation.study.charts import (
    bytes_chart,
    losses_chart,
    rate_chart,
    scale_chart,
    seeds_chart,
    views_chart,
)
from splatwire.evaluation.study.curves import curves_of, panels, title_of
from splatwire.evaluation.study.definition import Study, common_word
from splatwire.evaluation.study.lead import Lead, fold, rows_that_lose, terms_of
from splatwire.evaluation.study.page import filled_page
from splatwire.evaluation.study.pictures import Shot, ViewPictures
from splatwire.evaluation.study.run import ABSENT, StudyResult
from splatwire.evaluation.study.summary import INTERVALS, Summary, streams_of
from splatwire.evaluation.study.tables import Table


def render_study_report(
    result: StudyResult,
    summaries: Sequence[Summary],
    tables: Mapping[str, Sequence[Table]],
    pictures: Sequence[ViewPictures],
    lead: Lead | None = None,
    links: Mapping[str, str] | None = None,
) -> str:
    """Renders the report of an evaluation as an HTML page.

    Args:
        result: Results of the evaluation.
        summaries: Statistics of the results, including means over datasets.
        tables: Tables by section: `results`, `orderings`, `equivalence`, `bytes`, `seconds`.
        pictures: Images of the views with the lowest PSNR.
        lead: First part of the report (summary and image comparison); None for a report without this part.
        links: Paths of other reports, by title.
    """
    study, note = result.study, result.lpips_note
    hidden = rows_that_lose(result, summaries)
    folded = [fold(table, hidden) for table in tables.get("results", ())]
    lpips = [f"LPIPS (VGG): {note}."] if note and note != ABSENT else []
    return _render(
        study,
        subtitle=_subtitle(result),
        notes=[*study.notes, *lpips, *result.skipped],
        intervals=INTERVALS,
        tables={**tables, "results": [table for table, _ in folded]},
        folded=[table for _, table in folded if table is not None],
        lead=lead,
        links=links or {},
        opens=lead.opens if lead else (),
        terms=terms_of(tables.get("results", ())),
        charts=_charts(result, summaries),
        byte_charts=[bytes_chart(streams) for name in result.scenes if (streams := streams_of(summaries, name))],
        views=[_view(view) for view in pictures],
        judge=next((row.label for row in study.rows if row.key == study.baseline), ""),
        published=bool(study.published),
    )


def render_sizes_report(study: Study, tables: Sequence[Table]) -> str:
    """Renders the report of a comparison of sizes as an HTML page.

    Args:
        study: Definition of the comparison.
        tables: Tables of the report.
    """
    subtitle = ", ".join(scene.name for scene in study.scenes)
    return _render(study, subtitle=subtitle, notes=study.notes, tables={"results": tables})


def _render(study: Study, **values: Any) -> str:
    return filled_page(
        "splatwire.evaluation.study", "report.html.jinja", title=study.title, error_gain=ERROR_GAIN, **values
    )


def _subtitle(result: StudyResult) -> str:
    study = result.study
    views = {len(result.records[cell.unit.key]) for cell in result.cells}
    references = ", ".join(sorted({scene.references.source for scene in result.scenes.values()}))
    seeds = ", ".join(map(str, study.seeds))
    streams = [next(iter(scene.streams.values())) for scene in result.scenes.values()]
    sizes, elements = "/".join(f"{s.num_anchors:,}" for s in streams), common_word(s.elements for s in streams)
    return (
        f"{', '.join(result.scenes)} · {sizes} {elements} · {'/'.join(map(str, sorted(views)))} views · "
        f"seeds {seeds} · compared with {references} · {len(result.records)} units of work"
    )


def _charts(result: StudyResult, summaries: Sequence[Summary]) -> list[dict[str, str]]:
    study, charts = result.study, []
    for scene in result.scenes:
        own = [s for s in summaries if s.scene == scene]
        over_losses = losses_chart(own, study.losses)
        if over_losses:
            charts.append({"title": f"{scene}: PSNR against the loss", "svg": over_losses})
        for loss in study.losses if over_losses is None else study.losses[:1]:
            shown = [s for s in own if s.loss in (None, loss)]
            if (drawn := seeds_chart(shown)) is not None:
                charts.append({"title": f"{scene}, {loss.label}: every seed", "svg": drawn})
            if (drawn := views_chart(shown, _view_names(result, scene))) is not None:
                charts.append({"title": f"{scene}, {loss.label}: every view", "svg": drawn})
    for panel in panels(curves_of(study, summaries)):
        if (drawn := rate_chart(panel)) is not None:
            charts.append({"title": title_of(panel), "svg": drawn})
    for loss in study.losses:
        if (drawn := scale_chart(summaries, loss)) is not None:
            charts.append({"title": f"{loss.label}: the size of the scene", "svg": drawn})
    return charts


def _view_names(result: StudyResult, scene: str) -> list[str]:
    cell = next(cell for cell in result.cells if cell.scene == scene)
    return [record.view for record in result.records[cell.unit.key]]


def _view(view: ViewPictures) -> dict[str, Any]:
    return {
        "title": f"{view.scene}, view {view.view}",
        "loss": view.loss,
        "source": view.source,
        "reference": jpeg(view.reference),
        "shots": [_shot(shot, view) for shot in view.shots],
        "maps": [{"name": name, "image": jpeg(pixels)} for name, pixels in view.loss_maps.items()],
    }


def _shot(shot: Shot, view: ViewPictures) -> dict[str, str]:
    psnr = "" if shot.psnr is None else f"{shot.psnr:.2f} dB" if math.isfinite(shot.psnr) else "equal to the reference"
    error = jpeg(error_map(shot.pixels, view.reference), 75)
    return {"label": shot.label, "psnr": psnr, "image": jpeg(shot.pixels), "error": error}
