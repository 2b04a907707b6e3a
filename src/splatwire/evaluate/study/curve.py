"""Quality over loss: some rows of an evaluation at more loss rates, for the head of its report."""

from dataclasses import replace
from typing import NamedTuple

from splatwire.channel import Bernoulli, GilbertElliott, LossModel, parse_loss
from splatwire.evaluate.study.definition import Loss, Row
from splatwire.evaluate.study.engines import Engine
from splatwire.evaluate.study.references import Progress
from splatwire.evaluate.study.run import StudyResult, run_study
from splatwire.evaluate.study.store import Store
from splatwire.evaluate.study.summary import Summary, summarize

RATES = (0.05, 0.1, 0.3, 0.5)
"""Loss rates of the curve, in addition to that of the evaluation."""


class ComparedRows(NamedTuple):
    """Rows that the head of a report compares.

    Attributes:
        uncovered: Row with the lowest PSNR of all rows without concealment.
        baseline: Baseline of the evaluation; it may be the same row.
        best: Row with the highest PSNR.
    """

    uncovered: Row
    baseline: Row
    best: Row


def run_loss_curve(result: StudyResult, store: Store, engine: Engine, progress: Progress) -> StudyResult | None:
    """Runs the rows of `compared_rows` at other loss rates.

    Args:
        result: The evaluation: one scene under one loss.
        store: Store of the evaluation.
        engine: Engine that computes.
        progress: Called with the work and the share of it that is done.

    Returns:
        The result at the rates of `RATES`; None if the loss has no rate, or no row conceals better than the baseline.

    Raises:
        SplatwireError: If a unit fails.
    """
    study, loss = result.study, result.study.losses[0]
    rows, model = compared_rows(result, summarize(result)), parse_loss(loss.model, loss.unit)
    losses = tuple(replace(loss, model=text) for rate in RATES if (text := _at_rate(model, rate)))
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
    """Returns the rows to compare; None if there is no baseline, or it is the best row."""
    found = {
        s.row.key: s.figures["psnr"].mean  # type: ignore[union-attr]
        for s in summaries
        if s.loss == result.study.losses[0] and s.figures.get("psnr") is not None
    }
    key = result.study.baseline
    best = max(found, key=lambda name: found[name], default=None)
    if key is None or key not in found or best is None or best == key:
        return None
    open_gaps = [row for row in result.study.lossy_rows if row.key in found and row.conceal == "drop" and not row.erode]
    uncovered = min(open_gaps, key=lambda row: found[row.key], default=result.study.row(key))
    return ComparedRows(uncovered, result.study.row(key), result.study.row(best))


def curve_losses(result: StudyResult, curve: StudyResult) -> tuple[Loss, ...]:
    """Returns the losses of an evaluation and of its curve, by rate."""
    losses = (*result.study.losses[:1], *curve.study.losses)
    return tuple(sorted(losses, key=lambda loss: getattr(loss.process, "rate", 0.0)))


def _at_rate(model: LossModel, rate: float) -> str | None:
    """Returns the text of a loss model at another rate; None if it has none."""
    if isinstance(model, Bernoulli):
        return f"bernoulli:{rate}"
    if isinstance(model, GilbertElliott) and (model.arrival_bad, model.arrival_good) == (0.0, 1.0):
        return f"gilbert:{rate},{model.mean_burst}"
    return None
