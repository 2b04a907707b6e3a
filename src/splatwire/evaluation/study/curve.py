"""Loss curve of a report: PSNR of a few methods against the loss rate."""

from dataclasses import replace
from typing import NamedTuple

from splatwire.arguments import checked
from splatwire.channel import Bernoulli, GilbertElliott, LossModel, parse_loss
from splatwire.evaluation.study.definition import Loss, Row
from splatwire.evaluation.study.engines import Engine
from splatwire.evaluation.study.references import Progress
from splatwire.evaluation.study.run import StudyResult, run_study
from splatwire.evaluation.study.store import Store
from splatwire.evaluation.study.summary import Summary, summarize

RATES = (0.05, 0.1, 0.3, 0.5)
"""Loss rates of the curve, in addition to the loss rate of the evaluation."""


class ComparedRows(NamedTuple):
    """The three methods in the chart of PSNR against the loss rate.

    Attributes:
        uncovered: Method that leaves the gaps of lost elements; the baseline if there is no such method.
        baseline: Baseline method of the evaluation.
        best: The method with the highest PSNR.
    """

    uncovered: Row
    baseline: Row
    best: Row


@checked
def run_loss_curve(result: StudyResult, store: Store, engine: Engine, progress: Progress) -> StudyResult | None:
    """Evaluates a few methods at further loss rates, for a chart of PSNR against the loss rate.

    Args:
        result: Results of an evaluation of one scene under one loss model. The rate of this model is not evaluated
            again.
        store: Store of the evaluation.
        engine: Engine that executes the tasks.
        progress: Called with the name of the current task and its finished share, 0 to 1.

    Returns:
        The results; None if the loss model has no rate, or there are no methods to compare (see `compared_rows`).

    Raises:
        SplatwireError: If a task fails.
    """
    study, loss = result.study, result.study.losses[0]
    rows, model = compared_rows(result, summarize(result)), parse_loss(loss.model, loss.unit)
    losses = tuple(replace(loss, model=text) for rate in RATES if (text := _with_loss_rate(model, rate)))
    losses = tuple(other for other in losses if other.process != loss.process)
    if rows is None or not losses:
        return None
    shown = replace(
        study,
        rows=tuple(row for row in study.rows if row in rows),
        losses=losses,
        baseline=rows.uncovered.key,
        metrics=("psnr",),
        picture_views=1,
        notes=(),
        published=(),
    )
    return run_study(shown, store, engine, progress)


def compared_rows(result: StudyResult, summaries: list[Summary]) -> ComparedRows | None:
    """Returns the methods that a chart of PSNR against the loss rate compares.

    Args:
        result: Results of the evaluation.
        summaries: Statistics of the results, one for each method and loss model.

    Returns:
        The methods. None if no PSNR was measured, if the evaluation has no baseline, or if the baseline is the best
        method.
    """
    rows_by_variant = {
        s.row.key: s.figures["psnr"].mean  # type: ignore[union-attr]
        for s in summaries
        if s.loss == result.study.losses[0] and s.figures.get("psnr") is not None
    }
    key = result.study.baseline
    best = max(rows_by_variant, key=lambda name: rows_by_variant[name], default=None)
    if key is None or key not in rows_by_variant or best is None or best == key:
        return None
    open_gaps = [
        row for row in result.study.lossy_rows if row.key in rows_by_variant and row.conceal == "drop" and not row.erode
    ]
    uncovered = min(open_gaps, key=lambda row: rows_by_variant[row.key], default=result.study.row(key))
    return ComparedRows(uncovered, result.study.row(key), result.study.row(best))


def curve_losses(result: StudyResult, curve: StudyResult) -> tuple[Loss, ...]:
    """Returns the loss models in the chart of PSNR against the loss rate, ascending by loss rate.

    Args:
        result: Results of the evaluation; only its first loss model is used.
        curve: Results with the same loss model at other loss rates.
    """
    losses = (*result.study.losses[:1], *curve.study.losses)
    return tuple(sorted(losses, key=lambda loss: getattr(loss.process, "rate", 0.0)))


def _with_loss_rate(model: LossModel, rate: float) -> str | None:
    """Returns the specification of a loss model with another loss rate; None if the model has no rate."""
    if isinstance(model, Bernoulli):
        return f"bernoulli:{rate}"
    if isinstance(model, GilbertElliott) and (model.arrival_bad, model.arrival_good) == (0.0, 1.0):
        return f"gilbert:{rate},{model.mean_burst}"
    return None
