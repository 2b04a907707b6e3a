"""The report of a protocol: one HTML file with every table, chart and picture in it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import splatwire
from splatwire.evaluate.report import ERROR_GAIN, error_map, jpeg, render_template
from splatwire.evaluate.study.charts import losses_chart, scale_chart, seeds_chart, views_chart
from splatwire.evaluate.study.definition import Study
from splatwire.evaluate.study.pictures import Shot, ViewPictures
from splatwire.evaluate.study.run import StudyResult
from splatwire.evaluate.study.summary import INTERVALS, Summary
from splatwire.evaluate.study.tables import Table

_TEMPLATE = "study.html.jinja"


def render_study_report(
    result: StudyResult,
    summaries: Sequence[Summary],
    tables: Mapping[str, Sequence[Table]],
    pictures: Sequence[ViewPictures],
) -> str:
    """Renders the report of a protocol.

    Args:
        result: What it found.
        summaries: Its rows, means over datasets included.
        tables: Tables by section: `results`, `orderings`, `equivalence`, `bytes`.
        pictures: Pictures of the hardest views.
    """
    study = result.study
    return render_template(
        _TEMPLATE,
        title=study.title,
        version=splatwire.__version__,
        subtitle=_subtitle(result),
        notes=[*study.notes, *result.skipped],
        intervals=INTERVALS,
        tables=tables,
        charts=_charts(result, summaries),
        views=[_view(view) for view in pictures],
        error_gain=ERROR_GAIN,
    )


def render_sizes_report(study: Study, tables: Sequence[Table]) -> str:
    """Renders the report of a protocol of kind `sizes`."""
    return render_template(
        _TEMPLATE,
        title=study.title,
        version=splatwire.__version__,
        subtitle=", ".join(scene.name for scene in study.scenes),
        notes=study.notes,
        intervals="",
        tables={"results": tables, "orderings": [], "equivalence": [], "bytes": []},
        charts=[],
        views=[],
        error_gain=ERROR_GAIN,
    )


def _subtitle(result: StudyResult) -> str:
    study = result.study
    views = {len(result.records[cell.unit.key]) for cell in result.cells}
    references = ", ".join(sorted({scene.reference for scene in result.scenes.values()}))
    seeds = ", ".join(map(str, study.seeds))
    return (
        f"{', '.join(result.scenes)} · {'/'.join(map(str, sorted(views)))} views · seeds {seeds} · "
        f"compared with {references} · {len(result.records)} units of work"
    )


def _charts(result: StudyResult, summaries: Sequence[Summary]) -> list[dict[str, str]]:
    study, found = result.study, []
    for scene in result.scenes:
        own = [s for s in summaries if s.scene == scene]
        over_losses = losses_chart(own, study.losses)
        if over_losses:
            found.append({"title": f"{scene}: PSNR against the loss", "svg": over_losses})
        for loss in study.losses if over_losses is None else study.losses[:1]:
            shown = [s for s in own if s.loss in (None, loss)]
            if (drawn := seeds_chart(shown)) is not None:
                found.append({"title": f"{scene}, {loss.label}: every seed", "svg": drawn})
            if (drawn := views_chart(shown, _view_names(result, scene))) is not None:
                found.append({"title": f"{scene}, {loss.label}: every view", "svg": drawn})
    for loss in study.losses:
        if (drawn := scale_chart(summaries, loss)) is not None:
            found.append({"title": f"{loss.label}: the size of the scene", "svg": drawn})
    return found


def _view_names(result: StudyResult, scene: str) -> list[str]:
    cell = next(cell for cell in result.cells if cell.scene == scene)
    return [record["view"] for record in result.records[cell.unit.key]]


def _view(view: ViewPictures) -> dict[str, Any]:
    return {
        "title": f"{view.scene}, view {view.view}",
        "loss": view.loss,
        "reference": jpeg(view.reference),
        "shots": [_shot(shot, view) for shot in view.shots],
        "maps": [{"name": name, "image": jpeg(pixels)} for name, pixels in view.loss_maps.items()],
    }


def _shot(shot: Shot, view: ViewPictures) -> dict[str, str]:
    psnr = f"{shot.psnr:.2f} dB" if math.isfinite(shot.psnr) else "equal to the reference" if shot.psnr > 0 else ""
    error = jpeg(error_map(shot.pixels, view.reference), 75)
    return {"label": shot.label, "psnr": psnr, "image": jpeg(shot.pixels), "error": error}
